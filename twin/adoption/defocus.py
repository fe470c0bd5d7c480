"""Blur of the projector by distance, from captures of surfaces at several heights.

The fit of each capture gives one blur b. Let u = 1 / z be the inverse of the axial distance of the
capture's points. For a thin lens b^2 = b_0^2 + g^2 (u - u_0)^2 (`twin.optics.light.Defocus`), a
parabola in u. Captures at three heights determine the distance of best focus 1 / u_0, the blur b_0
at that distance, and the growth g: focal length (px) times the diameter of the exit pupil over 4. A
surface has many distances, so that the fit uses the means of u and of u^2 over its points.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.characterise import UncertainValue
from twin.adoption.findings import RigField

LEAST_CAPTURES = 3
# Relative uncertainty of each blur, because one Gaussian was fitted to points of different blur.
# The errors for two rendered rigs are 1 to 4 % (tests/adoption).
_MIXED = 0.02
# Least ratio of the growth to its uncertainty for a significant defocus.
_LEAST_SIGNIFICANCE = 3.0
# Captures with a smaller relative difference of their distances count as one height.
_SAME_HEIGHT = 0.002


@dataclass(frozen=True)
class CaptureBlur:
    """Blur of one capture, and mean and standard deviation of its points' inverse distances.

    Distances are along the projector's axis; the blur is the sigma of a Gaussian, projector px.
    """

    inverse_per_mm: float
    spread_per_mm: float
    blur_px: UncertainValue


@dataclass(frozen=True)
class FittedDefocus:
    """Defocus of a projector: blur at best focus, its growth g, and distance of best focus."""

    blur_px: UncertainValue
    growth_px_mm: UncertainValue
    focus_mm: UncertainValue


def defocus_of(blurs: Sequence[CaptureBlur]) -> FittedDefocus | None:
    """Return the defocus from the blurs of captures; None if they do not determine it.

    They do not determine it if there are fewer than three heights, if g^2 is below three of its
    standard uncertainties, or if b_0^2 is not positive. The same applies if 1 / z of best focus is
    farther from the captures' mean than their range: then the blur there would be an extrapolation.
    """
    u = np.array([item.inverse_per_mm for item in blurs])
    spread = np.array([item.spread_per_mm for item in blurs])
    blur = np.array([item.blur_px.value for item in blurs])
    if len(_heights(u)) < LEAST_CAPTURES:
        return None
    middle, scale = float(u.mean()), float(np.ptp(u))
    x = (u - middle) / scale
    basis = np.stack([np.ones_like(x), x, x * x + (spread / scale) ** 2], axis=1)
    own = np.array([item.blur_px.uncertainty for item in blurs])
    sigma = 2.0 * blur * np.hypot(own, _MIXED * blur)
    weighted = basis / sigma[:, None]
    covariance = np.linalg.inv(weighted.T @ weighted)
    a, b, c = (covariance @ weighted.T @ (blur**2 / sigma)).tolist()
    if c < _LEAST_SIGNIFICANCE * np.sqrt(covariance[2, 2]):
        return None
    top, least = -b / (2.0 * c), a - b * b / (4.0 * c)
    if abs(top) > 1.0 or least <= 0.0:
        return None
    focus_mm = 1.0 / (middle + scale * top)
    slopes = {
        "blur": np.array([1.0, -b / (2.0 * c), b * b / (4.0 * c * c)]) / (2.0 * np.sqrt(least)),
        "growth": np.array([0.0, 0.0, 0.5 / np.sqrt(c)]) / scale,
        "focus": focus_mm**2 * scale * np.array([0.0, 0.5 / c, -b / (2.0 * c * c)]),
    }
    sigmas = {name: float(np.sqrt(item @ covariance @ item)) for name, item in slopes.items()}
    return FittedDefocus(
        UncertainValue(float(np.sqrt(least)), sigmas["blur"]),
        UncertainValue(float(np.sqrt(c)) / scale, sigmas["growth"]),
        UncertainValue(focus_mm, sigmas["focus"]),
    )


def _heights(u: FloatArray) -> list[float]:
    """Return the distinct values of the captures' inverse distances, 1/mm, ascending."""
    distinct: list[float] = []
    for u_per_mm in sorted(u.tolist()):
        if not distinct or u_per_mm - distinct[-1] > _SAME_HEIGHT * u_per_mm:
            distinct.append(u_per_mm)
    return distinct


def defocus_fields(defocus: FittedDefocus, focal_px: float, captures: int) -> dict[str, RigField]:
    """Return blur, diameter of the pupil and distance of best focus as fields of a rig, by path.

    Parameters
    ----------
    focal_px : focal length of the projector, px
    captures : number of captures of the fit
    """
    how = f"blur of {captures} captures over their distance"
    growth, per_mm = defocus.growth_px_mm, 4.0 / focal_px
    aperture = UncertainValue(per_mm * growth.value, per_mm * growth.uncertainty)
    fields = [
        RigField.measured("projector.blur_px", defocus.blur_px, how),
        RigField.measured("projector.aperture_mm", aperture, how),
        RigField.measured("projector.focus_mm", defocus.focus_mm, how),
    ]
    return {entry.path: entry for entry in fields}
