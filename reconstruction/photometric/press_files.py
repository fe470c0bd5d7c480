"""Measure the presses of a description (`press_description`) from files, and write the results.

All presses of a description are measured with one calibration.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from reconstruction.arrays import FloatImage, Levels
from reconstruction.errors import CaptureError, InputError, one_line
from reconstruction.native import quiet
from reconstruction.netcdf import write_arrays
from reconstruction.photometric.calibration_ball import BallPress
from reconstruction.photometric.height_map import HeightMap
from reconstruction.photometric.images import checked_image, mean_background
from reconstruction.photometric.presentation import SLOPES, dot_arrays, height_arrays
from reconstruction.photometric.press_description import (
    Calibrate,
    Framing,
    Names,
    PressDescription,
    read_press_description,
)
from reconstruction.photometric.press_doubts import (
    doubts_of_background,
    doubts_of_image,
)
from reconstruction.photometric.printed_dots import GelMotion, SensorDots
from reconstruction.photometric.rest_surface import RestSurface
from reconstruction.photometric.sensor import (
    PhotometricDecoder,
    SensorCalibration,
    UntouchedGel,
    calibrate_sensor,
    read_sensor_calibration,
)
from reconstruction.pipeline import read_maps
from reconstruction.ply import write_ply
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
    motion : displacements of the printed dots; None: the description has no table [dots]
    """

    image: Levels
    calibration: SensorCalibration
    height_map: HeightMap
    untouched: UntouchedGel
    doubts: tuple[str, ...] = ()
    motion: GelMotion | None = None


@dataclass(frozen=True, eq=False)
class DescribedPresses:
    """Presses of one description, with the decoder that measures them.

    Parameters
    ----------
    files : images of the presses
    frame : crop and resize of the images
    decoder : calibrated decoder
    doubts : one line of text per reason why the calibration may be wrong, from the backgrounds and
        the calibration images
    dots : printed dots of the background; None: the description has no table [dots]
    """

    files: tuple[Path, ...]
    frame: Framing
    decoder: PhotometricDecoder
    doubts: tuple[str, ...]
    dots: SensorDots | None = None

    def measure(self, file: Path, previous: GelMotion | None = None) -> PhotometricResult:
        """Return the measurement of one press.

        Parameters
        ----------
        file : image of the press, an element of `files`
        previous : displacements in the frame before, with `dots.sequence`; without it no effect

        Raises
        ------
        CaptureError : the image is missing or damaged, or has a different shape from the background
        """
        image = read_rgb(file, self.frame)
        try:
            checked_image(image, "image", self.decoder.calibration.background.shape)
            hidden = None if self.dots is None else self.dots.covered(image)
            height_map = self.decoder.decode(image, hidden)
            untouched = self.decoder.untouched(image, hidden)
        except InputError as error:
            raise CaptureError(f"{file}: {error}") from error
        doubts = self.doubts + doubts_of_image(height_map, untouched)
        motion = None
        if self.dots is not None:
            before = previous if self.dots.options.sequence else None
            motion = self.dots.tracked(image, height_map, untouched.where, before)
        calibration = self.decoder.calibration
        return PhotometricResult(image, calibration, height_map, untouched, doubts, motion)


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
    backgrounds = _read_all(path.parent, described.background, described.frame)
    if described.calibrate is None:
        calibration, doubts = _stored(path.parent, described, backgrounds)
        dots = _dots(described, calibration.background, calibration.smoothing_px)
    else:
        smoothing_px = described.calibrate.smoothing_px
        dots = _dots(described, mean_background(backgrounds), smoothing_px)
        calibration, doubts = _calibrated(
            path.parent, described.calibrate, described.frame, backgrounds, dots
        )
    decoder = PhotometricDecoder(calibration, described.options)
    files = tuple(_files(path.parent, described.images))
    return DescribedPresses(files, described.frame, decoder, doubts, dots)


def _dots(
    described: PressDescription, background: FloatImage, smoothing_px: int
) -> SensorDots | None:
    if described.dots is None:
        return None
    return SensorDots.of(background, described.dots, smoothing_px)


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


def _stored(
    folder: Path, press: PressDescription, backgrounds: list[Levels]
) -> tuple[SensorCalibration, tuple[str, ...]]:
    """Return the stored calibration with the current background, and reasons for doubt."""
    stored = read_sensor_calibration(folder / press.calibration)
    if not backgrounds:
        return stored, ()
    if backgrounds[0].shape != stored.background.shape:
        raise CaptureError(
            f"{folder / press.background[0]}: has shape {backgrounds[0].shape}; the calibration "
            f"was made with {stored.background.shape}"
        )
    today = mean_background(backgrounds)
    doubts = doubts_of_background(stored.background, today)
    return replace(stored, background=today), doubts


def _calibrated(
    folder: Path,
    how: Calibrate,
    frame: Framing,
    backgrounds: list[Levels],
    dots: SensorDots | None,
) -> tuple[SensorCalibration, tuple[str, ...]]:
    """Return the calibration on those images of balls that can be read, and the other images."""
    presses: list[BallPress] = []
    refused: list[str] = []
    for balls in how.balls:
        for file in _files(folder, balls.images):
            try:
                image = checked_image(read_rgb(file, frame), str(file), backgrounds[0].shape)
            except InputError as error:
                refused.append(str(error))
                continue
            hidden = None if dots is None else dots.covered(image)
            presses.append(BallPress(image, balls.diameter_mm, hidden))
    if not presses:
        raise CaptureError(f"no calibration image can be read; the first: {refused[0]}")
    rows, cols = backgrounds[0].shape[:2]
    rest = how.rest((rows, cols))
    calibration = calibrate_sensor(
        presses, backgrounds, how.pitch_mm, how.map, how.samples, rest=rest
    )
    return calibration, tuple(f"calibration without {line}" for line in refused)


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
        with quiet():  # OpenCV prints a line for each damaged file
            stored = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if content.size else None
    except (InputError, cv2.error) as error:
        raise CaptureError(f"{path}: cannot be read as an image ({one_line(error)})") from error
    if stored is None:
        raise CaptureError(f"{path}: holds no image, or only a part of one; give the complete file")
    if stored.dtype != np.uint8 or stored.ndim != 3 or stored.shape[2] != 3:
        raise CaptureError(
            f"{path}: holds {stored.dtype} {stored.shape}; give an 8-bit colour image without alpha"
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


def write_dots(path: Path | str, motion: GelMotion) -> None:
    """Write places, displacements, uncertainties and status of printed dots as netCDF-4."""
    write_arrays(path, dot_arrays(motion))


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
