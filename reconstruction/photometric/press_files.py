"""Measure the presses of a description (`press_description`) from files, and write the results.

All presses of a description are measured with one calibration.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from reconstruction.arrays import Levels
from reconstruction.errors import CaptureError, InputError, one_line
from reconstruction.netcdf import (
    write_arrays,
)
from reconstruction.photometric.calibration_ball import BallPress
from reconstruction.photometric.height_map import HeightMap
from reconstruction.photometric.images import mean_background
from reconstruction.photometric.presentation import SLOPES, height_arrays
from reconstruction.photometric.press_description import (
    Calibrate,
    Framing,
    Names,
    PressDescription,
    read_press_description,
)
from reconstruction.photometric.press_doubts import doubts_of_background, doubts_of_image
from reconstruction.photometric.rest_surface import RestSurface
from reconstruction.photometric.sensor import (
    PhotometricDecoder,
    SensorCalibration,
    UntouchedGel,
    calibrate_sensor,
    read_sensor_calibration,
)
from reconstruction.pipeline import read_maps, write_ply
from reconstruction.reading import MOST_IMAGE_BYTES, read_bytes


@dataclass(frozen=True, eq=False)
class PhotometricResult:
    """Measurement of one press from its image.

    Parameters
    ----------
    image : (row, col, 3) uint8, red first, cropped and resized as it was decoded
    calibration : calibration that was used, with the current background; it can be used again
    height_map : measured heights
    untouched : pixels of undeformed gel, and the change of their light
    doubts : one line of text per reason why the calibration may be wrong
    """

    image: Levels
    calibration: SensorCalibration
    height_map: HeightMap
    untouched: UntouchedGel
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class DescribedPresses:
    """Presses of one description, with the decoder that measures them.

    Parameters
    ----------
    files : images of the presses
    frame : crop and resize of the images
    decoder : calibrated decoder
    doubts : one line of text per reason why the calibration may be wrong, from the backgrounds only
    """

    files: tuple[Path, ...]
    frame: Framing
    decoder: PhotometricDecoder
    doubts: tuple[str, ...]

    def measure(self, file: Path) -> PhotometricResult:
        """Return the measurement of one press.

        Parameters
        ----------
        file : image of the press, an element of `files`

        Raises
        ------
        CaptureError : the image is missing or damaged, or has a different shape from the background
        """
        image = read_rgb(file, self.frame)
        try:
            height_map, untouched = self.decoder.decode(image), self.decoder.untouched(image)
        except InputError as error:
            raise CaptureError(f"{file}: {error}") from error
        doubts = self.doubts + doubts_of_image(height_map, untouched)
        return PhotometricResult(image, self.decoder.calibration, height_map, untouched, doubts)


def described_presses(description_file: Path | str) -> DescribedPresses:
    """Read a description of presses, and calibrate or read its calibration.

    See `press_description` for the file.

    Raises
    ------
    InputError : a file is missing or damaged, images have different shapes, or the calibration
        fails
    """
    path = Path(description_file)
    described = read_press_description(path)
    calibration, doubts = _calibration(path.parent, described)
    decoder = PhotometricDecoder(calibration, described.options)
    files = tuple(_files(path.parent, described.images))
    return DescribedPresses(files, described.frame, decoder, doubts)


def reconstruct_photometric(description_file: Path | str) -> PhotometricResult:
    """Return the measurement of the only press of a description.

    Raises
    ------
    InputError : the description has several presses, or for the reasons of `described_presses` and
        `DescribedPresses.measure`
    """
    presses = described_presses(description_file)
    if len(presses.files) > 1:
        raise CaptureError(f"{description_file}: names {len(presses.files)} images; name one")
    return presses.measure(presses.files[0])


def _files(folder: Path, names: Names) -> list[Path]:
    """Return the paths of named files; a name with `*` or `?` gives all matching files, sorted.

    Raises
    ------
    CaptureError : no file matches a pattern
    """
    files: list[Path] = []
    for name in names:
        if not set(name) & set("*?"):
            files.append(folder / name)
            continue
        try:
            matching = sorted(folder.glob(name))
        except (ValueError, NotImplementedError) as error:
            raise CaptureError(f"{folder}: no pattern of file names: {name} ({error})") from error
        if not matching:
            raise CaptureError(
                f"{folder / name}: matches no file; give names of images in {folder}"
            )
        files += matching
    return files


def _calibration(
    folder: Path, press: PressDescription
) -> tuple[SensorCalibration, tuple[str, ...]]:
    """Return the calibration with the current background, and reasons why it may be wrong."""
    background = _read_all(folder, press.background, press.frame)
    if press.calibrate is not None:
        return _calibrated(folder, press.calibrate, press.frame, background), ()
    stored = read_sensor_calibration(folder / press.calibration)
    if not background:
        return stored, ()
    if background[0].shape != stored.background.shape:
        raise CaptureError(
            f"{folder / press.background[0]}: has shape {background[0].shape}; the calibration "
            f"was made with {stored.background.shape}"
        )
    today = mean_background(background)
    doubts = doubts_of_background(stored.background, today)
    return replace(stored, background=today), doubts


def _calibrated(
    folder: Path, how: Calibrate, frame: Framing, background: list[Levels]
) -> SensorCalibration:
    presses = [
        BallPress(image, balls.diameter_mm)
        for balls in how.balls
        for image in _read_all(folder, balls.images, frame)
    ]
    return calibrate_sensor(presses, background, how.pitch_mm, how.map, how.samples)


def _read_all(folder: Path, names: Names, frame: Framing) -> list[Levels]:
    files = _files(folder, names)
    images = [read_rgb(file, frame) for file in files]
    for file, image in zip(files, images, strict=True):
        if image.shape != images[0].shape:
            raise CaptureError(
                f"{file}: has shape {image.shape}; {files[0].name} has {images[0].shape}"
            )
    return images


def read_rgb(path: Path, frame: Framing | None = None) -> Levels:
    """Return an 8-bit colour image from a file (PNG, JPEG, BMP), (row, col, 3), red first.

    Parameters
    ----------
    frame : crop and resize of the image; None: the whole image

    Raises
    ------
    CaptureError : the file is missing, damaged, or no 8-bit colour image
    """
    try:
        content = np.frombuffer(read_bytes(path, MOST_IMAGE_BYTES), np.uint8)
        stored = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if content.size else None
    except (InputError, cv2.error) as error:
        raise CaptureError(f"{path}: cannot be read as an image ({one_line(error)})") from error
    if stored is None or stored.dtype != np.uint8 or stored.ndim != 3 or stored.shape[2] != 3:
        stored_format = "no image" if stored is None else f"{stored.dtype} {stored.shape}"
        raise CaptureError(
            f"{path}: holds {stored_format}; give an 8-bit colour image without alpha"
        )
    levels: Levels = np.ascontiguousarray(stored[..., ::-1])  # OpenCV's order is blue first
    return levels if frame is None else framed(levels, frame)


def framed(image: Levels, frame: Framing) -> Levels:
    """Return an image cropped by `crop_share` at each side, then resized to the size of `frame`."""
    rows, cols = image.shape[:2]
    top, left = int(rows * frame.crop_share), int(cols * frame.crop_share)
    cut = np.ascontiguousarray(image[top : rows - top, left : cols - left])
    if frame.width_px == 0:
        return cut
    size = (frame.width_px, frame.height_px)
    return np.asarray(cv2.resize(cut, size, interpolation=cv2.INTER_AREA))


def write_height_map(path: Path | str, height_map: HeightMap) -> None:
    """Write heights, slopes and reason codes as netCDF-4 variables over image row and column."""
    write_arrays(path, height_arrays(height_map))


def read_height_map(path: Path | str) -> HeightMap:
    """Return the height map in a file that `write_height_map` wrote.

    Raises
    ------
    CaptureError : the file is missing or damaged, or a variable is missing
    """
    stored = read_maps(path)
    try:
        maps = {name: stored[name] for name in (*SLOPES, "height_mm", "mask_reason")}
        slopes = np.stack([maps[name] for name in SLOPES])
        pitch_mm = float(stored.attrs["pitch_mm"])
        rest = RestSurface.from_arrays({name: stored[name] for name in stored.variables})
        return HeightMap(maps["height_mm"], slopes, maps["mask_reason"], pitch_mm, rest)
    except KeyError as error:
        raise CaptureError(f"{path}: no height map: {error} is missing") from error


def write_height_points(path: Path | str, height_map: HeightMap) -> None:
    """Write the valid points as a PLY file, in the order and frame of `HeightMap.points_mm`."""
    comments = ("frame image centre, x right, y up, z towards the camera", "units mm")
    write_ply(path, height_map.points_mm(), comments=comments)
