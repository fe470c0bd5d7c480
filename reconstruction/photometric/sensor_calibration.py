"""What one sensor needs before it measures: colour map, untouched image, pitch; and its file.

The file is a NumPy archive (.npz) of plain arrays, no pickle: `format`, `version`, `kind` and
`pitch_mm`, `smoothing_px`, `marker_level`, `background`, and the arrays of the map, prefixed by
`map_`.
"""

import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from reconstruction.arrays import FloatImage
from reconstruction.errors import CaptureError, InputError, require_number
from reconstruction.photometric.calibration_ball import BallPress, SampleOptions, sample_presses
from reconstruction.photometric.colour_maps import (
    ColourPolynomial,
    ColourTable,
    fit_polynomial,
    fit_table,
)
from reconstruction.photometric.images import mean_background, smoothed

MapKind = Literal["polynomial", "table"]
ColourMap = ColourPolynomial | ColourTable
KINDS: dict[str, type[Any]] = {"polynomial": ColourPolynomial, "table": ColourTable}
FORMAT, VERSION = "photometric-calibration", 1
PREFIX = "map_"


@dataclass(frozen=True, eq=False)
class SensorCalibration:
    """Calibration of a photometric-stereo sensor.

    Parameters
    ----------
    colour_map : from colour (and place) to slope
    background : (row, col, 3) float32, mean of untouched images, 8-bit levels, red first
    pitch_mm : distance of neighbouring pixels on the surface
    smoothing_px : side of the square over which colours are averaged first; odd
    marker_level : grey level up to which a pixel is a printed dot (70 in the vendor's programs);
        0 where the gel has no dots

    Raises
    ------
    InputError : a value out of range
    """

    colour_map: ColourMap
    background: FloatImage
    pitch_mm: float
    smoothing_px: int = 3
    marker_level: int = 0

    def __post_init__(self) -> None:
        require_number("pitch_mm", self.pitch_mm, 0.0, open_low=True)
        SampleOptions(smoothing_px=self.smoothing_px, marker_level=self.marker_level)
        shape = self.background.shape
        if self.background.dtype != np.float32 or len(shape) != 3 or shape[2] != 3:
            raise InputError(
                f"background is {self.background.dtype} {shape}; give (row, col, 3) float32"
            )
        # This way round NaN is refused as well.
        if not bool(np.all((self.background >= 0.0) & (self.background <= 255.0))):
            raise InputError("background holds levels outside 0 to 255")


def calibrate_sensor(
    presses: Sequence[BallPress],
    background_frames: ArrayLike,
    pitch_mm: float,
    kind: MapKind = "polynomial",
    options: SampleOptions | None = None,
) -> SensorCalibration:
    """Calibrate on presses of balls (about 50 of 4 to 9 mm diameter, spread over the field).

    Parameters
    ----------
    presses : calibration images
    background_frames : (frame, row, col, 3) uint8, untouched; about ten
    pitch_mm : distance of neighbouring pixels on the surface
    kind : `polynomial` (smooth, knows the place) or `table` (the classic look-up table)
    options : threshold, smoothing, dots

    Raises
    ------
    InputError : unknown kind, images that do not fit each other
    FitError : a press without a contact circle, too few presses
    """
    if kind not in KINDS:
        raise InputError(f"map is {kind!r}; give one of {', '.join(KINDS)}")
    how, background = options or SampleOptions(), mean_background(background_frames)
    samples = sample_presses(presses, background, pitch_mm, how)
    colour_map: ColourMap
    if kind == "table":
        colour_map = fit_table(samples, smoothed(background, how.smoothing_px))
    else:
        colour_map = fit_polynomial(samples, (background.shape[0], background.shape[1]))
    return SensorCalibration(colour_map, background, pitch_mm, how.smoothing_px, how.marker_level)


def write_sensor_calibration(path: Path | str, calibration: SensorCalibration) -> None:
    """Write `calibration` to an .npz file; the same calibration gives the same bytes."""
    kind = next(k for k, part in KINDS.items() if isinstance(calibration.colour_map, part))
    arrays: dict[str, NDArray[Any]] = {
        "format": np.array(FORMAT),
        "version": np.array(VERSION),
        "kind": np.array(kind),
        "pitch_mm": np.array(calibration.pitch_mm),
        "smoothing_px": np.array(calibration.smoothing_px),
        "marker_level": np.array(calibration.marker_level),
        "background": calibration.background,
    }
    arrays |= {PREFIX + name: part for name, part in calibration.colour_map.arrays().items()}
    with Path(path).open("wb") as file:  # a name without .npz stays as it is
        np.savez_compressed(file, allow_pickle=False, **arrays)


def read_sensor_calibration(path: Path | str) -> SensorCalibration:
    """Read what `write_sensor_calibration` wrote.

    Raises
    ------
    CaptureError : the file is missing or damaged, of another format, or an array does not fit
    """
    try:
        # Opened here: np.load leaves a file open that is no archive.
        with Path(path).open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            arrays = {name: np.asarray(file[name]) for name in file.files}
    except (OSError, ValueError, EOFError, AttributeError, zipfile.BadZipFile) as error:
        reason = " ".join(str(error).split())
        raise CaptureError(f"{path}: is no photometric calibration ({reason})") from error
    try:
        return _from_arrays(arrays)
    except KeyError as error:
        raise CaptureError(f"{path}: the array {error} is missing") from error
    except (InputError, ValueError, TypeError) as error:
        raise CaptureError(f"{path}: {error}") from error


def _from_arrays(arrays: Mapping[str, NDArray[Any]]) -> SensorCalibration:
    found = str(arrays["format"]), int(arrays["version"])
    if found != (FORMAT, VERSION):
        raise CaptureError(f"format and version are {found}; this program reads {FORMAT, VERSION}")
    kind = str(arrays["kind"])
    if kind not in KINDS:
        raise CaptureError(f"map is {kind!r}; this program reads {', '.join(KINDS)}")
    parts = {
        name.removeprefix(PREFIX): values
        for name, values in arrays.items()
        if name.startswith(PREFIX)
    }
    return SensorCalibration(
        KINDS[kind].from_arrays(parts),
        arrays["background"],
        float(arrays["pitch_mm"]),
        int(arrays["smoothing_px"]),
        int(arrays["marker_level"]),
    )
