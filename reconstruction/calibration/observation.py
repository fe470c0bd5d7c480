"""Read captures of a board and measure its features in camera and projector pixels.

A board capture may be of an uncalibrated rig. Features are detected in the brightness relative to
the white print around them, so that the lighting has no effect.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, FloatImage
from reconstruction.calibration.boards import Board, DotBoard, Indices
from reconstruction.calibration.features import find_corners, find_dots, label_dots, refine_centres
from reconstruction.calibration.plane_images import (
    apply_homography,
    fit_homography,
    projector_points,
)
from reconstruction.capture.description import DESCRIPTION_FILE
from reconstruction.capture.folder import UncalibratedCapture, described, read_uncalibrated
from reconstruction.decoding.decode import Decoded, DecodeOptions, decode
from reconstruction.errors import CaptureError, InputError
from reconstruction.patterns import AXES
from reconstruction.pixel_shape import width_over_height
from reconstruction.rig.sensor import SensorNoise

# Formats of recorded images; a folder with such files but without a description is an error.
RECORDED = {".png", ".tif", ".tiff", ".bmp", ".exr", ".nc"}
# Half side of the window in which the phase is fitted, in feature distances.
WINDOW = 1.1
# The spatial filter is off, because it would spread the phase over the edge of a dot.
UNFILTERED = DecodeOptions(filter_taps=0)
# Width of the excluded border of the white print, as a share of the feature distance; at least one
# pixel.
EDGE_SHARE = 0.03

# Window in which the maximum is the local white level, as a share of the image height. It is larger
# than any dot or square, and small enough to follow the fall-off of the projector's light.
WINDOW_SHARE = 0.25
WORK_HEIGHT_PX = 180


BoardCapture = UncalibratedCapture
"""Frames of one board pose."""


def read_board_capture(folder: Path | str) -> BoardCapture:
    """Read the capture of one board pose, which needs no calibration file.

    Raises
    ------
    CaptureError : a file is missing, damaged or does not fit the others; the frames are clearly in
        another order than described; or there are no patterns along an axis

    Notes
    -----
    White and black frames are not needed with fringes: the image of the board is the mean of the
    phase frames.
    """
    capture = read_uncalibrated(folder)
    if capture.patterns.axes != AXES:
        raise CaptureError(f"{folder}: a board needs fringes along both axes; record them as well")
    return capture


def pose_folders(folder: Path | str) -> list[Path]:
    """Return the folders inside `folder` with a capture each, in the order of their names.

    Raises
    ------
    CaptureError : `folder` is missing or has no captures, or a folder in it has images but no
        capture.toml
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise CaptureError(f"{folder}: no such folder; give one with a folder per board pose")
    inside = sorted(path for path in folder.iterdir() if path.is_dir())
    poses = [path for path in inside if described(path) is not None]
    for path in inside:
        if path not in poses and any(item.suffix.lower() in RECORDED for item in path.iterdir()):
            raise CaptureError(
                f"{path}: holds images but no {DESCRIPTION_FILE}; write one (copy that of another "
                "pose), or move the folder elsewhere"
            )
    if not poses:
        raise CaptureError(
            f"{folder}: no folder with {DESCRIPTION_FILE} in it; give the folder that contains one "
            "capture folder per board pose"
        )
    return poses


@dataclass(frozen=True, eq=False)
class Observation:
    """Measured features of a board in one pose, the input of a calibration.

    Parameters
    ----------
    name : name of the pose, for messages
    points_mm : (n, 3) float, positions of the features in the board frame
    radii_mm : (n,) float, radii of the dots; 0 for corners
    camera_px : (n, 2) float, column and row; for a dot the centre of its image, an ellipse, not the
        image of its centre
    projector_px : (n, 2) float, decoded projector column and row at `camera_px`
    slopes : (n, 2, 2) float, d(projector column, row) / d(camera x, y) at `camera_px`
    ids : (n,) int, ids of the features on the board
    camera_size_px, projector_size_px : image size (width, height)
    projector_pixel_ratio : width of a projector pixel divided by its height, as the capture states
    """

    name: str
    points_mm: FloatArray
    radii_mm: FloatArray
    camera_px: FloatArray
    projector_px: FloatArray
    slopes: FloatArray
    ids: Indices
    camera_size_px: tuple[int, int]
    projector_size_px: tuple[int, int]
    projector_pixel_ratio: float = 1.0


def observe(capture: BoardCapture, board: Board, name: str = "pose") -> Observation:
    """Measure the features of a board in a capture: camera and projector coordinates.

    Parameters
    ----------
    capture : frames of one board pose
    board : the recorded board
    name : name of the pose, for messages

    Raises
    ------
    InputError : the board is not recognised, or no fringes are decoded on it
    """
    try:
        return _observe(capture, board, name)
    except InputError as error:
        raise InputError(f"{name}: {error}") from error


