"""Projector blur that grows with the distance from the focal plane.

Light from a pupil point at offset a (mm, across the axis) reaches a surface point at axial distance
z beside the chief ray's projector pixel by f a (1/z - 1/z_focus) pixels, f the focal length in
pixels: exact for a thin lens, anywhere in the field. An evenly filled pupil of diameter D so
spreads over a disc of c = f D |1/z - 1/z_focus| pixels, the circle of confusion, whose standard
deviation along each axis is c / 4.

Approximations: the disc is replaced by the Gaussian of the same variance, so that it merges with
the lens blur into one number (their transfer functions agree to second order in c times the spatial
frequency); f is that of the undistorted image; irradiance and shadows stay those of the pupil's
centre, so shadows have no penumbra.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.config.models import Projector
from twin.optics.rig import projector_pinhole, world_from_device

LEVELS_PER_OCTAVE = 4
"""Blur levels per doubling of the variance. Between two levels the light is interpolated in the
logarithm of the variance, where an edge's second derivative is at most 0.081: an error of
0.081 / 8 (ln(2) / 4)^2 = 3e-4 of white."""

LEAST_VARIANCE_PX2 = 0.1**2
"""Blur below this is taken as this: table nodes stand 1/16 px apart."""


@dataclass(frozen=True)
class Defocus:
    """Blur of a projector by axial distance.

    Attributes
    ----------
    blur_px : float
        Standard deviation in the focal plane.
    growth_px_mm : float
        Standard deviation per difference of 1/z: focal length (px) times pupil diameter (mm) / 4.
    focus_mm : float
        Axial distance of the focal plane.
    """

    blur_px: float
    growth_px_mm: float
    focus_mm: float

    @classmethod
    def of(cls, projector: Projector) -> "Defocus | None":
        """Return the blur of a projector; None when its aperture is 0 and the blur constant."""
        if projector.aperture_mm == 0.0:
            return None
        pinhole = projector_pinhole(projector)
        growth_px_mm = pinhole.fx_px * projector.aperture_mm / 4.0
        if projector.focus_mm is not None:
            return cls(projector.blur_px, growth_px_mm, projector.focus_mm)
        pose = world_from_device(projector.pose, pinhole)
        origin_axial_mm = float(-pose[:3, 3] @ pose[:3, 2])
        return cls(projector.blur_px, growth_px_mm, origin_axial_mm)

    def variance_px2(self, axial_mm: Any) -> Any:
        """Variance of the blur at an axial distance; number, numpy array or `mi.Float`."""
        spread_px = self.growth_px_mm * (1.0 / axial_mm - 1.0 / self.focus_mm)
        return spread_px * spread_px + self.blur_px**2


@dataclass(frozen=True)
class BlurLevels:
    """Variances at which light tables are made, equally spaced in their logarithm."""

    defocus: Defocus
    first_log: float
    count: int

    @classmethod
    def between(cls, defocus: Defocus, near_mm: float, far_mm: float) -> "BlurLevels":
        """Return the levels that hold every blur between two axial distances."""
        at_ends = [float(defocus.variance_px2(z)) for z in (near_mm, far_mm)]
        in_focus = near_mm <= defocus.focus_mm <= far_mm
        least = defocus.blur_px**2 if in_focus else min(at_ends)
        first_log, last_log = np.log(np.maximum([least, max(at_ends)], LEAST_VARIANCE_PX2))
        count = int(np.ceil((last_log - first_log) / cls.step_log())) + 1
        return cls(defocus, float(first_log), max(count, 2))

    @staticmethod
    def step_log() -> float:
        """Logarithm of the ratio of neighbouring variances."""
        return float(np.log(2.0) / LEVELS_PER_OCTAVE)

    def blurs_px(self) -> list[float]:
        """Return the standard deviation of each level."""
        logs = self.first_log + self.step_log() * np.arange(self.count)
        return [float(sigma) for sigma in np.exp(0.5 * logs)]
