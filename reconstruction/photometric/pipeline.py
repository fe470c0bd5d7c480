"""From a colour image to heights: difference to the background, slopes, integration, zero."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, Levels, ReasonImage
from reconstruction.errors import InputError, require_number
from reconstruction.mask import PhotometricReason
from reconstruction.photometric.colour_maps import BoundPolynomial, BoundTable
from reconstruction.photometric.images import (
    GROWTH_PX,
    checked_image,
    fill_nearest,
    fill_smooth,
    find_markers,
    smoothed,
)
from reconstruction.photometric.integrate import INTEGRATIONS, Integration, integrate
from reconstruction.photometric.poisson import BOUNDARIES, Boundary
from reconstruction.photometric.sensor_calibration import SensorCalibration

# How far dots are grown before filling. The vendor's 2025 form does not grow them, so that their
# dark rims pass for slopes; that belongs to its behaviour.
MARKER_GROWTH_PX = {"corrected": GROWTH_PX, "sdk_2024": 2, "sdk_2025": 0}
# Below this share of untouched pixels their median is no zero level.
LEAST_UNTOUCHED = 0.05


@dataclass(frozen=True)
class PhotometricOptions:
    """How to decode.

    Parameters
    ----------
    integration : `corrected`, or the vendor's scheme `sdk_2024` or `sdk_2025`
    boundary : border of `corrected`: `neumann` (free) or `dirichlet` (held at 0)
    doubtful_weight : weight of pixels with a reason code in `corrected`, 0.001 to 1; below 1 the
        weighted solver runs, several times slower
    untouched_levels : colour difference below which gel counts as untouched, for the zero level

    Raises
    ------
    InputError : a value out of range
    """

    integration: Integration = "corrected"
    boundary: Boundary = "neumann"
    doubtful_weight: float = 1.0
    untouched_levels: float = 6.0

    def __post_init__(self) -> None:
        for name, allowed in (("integration", INTEGRATIONS), ("boundary", BOUNDARIES)):
            if getattr(self, name) not in allowed:
                value = getattr(self, name)
                raise InputError(f"{name} is {value!r}; give one of {', '.join(allowed)}")
        require_number("doubtful_weight", self.doubtful_weight, 1e-3, 1.0)
        require_number("untouched_levels", self.untouched_levels, 0.0, open_low=True)


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Result, row 0 at the top.

    Parameters
    ----------
    height_mm : (row, col) float32, positive towards the camera, 0 where the gel is untouched
    slopes : (2, row, col) float32, mm/mm, along rows (down) and along columns (right)
    mask_reason : (row, col) uint8, see `PhotometricReason`; all numbers are finite even so
    pitch_mm : distance of neighbouring pixels on the surface
    """

    height_mm: FloatImage
    slopes: FloatImage
    mask_reason: ReasonImage
    pitch_mm: float

    @property
    def valid(self) -> BoolImage:
        """Pixels that carry a measurement, (row, col)."""
        return np.asarray(self.mask_reason == PhotometricReason.VALID)

    def points_mm(self) -> FloatArray:
        """Return the valid points row by row, (n, 3): x right, y up, z towards the camera.

        The origin is the middle of the image.
        """
        row, col = np.nonzero(self.valid)
        rows, cols = self.height_mm.shape
        x = (col - 0.5 * (cols - 1)) * self.pitch_mm
        y = (0.5 * (rows - 1) - row) * self.pitch_mm
        return np.column_stack([x, y, self.height_mm[row, col].astype(np.float64)])


@dataclass(frozen=True)
class PhotometricDecoder:
    """A calibrated sensor with everything computed that does not depend on the image."""

    calibration: SensorCalibration
    options: PhotometricOptions = PhotometricOptions()

    def __post_init__(self) -> None:
        _ = self._bound, self._hidden_in_background

    @cached_property
    def _bound(self) -> BoundPolynomial | BoundTable:
        return self.calibration.colour_map.bound_to(self._flat)

    @cached_property
    def _flat(self) -> FloatImage:
        return smoothed(self.calibration.background, self.calibration.smoothing_px)

    @cached_property
    def _hidden_in_background(self) -> BoolImage:
        return self._markers(self.calibration.background)

    def decode(self, image: ArrayLike) -> HeightMap:
        """Measure an image.

        Parameters
        ----------
        image : (row, col, 3) uint8, red first, of the shape of the background

        Raises
        ------
        InputError : wrong type or shape
        FitError : weights below 1 and no convergence
        """
        sensor = self.calibration
        raw = checked_image(image, "image", sensor.background.shape)
        levels = smoothed(raw, sensor.smoothing_px)
        hidden = self._markers(raw.astype(np.float32)) | self._hidden_in_background
        slopes, known = self._bound.slopes(levels)
        reason = _reasons(raw, hidden, known)
        filled = self._filled(slopes.astype(np.float64), hidden)
        height = self._integrated(filled, reason)
        height -= self._zero(height, levels, hidden)
        return HeightMap(
            height.astype(np.float32), filled.astype(np.float32), reason, sensor.pitch_mm
        )

    def _markers(self, levels: FloatImage) -> BoolImage:
        scheme, highest_level = self.options.integration, self.calibration.marker_level
        growth_px = MARKER_GROWTH_PX[scheme]
        return find_markers(levels, highest_level, growth_px, small=scheme == "corrected")

    def _filled(self, slopes: FloatArray, hidden: BoolImage) -> FloatArray:
        fill = fill_smooth if self.options.integration == "corrected" else fill_nearest
        return fill(slopes, hidden)

    def _integrated(self, slopes: FloatArray, reason: ReasonImage) -> FloatArray:
        chosen, weight = self.options, self.options.doubtful_weight
        weights = None if weight == 1.0 else np.where(reason == 0, 1.0, weight)
        return integrate(
            slopes, self.calibration.pitch_mm, chosen.integration, chosen.boundary, weights
        )

    def _zero(self, height: FloatArray, levels: FloatImage, hidden: BoolImage) -> float:
        """Median height of untouched gel; 0 with a held border or where all is touched."""
        if self.options.integration == "corrected" and self.options.boundary == "dirichlet":
            return 0.0
        difference = levels - self._flat
        distance = np.einsum("rcb,rcb->rc", difference, difference)
        untouched = (distance < self.options.untouched_levels**2) & ~hidden
        enough = np.count_nonzero(untouched) >= LEAST_UNTOUCHED * untouched.size
        return float(np.median(height[untouched])) if enough else 0.0


def _reasons(raw: Levels, hidden: BoolImage, known: BoolImage) -> ReasonImage:
    reason = np.zeros(hidden.shape, dtype=np.uint8)
    reason[~known] = PhotometricReason.UNCALIBRATED
    clipped = (raw == 0) | (raw == 255)
    reason[clipped[..., 0] | clipped[..., 1] | clipped[..., 2]] = PhotometricReason.CLIPPED
    reason[hidden] = PhotometricReason.MARKER
    return reason