def _observe(capture: BoardCapture, board: Board, name: str) -> Observation:
    decoded = decode(
        capture.stack,
        capture.patterns,
        capture.sensor,
        UNFILTERED,
        capture.scale,
        response=capture.response,
    )
    relative = relative_brightness(brightness(decoded, capture.sensor))
    threshold = ink_threshold(relative)
    ids, camera_px = _features(board, relative, threshold)
    points_mm = board.points_mm[ids]
    spacing_px = _spacing_px(points_mm, camera_px)
    margin_px = max(1, round(EDGE_SHARE * spacing_px))
    white = white_print(relative, 0.5 * (1.0 + threshold), margin_px)
    there = projector_points(decoded, white, camera_px, WINDOW * spacing_px)
    located = there.located
    if located.sum() < 6:
        raise InputError(f"only {located.sum()} features have decoded fringes round them, needed 6")
    radii = board.radii_mm[ids] if isinstance(board, DotBoard) else np.zeros(len(ids))
    rows, cols = capture.stack.shape[1:]
    return Observation(
        name=name,
        points_mm=points_mm[located],
        radii_mm=radii[located],
        camera_px=camera_px[located],
        projector_px=there.pixels_px[located],
        slopes=there.slopes[located],
        ids=ids[located],
        camera_size_px=(cols, rows),
        projector_size_px=(capture.patterns.width_px, capture.patterns.height_px),
        projector_pixel_ratio=width_over_height(capture.patterns.pixel_ratio),
    )


def _features(board: Board, relative: FloatImage, threshold: float) -> tuple[Indices, FloatArray]:
    """Return the ids (n,) and the camera positions (n, 2), px, of the visible features."""
    if not isinstance(board, DotBoard):
        return find_corners(board, relative)
    dots = find_dots(relative, threshold)
    ids, members = label_dots(board, dots)
    centres, whole = refine_centres(relative, dots.chosen(np.array(members)))
    return np.array(ids)[whole], centres[whole]


def _spacing_px(points_mm: FloatArray, camera_px: FloatArray) -> float:
    """Return the image distance, px, of neighbouring features in the middle of the visible ones."""
    H = fit_homography(points_mm[:, :2], camera_px)
    middle = points_mm[:, :2].mean(axis=0)
    gaps = np.linalg.norm(points_mm[:, np.newaxis, :2] - points_mm[:, :2], axis=-1)
    step_mm = float(gaps[gaps > 0.0].min())
    ends = apply_homography(H, middle + step_mm * np.array([[0.0, 0], [1, 0], [0, 1]]))
    return float(np.mean(np.linalg.norm(ends[1:] - ends[0], axis=1)))


def brightness(decoded: Decoded, sensor: SensorNoise) -> FloatImage:
    """Return the mean of all phase frames minus the black level, (row, col) DN.

    It contains no fringes and little noise.
    """
    mean_dn = 0.5 * (decoded.column.mean_dn + decoded.row.mean_dn)
    above_dn = np.maximum(mean_dn - np.float32(sensor.black_level_dn), 0.0)
    return np.asarray(above_dn, dtype=np.float32)


def relative_brightness(image_dn: FloatImage) -> FloatImage:
    """Return the brightness (row, col) divided by that of white print nearby; white is about 1.

    The divisor is at least 5 % of the largest brightness in the image.

    Parameters
    ----------
    image_dn : (row, col) brightness above the black level, DN

    Raises
    ------
    InputError : no pixel is brighter than the black level
    """
    rows, cols = image_dn.shape
    if not image_dn.max() > 0.0:
        raise InputError("the board image is black: no projector light reached the camera")
    scale = min(1.0, WORK_HEIGHT_PX / rows)
    small = cv2.resize(image_dn, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    side = max(3, round(WINDOW_SHARE * small.shape[0]))
    white = cv2.blur(cv2.dilate(small, np.ones((side, side), np.uint8)), (side, side))
    white = cv2.resize(white, (cols, rows), interpolation=cv2.INTER_LINEAR)
    # Lower limit of the white level: outside the board there is no white print.
    floor = np.float32(0.05) * image_dn.max()
    return np.asarray(image_dn / np.maximum(white, floor), dtype=np.float32)


def ink_threshold(relative: FloatImage) -> float:
    """Return the relative brightness that separates ink from white print (Otsu 1979)."""
    levels = np.clip(relative * 200.0, 0, 255).astype(np.uint8)
    return float(cv2.threshold(levels, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)[0]) / 200.0


def white_print(relative: FloatImage, threshold: float, margin_px: int) -> BoolImage:
    """Return the mask (row, col) bool of the white pixels more than `margin_px` away from ink.

    Pixels on an edge are left out, because their phase is biased towards that of the brighter side.

    Parameters
    ----------
    relative : (row, col) brightness relative to white print
    threshold : relative brightness above which a pixel is white
    """
    white = (relative > threshold).astype(np.uint8)
    kernel = np.ones((2 * margin_px + 1, 2 * margin_px + 1), np.uint8)
    return np.asarray(cv2.erode(white, kernel, borderValue=1), dtype=np.bool_)
