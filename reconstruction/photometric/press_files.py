"""Measure from files: a press described by a small TOML file beside its images, and what comes out.

    format = "photometric-press"
    version = 1
    image = "coin.png"                         # what to measure
    background = ["still_0.png", "still_1.png"]  # untouched; may be left out beside `calibration`
    calibration = "mini.npz"                   # made before; or the table [calibrate]

    [calibrate]
    pitch_mm = 0.0634
    [[calibrate.balls]]
    diameter_mm = 6.31
    images = ["ball_00.png", "ball_01.png"]

    [frame]                                    # optional: how camera frames become images
    crop_share = 0.15                          # cut off at each side
    width_px = 320
    height_px = 240

    [options]                                  # optional, see PhotometricOptions
    integration = "corrected"

File names are relative to the folder of the description.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from reconstruction.arrays import Levels, PhotometricReason
from reconstruction.capture.description import build, read_toml, table_of, take_header
from reconstruction.errors import (
    CaptureError,
    InputError,
    one_line,
    require_integer,
    require_number,
)
from reconstruction.machine import PIXELS, pixel_coordinates, write_dataset
from reconstruction.photometric.calibration_ball import BallPress, SampleOptions
from reconstruction.photometric.images import mean_background
from reconstruction.photometric.sensor import (
    KINDS,
    HeightMap,
    MapKind,
    PhotometricDecoder,
    PhotometricOptions,
    SensorCalibration,
    calibrate_sensor,
    read_sensor_calibration,
)

if TYPE_CHECKING:
    import xarray
from reconstruction.pipeline import read_maps, write_ply
from reconstruction.reading import MOST_IMAGE_BYTES, read_bytes

Names = tuple[str, ...]
DEFAULTS = PhotometricOptions()
SLOPES = ("slope_row", "slope_col")

FORMAT, VERSION = "photometric-press", 1


@dataclass(frozen=True)
class Framing:
    """Crop and resize of camera frames; width and height 0 keep the size.

    Parameters
    ----------
    crop_share : part of width and height cut off at each side, 0 to 0.45
    width_px, height_px : size after the crop; both 0, or both given
    """

    crop_share: float = 0.0
    width_px: int = 0
    height_px: int = 0

    def __post_init__(self) -> None:
        require_number("crop_share", self.crop_share, 0.0, 0.45)
        require_integer("width_px", self.width_px, 0, 100_000)
        require_integer("height_px", self.height_px, 0, 100_000)
        if (self.width_px == 0) != (self.height_px == 0):
            raise InputError(
                f"width_px is {self.width_px} and height_px {self.height_px}; give both or neither"
            )


@dataclass(frozen=True)
class Balls:
    """Images of one reference ball."""

    diameter_mm: float
    images: Names

    def __post_init__(self) -> None:
        require_number("diameter_mm", self.diameter_mm, 0.0, open_low=True)
        object.__setattr__(self, "images", _names("images", self.images))


@dataclass(frozen=True)
class Calibrate:
    """What to calibrate on, and how; see `calibrate_sensor`."""

    pitch_mm: float
    balls: tuple[Balls, ...]
    map: str = "polynomial"
    threshold_levels: float = 15.0
    smoothing_px: int = 3
    marker_level: int = 0

    def __post_init__(self) -> None:
        require_number("pitch_mm", self.pitch_mm, 0.0, open_low=True)
        if self.map not in KINDS:
            raise InputError(f"map is {self.map!r}; give one of {', '.join(KINDS)}")
        _ = self.samples

    @property
    def samples(self) -> SampleOptions:
        """Options of the sampling."""
        return SampleOptions(self.threshold_levels, self.smoothing_px, self.marker_level)


@dataclass(frozen=True)
class PressDescription:
    """Content of the file; exactly one of `calibration` (a file name) and `calibrate` is given."""

    image: str
    background: Names = ()
    calibration: str = ""
    calibrate: Calibrate | None = None
    frame: Framing = Framing()
    options: PhotometricOptions = DEFAULTS

    def __post_init__(self) -> None:
        _names("image", [self.image])
        object.__setattr__(self, "background", _names("background", self.background, least=0))
        if (self.calibration == "") == (self.calibrate is None):
            raise InputError("give either the key calibration (a file) or the table [calibrate]")
        if self.calibrate is not None and not self.background:
            raise InputError("background is empty; [calibrate] needs images of the untouched gel")


def read_press_description(path: Path | str) -> PressDescription:
    """Read the TOML file.

    Raises
    ------
    CaptureError : no TOML, wrong format or version, unknown or missing key, value out of range
    """
    path = Path(path)
    values = read_toml(path)
    try:
        take_header(values, (FORMAT, VERSION))
        parts: dict[str, Any] = {}
        if "calibrate" in values:
            parts["calibrate"] = _calibrate(table_of(values, "calibrate"))
        if "frame" in values:
            parts["frame"] = build(Framing, table_of(values, "frame"), "frame")
        if "options" in values:
            parts["options"] = build(PhotometricOptions, table_of(values, "options"), "options")
        return build(PressDescription, values | parts, path.name)
    except InputError as error:
        raise CaptureError(f"{path}: {error}") from error


def _calibrate(table: Mapping[str, Any]) -> Calibrate:
    given = table.get("balls")
    if not isinstance(given, list) or not given or not all(isinstance(b, dict) for b in given):
        raise CaptureError("[[calibrate.balls]] is missing; give a diameter_mm and its images")
    balls = tuple(build(Balls, ball, "calibrate.balls") for ball in given)
    return build(Calibrate, dict(table) | {"balls": balls}, "calibrate")


def _names(key: str, names: object, least: int = 1) -> Names:
    given = [names] if isinstance(names, str) else names
    is_list = isinstance(given, (list, tuple)) and len(given) >= least
    if not is_list or not all(isinstance(name, str) and name for name in given):  # type: ignore[attr-defined]
        raise InputError(f"{key} is {names!r}; give a list of file names")
    return tuple(given)  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class PhotometricResult:
    """The measurement, the image, and the calibration it was made with, to be kept for the next."""

    image: Levels
    calibration: SensorCalibration
    height_map: HeightMap


def reconstruct_photometric(description_file: Path | str) -> PhotometricResult:
    """Calibrate, or read the calibration, and measure the described image; see the module.

    Raises
    ------
    InputError : a file is missing or damaged, images that do not fit each other, no contact found
    """
    path = Path(description_file)
    press = read_press_description(path)
    calibration = _calibration(path.parent, press)
    image = read_rgb(path.parent / press.image, press.frame)
    try:
        height_map = PhotometricDecoder(calibration, press.options).decode(image)
    except InputError as error:
        raise CaptureError(f"{path.parent / press.image}: {error}") from error
    return PhotometricResult(image, calibration, height_map)


def _calibration(folder: Path, press: PressDescription) -> SensorCalibration:
    background = _read_all(folder, press.background, press.frame)
    if press.calibrate is not None:
        return _calibrated(folder, press.calibrate, press.frame, background)
    stored = read_sensor_calibration(folder / press.calibration)
    if not background:
        return stored
    if background[0].shape != stored.background.shape:
        raise CaptureError(
            f"{folder / press.background[0]}: has shape {background[0].shape}; the calibration "
            f"was made with {stored.background.shape}"
        )
    return replace(stored, background=mean_background(background))


def _calibrated(
    folder: Path, how: Calibrate, frame: Framing, background: list[Levels]
) -> SensorCalibration:
    presses = [
        BallPress(image, balls.diameter_mm)
        for balls in how.balls
        for image in _read_all(folder, balls.images, frame)
    ]
    kind: MapKind = "table" if how.map == "table" else "polynomial"
    return calibrate_sensor(presses, background, how.pitch_mm, kind, how.samples)


def _read_all(folder: Path, names: Names, frame: Framing) -> list[Levels]:
    images = [read_rgb(folder / name, frame) for name in names]
    for name, image in zip(names, images, strict=True):
        if image.shape != images[0].shape:
            raise CaptureError(
                f"{folder / name}: has shape {image.shape}; {names[0]} has {images[0].shape}"
            )
    return images


def read_rgb(path: Path, frame: Framing | None = None) -> Levels:
    """Read an 8-bit colour image (PNG, JPEG, BMP), cut and resize it; red first.

    Raises
    ------
    CaptureError : missing, damaged, or no 8-bit colour image
    """
    try:
        content = np.frombuffer(read_bytes(path, MOST_IMAGE_BYTES), np.uint8)
        stored = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if content.size else None
    except (InputError, cv2.error) as error:
        raise CaptureError(f"{path}: cannot be read as an image ({one_line(error)})") from error
    if stored is None or stored.dtype != np.uint8 or stored.ndim != 3 or stored.shape[2] != 3:
        found = "no image" if stored is None else f"{stored.dtype} {stored.shape}"
        raise CaptureError(f"{path}: holds {found}; give an 8-bit colour image without alpha")
    levels: Levels = np.ascontiguousarray(stored[..., ::-1])  # OpenCV's order is blue first
    return levels if frame is None else framed(levels, frame)


def framed(image: Levels, frame: Framing) -> Levels:
    """Cut `crop_share` off each side, then average down to the size asked for."""
    rows, cols = image.shape[:2]
    top, left = int(rows * frame.crop_share), int(cols * frame.crop_share)
    cut = np.ascontiguousarray(image[top : rows - top, left : cols - left])
    if frame.width_px == 0:
        return cut
    size = (frame.width_px, frame.height_px)
    return np.asarray(cv2.resize(cut, size, interpolation=cv2.INTER_AREA))


def write_height_map(path: Path | str, height_map: HeightMap) -> None:
    """Write height, slopes and reason codes as netCDF-4, one (row, col) variable each."""
    write_dataset(path, height_dataset(height_map))


def height_dataset(height_map: HeightMap) -> "xarray.Dataset":
    """Return height, slopes and reason codes over image row and column, with units."""
    import xarray

    told = ("slope of the surface down the rows", "slope of the surface along the columns")
    variables: dict[str, Any] = {
        name: (PIXELS, values, {"units": "1", "long_name": long_name})
        for name, values, long_name in zip(SLOPES, height_map.slopes, told, strict=True)
    }
    height = {"units": "mm", "long_name": "height above the untouched surface"}
    variables["height_mm"] = (PIXELS, height_map.height_mm, height)
    codes = {
        "units": "1",
        "long_name": "reason why the height is no measurement; 0: it is one",
        "comment": "where it is not 0, slopes are estimates; heights are integrated over them",
        "flag_values": np.array([int(reason) for reason in PhotometricReason], np.uint8),
        "flag_meanings": " ".join(reason.name for reason in PhotometricReason),
    }
    variables["mask_reason"] = (PIXELS, height_map.mask_reason, codes)
    frame = "row 0 at the top; height is positive towards the camera"
    return xarray.Dataset(
        variables,
        coords=pixel_coordinates(*height_map.height_mm.shape),
        attrs={"frame": frame, "pitch_mm": height_map.pitch_mm},
    )


def read_height_map(path: Path | str) -> HeightMap:
    """Read what `write_height_map` wrote.

    Raises
    ------
    CaptureError : missing or damaged file, or a map is missing
    """
    found = read_maps(path)
    try:
        maps = {name: np.asarray(found[name]) for name in (*SLOPES, "height_mm", "mask_reason")}
        slopes = np.stack([maps[name] for name in SLOPES])
        pitch_mm = float(found.attrs["pitch_mm"])
        return HeightMap(maps["height_mm"], slopes, maps["mask_reason"], pitch_mm)
    except KeyError as error:
        raise CaptureError(f"{path}: no height map: {error} is missing") from error


def write_height_points(path: Path | str, height_map: HeightMap) -> None:
    """Write the measured points as PLY, row by row; frame as `HeightMap.points_mm`."""
    comments = ("frame image centre, x right, y up, z towards the camera", "units mm")
    write_ply(path, height_map.points_mm(), comments=comments)
