"""Calibrate a photometric sensor, store the calibration, and measure heights from colours.

A calibration file is a NumPy archive (.npz) of arrays without pickle: `format`, `version`, `kind`,
`pitch_mm`, `smoothing_px`, `marker_level`, `background`, and the arrays of the colour map under
names that start with `map_`. A measurement compares the colours with the background, maps them to
slopes, integrates the slopes to heights, and subtracts the height of undeformed gel.

On a domed gel the slopes are relative to the undeformed coat, whose shape is known and is added
(`RestSurface`). Its arrays are then in the file, which has version 2.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from reconstruction.arrays import (
    BoolImage,
    FloatArray,
    FloatImage,
    Levels,
    PhotometricReason,
    ReasonImage,
)
from reconstruction.colour_maps import (
    COLOUR_MAPS,
    DEFAULT_MAP,
    BoundMap,
    ColourMap,
    map_named,
)
from reconstruction.errors import CaptureError, InputError, require_number
from reconstruction.integration_schemes import SCHEMES, Boundary, IntegrationScheme
from reconstruction.photometric.calibration_ball import BallPress, SampleOptions, sample_presses
from reconstruction.photometric.height_map import HeightMap
from reconstruction.photometric.images import (
    CHANNELS,
    checked_image,
    fill_nearest,
    fill_smooth,
    find_markers,
    mean_background,
    smoothed,
)
from reconstruction.photometric.integrate import (
    BOUNDARIES,
    integrate,
)
from reconstruction.photometric.relighting import (
    LEAST_SHARE,
    light_over_background,
    untouched_gel,
)
from reconstruction.photometric.rest_surface import RestSurface
from reconstruction.reading import read_arrays
from reconstruction.writing import write_npz

FORMAT, VERSION, VERSION_OF_DOME = "photometric-calibration", 1, 2
PREFIX = "map_"
# The pitch at the pressed coat of a dome follows from its height, which the first pass gives.
_PASSES_OF_DOME = 2
LIT_LEVELS = 5.0, 250.0
"""Allowed range of the median level of each channel of the background: pixels must be able to
become darker and brighter."""


@dataclass(frozen=True, eq=False)
class SensorCalibration:
    """Calibration of a photometric-stereo sensor.

    Parameters
    ----------
    colour_map : map from colour (and position in the image) to slope
    background : (row, col, 3) float32, mean of images of the undeformed gel, 8-bit levels
    pitch_mm : distance of neighbouring pixels on the surface
    smoothing_px : side of the square over which colours are averaged before they are mapped; odd
    marker_level : largest grey level of a printed dot (70 in the vendor's programs); 0: the gel has
        no dots
    rest : undeformed coat of a domed gel; None: the gel is flat

    Raises
    ------
    InputError : a value is out of range
    """

    colour_map: ColourMap
    background: FloatImage
    pitch_mm: float
    smoothing_px: int = 3
    marker_level: int = 0
    rest: RestSurface | None = None

    def __post_init__(self) -> None:
        require_number("pitch_mm", self.pitch_mm, 0.0, open_low=True)
        SampleOptions(smoothing_px=self.smoothing_px, marker_level=self.marker_level)
        shape = self.background.shape
        if self.background.dtype != np.float32 or len(shape) != 3 or shape[2] != 3:
            raise InputError(
                f"background is {self.background.dtype} {shape}; give (row, col, 3) float32"
            )
        # Written so that NaN is rejected as well.
        if not bool(np.all((self.background >= 0.0) & (self.background <= 255.0))):
            raise InputError("background holds levels outside 0 to 255")
        if self.rest is not None and self.rest.points_mm.shape != shape:
            raise InputError(
                f"rest surface has shape {self.rest.points_mm.shape}; the background has {shape}"
            )


def calibrate_sensor(
    presses: Sequence[BallPress],
    background_frames: ArrayLike,
    pitch_mm: float,
    kind: str = DEFAULT_MAP,
    options: SampleOptions | None = None,
    *,
    rest: RestSurface | None = None,
) -> SensorCalibration:
    """Calibrate a sensor on presses of balls of known diameter.

    About 50 presses of balls of 4 to 9 mm diameter, distributed over the field, are recommended.

    Parameters
    ----------
    presses : calibration images with the diameters of their balls
    background_frames : (frame, row, col, 3) uint8, images of the undeformed gel; about ten
    pitch_mm : distance of neighbouring pixels on the surface
    kind : name of a map of `COLOUR_MAPS`, for example `polynomial` (smooth, depends on the position
        in the image) or `table` (the classic look-up table)
    options : threshold of contact, smoothing, and level of printed dots; None: the defaults of
        `SampleOptions`
    rest : undeformed coat of a domed gel at the pixels of the background, by its drawing or by a
        measurement; None: the gel is flat

    Raises
    ------
    InputError : the kind is unknown, images have different shapes, or the background is dark or
        saturated
    FitError : images have no contact circle or one that does not fit the ball, presses are too few,
        or the colours do not determine the slopes
    """
    fitted, how = map_named(kind), options or SampleOptions()
    background = mean_background(background_frames)
    _require_lit(background)
    samples = sample_presses(presses, background, pitch_mm, how, rest)
    colour_map = fitted.fit(samples, smoothed(background, how.smoothing_px))
    return SensorCalibration(
        colour_map, background, pitch_mm, how.smoothing_px, how.marker_level, rest
    )


def _require_lit(background: FloatImage) -> None:
    """Raise InputError if the median level of a channel of the background is out of range."""
    low, high = LIT_LEVELS
    for name, level in zip(CHANNELS, np.median(background, axis=(0, 1)).tolist(), strict=True):
        if not low <= level <= high:
            raise InputError(
                f"background: the {name} channel has a median of {level:.3g} levels, allowed "
                f"{low:g} to {high:g}; light the gel in three colours, and set the exposure"
            )


def write_sensor_calibration(path: Path | str, calibration: SensorCalibration) -> None:
    """Write a calibration to an .npz file; equal calibrations give files with equal bytes."""
    arrays: dict[str, NDArray[Any]] = {
        "format": np.array(FORMAT),
        "version": np.array(VERSION if calibration.rest is None else VERSION_OF_DOME),
        "kind": np.array(calibration.colour_map.name),
        "pitch_mm": np.array(calibration.pitch_mm),
        "smoothing_px": np.array(calibration.smoothing_px),
        "marker_level": np.array(calibration.marker_level),
        "background": calibration.background,
    }
    arrays |= {PREFIX + name: part for name, part in calibration.colour_map.arrays().items()}
    if calibration.rest is not None:
        arrays |= {name: part for name, (part, _) in calibration.rest.arrays().items()}
    write_npz(path, arrays)


def read_sensor_calibration(path: Path | str) -> SensorCalibration:
    """Return the calibration in a file that `write_sensor_calibration` wrote.

    Raises
    ------
    CaptureError : the file is missing or damaged or has a wrong format, or an array has a wrong
        shape or value
    """
    try:
        arrays = read_arrays(path)
    except InputError as error:
        raise CaptureError(f"no photometric calibration: {error}") from None
    try:
        return _from_arrays(arrays)
    except KeyError as error:
        raise CaptureError(f"{path}: the array {error} is missing") from error
    except (InputError, ValueError, TypeError) as error:
        raise CaptureError(f"{path}: {error}") from error


def _from_arrays(arrays: Mapping[str, NDArray[Any]]) -> SensorCalibration:
    header = str(arrays["format"]), int(arrays["version"])
    if header not in ((FORMAT, VERSION), (FORMAT, VERSION_OF_DOME)):
        raise CaptureError(f"format and version are {header}; this program reads {FORMAT, VERSION}")
    kind = str(arrays["kind"])
    if kind not in COLOUR_MAPS:
        known = ", ".join(COLOUR_MAPS.names())
        raise CaptureError(f"map is {kind!r}; this program reads {known}")
    parts = {
        name.removeprefix(PREFIX): values
        for name, values in arrays.items()
        if name.startswith(PREFIX)
    }
    return SensorCalibration(
        COLOUR_MAPS[kind].from_arrays(parts),
        arrays["background"],
        float(arrays["pitch_mm"]),
        int(arrays["smoothing_px"]),
        int(arrays["marker_level"]),
        RestSurface.from_arrays(arrays),
    )


@dataclass(frozen=True)
class PhotometricOptions:
    """Options of the decoder from colours to heights.

    Parameters
    ----------
    integration : name of the integration scheme, see `SCHEMES`: `corrected`, or the vendor's
        `sdk_2024` and `sdk_2025`
    boundary : border of the heights in `corrected`: `neumann` (free) or `dirichlet` (fixed at 0)
    doubtful_weight : weight in `corrected` of pixels that are not valid, 0.001 to 1, relative to
        valid pixels; below 1 the weighted solver is used, which is several times slower
    untouched_levels : Euclidean colour difference, levels, below which gel counts as undeformed;
        used for the change of the light and for the zero of the heights
    relighting : True: `corrected` compensates a slow change of the lamps' light over the image, see
        `light_over_background`

    Raises
    ------
    InputError : a value is out of range
    """

    integration: str = "corrected"
    boundary: Boundary = "neumann"
    doubtful_weight: float = 1.0
    untouched_levels: float = 6.0
    relighting: bool = True

    def __post_init__(self) -> None:
        if not isinstance(self.relighting, bool):
            raise InputError(f"relighting is {self.relighting!r}; give true or false")
        for name, allowed in (("integration", SCHEMES.names()), ("boundary", BOUNDARIES)):
            if getattr(self, name) not in allowed:
                value = getattr(self, name)
                raise InputError(f"{name} is {value!r}; give one of {', '.join(allowed)}")
        require_number("doubtful_weight", self.doubtful_weight, 1e-3, 1.0)
        require_number("untouched_levels", self.untouched_levels, 0.0, open_low=True)

    @property
    def scheme(self) -> IntegrationScheme:
        """Integration scheme with the name `integration`."""
        return SCHEMES[self.integration]


@dataclass(frozen=True, eq=False)
class UntouchedGel:
    """Undeformed gel in an image, and the change of the light compared with the background.

    Parameters
    ----------
    where : (row, col) bool, pixels with a colour near that of the background
    light_change : RMS over image and channels of (light in the image / light in the background
        - 1); 0 if the change is not compensated, or if too little undeformed gel is visible
    """

    where: BoolImage
    light_change: float


@dataclass(frozen=True)
class PhotometricDecoder:
    """Decoder of a calibrated sensor: measures heights from images.

    All values that do not depend on the image are computed when the decoder is constructed.
    """

    calibration: SensorCalibration
    options: PhotometricOptions = field(default_factory=PhotometricOptions)

    def __post_init__(self) -> None:
        _ = self._bound, self._hidden_in_background

    @cached_property
    def _bound(self) -> BoundMap:
        return self.calibration.colour_map.bound_to(self._flat)

    @cached_property
    def _flat(self) -> FloatImage:
        return smoothed(self.calibration.background, self.calibration.smoothing_px)

    @cached_property
    def _hidden_in_background(self) -> BoolImage:
        return self._markers(self.calibration.background)

    def decode(self, image: ArrayLike, dots: BoolImage | None = None) -> HeightMap:
        """Return the heights and slopes measured from an image.

        Parameters
        ----------
        image : (row, col, 3) uint8, red first, of the shape of the background
        dots : (row, col) bool, pixels of printed dots, in addition to those with a low level (see
            `SensorCalibration.marker_level`); None: no others

        Raises
        ------
        InputError : the image has a wrong type or shape
        FitError : `doubtful_weight` is below 1, and the weighted solver does not converge
        """
        sensor = self.calibration
        raw = checked_image(image, "image", sensor.background.shape)
        hidden = self._hidden(raw, dots)
        levels = self._lit_as_background(raw, hidden)[0]
        slopes, known = self._bound.slopes(levels)
        reason = _reasons(raw, hidden, known)
        filled = self._filled(slopes.astype(np.float64), hidden)
        rest = sensor.rest
        if rest is not None:
            filled = filled + rest.slopes
        height = np.zeros(reason.shape)
        for _ in range(1 if rest is None else _PASSES_OF_DOME):
            rise = filled
            if rest is not None:
                rise = rest.relative_rise(filled, sensor.pitch_mm, height)
            height = np.asarray(self._integrated(rise, reason), np.float64)
            height -= self._zero(height, levels, hidden)
        if rest is not None:
            height += rest.points_mm[..., 2]
        return HeightMap(
            height.astype(np.float32), filled.astype(np.float32), reason, sensor.pitch_mm, rest
        )

    def untouched(self, image: ArrayLike, dots: BoolImage | None = None) -> UntouchedGel:
        """Return the pixels that `decode` treats as undeformed gel, and the change of the light.

        The change is that of the light in the image compared with the background.

        Parameters
        ----------
        image : (row, col, 3) uint8, red first, of the shape of the background
        dots : see `decode`

        Raises
        ------
        InputError : the image has a wrong type or shape
        """
        raw = checked_image(image, "image", self.calibration.background.shape)
        hidden = self._hidden(raw, dots)
        levels, change = self._lit_as_background(raw, hidden)
        return UntouchedGel(self._untouched(levels, hidden), change)

    def _hidden(self, raw: Levels, dots: BoolImage | None) -> BoolImage:
        hidden = self._markers(raw.astype(np.float32)) | self._hidden_in_background
        return hidden if dots is None else hidden | dots

    def _lit_as_background(self, raw: Levels, hidden: BoolImage) -> tuple[FloatImage, float]:
        """Return smoothed levels (row, col, 3) divided by the change of light, and that change.

        The change is `UntouchedGel.light_change`. If the light is not compensated, or too little
        undeformed gel is visible, the levels are unchanged and the change is 0.
        """
        levels = smoothed(raw, self.calibration.smoothing_px)
        if not (self.options.relighting and self.options.scheme.corrects_light):
            return levels, 0.0
        light = light_over_background(levels, self._flat, hidden, self.options.untouched_levels)
        if light is None:
            return levels, 0.0
        change = float(np.sqrt(np.mean((light - 1.0) ** 2)))
        return np.asarray(levels / light, np.float32), change

    def _untouched(self, levels: FloatImage, hidden: BoolImage) -> BoolImage:
        return untouched_gel(levels, self._flat, self.options.untouched_levels) & ~hidden

    def _markers(self, levels: FloatImage) -> BoolImage:
        scheme, highest_level = self.options.scheme, self.calibration.marker_level
        growth_px, small = scheme.marker_growth_px, scheme.finds_small_markers
        return find_markers(levels, highest_level, growth_px, small)

    def _filled(self, slopes: FloatArray, hidden: BoolImage) -> FloatArray:
        fill = fill_smooth if self.options.scheme.fills_smoothly else fill_nearest
        return fill(slopes, hidden)

    def _integrated(self, slopes: FloatArray, reason: ReasonImage) -> FloatArray:
        chosen, weight = self.options, self.options.doubtful_weight
        weights = None if weight == 1.0 else np.where(reason == 0, 1.0, weight)
        return integrate(
            slopes, self.calibration.pitch_mm, chosen.integration, chosen.boundary, weights
        )

    def _zero(self, height: FloatArray, levels: FloatImage, hidden: BoolImage) -> float:
        """Return the median height of undeformed gel, in the unit of `height`.

        It is 0 if the border is fixed or too little undeformed gel is visible.
        """
        if self.options.scheme.takes_boundary and self.options.boundary == "dirichlet":
            return 0.0
        untouched = self._untouched(levels, hidden)
        return float(np.median(height[untouched])) if untouched.mean() >= LEAST_SHARE else 0.0


def _reasons(raw: Levels, hidden: BoolImage, known: BoolImage) -> ReasonImage:
    reason = np.zeros(hidden.shape, dtype=np.uint8)
    reason[~known] = PhotometricReason.UNCALIBRATED
    clipped = (raw == 0) | (raw == 255)
    reason[clipped[..., 0] | clipped[..., 1] | clipped[..., 2]] = PhotometricReason.CLIPPED
    reason[hidden] = PhotometricReason.MARKER
    return reason
