"""Measure from files: a described press with its PNG or JPEG images, and what comes out."""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import h5netcdf
import numpy as np

from reconstruction.arrays import Levels
from reconstruction.disk import writing_netcdf
from reconstruction.errors import CaptureError, InputError
from reconstruction.outputs import write_ply
from reconstruction.photometric.calibration_ball import BallPress
from reconstruction.photometric.images import mean_background
from reconstruction.photometric.pipeline import HeightMap, PhotometricDecoder
from reconstruction.photometric.press_description import (
    Calibrate,
    Framing,
    Names,
    PressDescription,
    read_press_description,
)
from reconstruction.photometric.reasons import PhotometricReason
from reconstruction.photometric.sensor_calibration import (
    MapKind,
    SensorCalibration,
    calibrate_sensor,
    read_sensor_calibration,
)

DIMENSIONS = ("row", "col")
SLOPES = ("slope_row", "slope_col")


@dataclass(frozen=True, eq=False)
class PhotometricResult:
    """The measurement, and the calibration it was made with, to be kept for the next."""

    calibration: SensorCalibration
    height_map: HeightMap


def reconstruct_photometric(description_file: Path | str) -> PhotometricResult:
    """Calibrate, or read the calibration, and measure the described image; see `press_description`.

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
    return PhotometricResult(calibration, height_map)


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
        stored = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED)
    except (OSError, cv2.error) as error:
        reason = " ".join(str(error).split())
        raise CaptureError(f"{path}: cannot be read as an image ({reason})") from error
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
    resized: Levels = cv2.resize(cut, size, interpolation=cv2.INTER_AREA)
    return resized


def write_height_map(path: Path | str, height_map: HeightMap) -> None:
    """Write height, slopes and reason codes as netCDF-4, one (row, col) variable each."""
    with writing_netcdf(path) as file:
        file.dimensions = dict(zip(DIMENSIONS, height_map.height_mm.shape, strict=True))
        file.attrs["frame"] = "row 0 at the top; height is positive towards the camera"
        file.attrs["pitch_mm"] = height_map.pitch_mm
        maps = dict(zip(SLOPES, height_map.slopes, strict=True))
        maps |= {"height_mm": height_map.height_mm, "mask_reason": height_map.mask_reason}
        for name, values in maps.items():
            variable = file.create_variable(
                name, DIMENSIONS, data=values, compression="gzip", compression_opts=1, shuffle=True
            )
            variable.attrs["units"] = "mm" if name == "height_mm" else "1"
        codes = file.variables["mask_reason"].attrs
        codes["comment"] = (
            "where it is not 0, slopes are estimates; heights are integrated over them"
        )
        codes["flag_values"] = np.array([int(reason) for reason in PhotometricReason], np.uint8)
        codes["flag_meanings"] = " ".join(reason.name for reason in PhotometricReason)


def read_height_map(path: Path | str) -> HeightMap:
    """Read what `write_height_map` wrote.

    Raises
    ------
    CaptureError : missing or damaged file, or a map is missing
    """
    try:
        with h5netcdf.File(Path(path), "r") as file:
            maps = {name: np.asarray(values[...]) for name, values in file.variables.items()}
            pitch_mm = float(file.attrs["pitch_mm"])
        slopes = np.stack([maps[name] for name in SLOPES])
        return HeightMap(maps["height_mm"], slopes, maps["mask_reason"], pitch_mm)
    except OSError as error:
        reason = " ".join(str(error).split())
        raise CaptureError(f"{path}: is no complete netCDF-4 file ({reason})") from error
    except KeyError as error:
        raise CaptureError(f"{path}: no height map: {error} is missing") from error


def write_height_points(path: Path | str, height_map: HeightMap) -> None:
    """Write the measured points as PLY, row by row; frame as `HeightMap.points_mm`."""
    comments = ("frame image centre, x right, y up, z towards the camera", "units mm")
    write_ply(path, height_map.points_mm(), comments=comments)
