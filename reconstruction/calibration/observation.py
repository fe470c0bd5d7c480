"""What one capture of a board says: features in camera and projector pixels."""

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import Doubles, FloatImage
from reconstruction.calibration.boards import Board, DotBoard, Indices
from reconstruction.calibration.captures import BoardCapture
from reconstruction.calibration.corners import find_corners
from reconstruction.calibration.dot_grid import label_dots
from reconstruction.calibration.dots import find_dots, refine_centres
from reconstruction.calibration.homography import apply_homography, fit_homography
from reconstruction.calibration.light_level import (
    brightness,
    ink_threshold,
    relative_brightness,
    white_print,
)
from reconstruction.calibration.projector_points import projector_points
from reconstruction.decoding.decode import DecodeOptions, decode
from reconstruction.errors import InputError

# Half side of the window in which the phase is fitted, in feature distances.
WINDOW = 1.1
# No filter: it would carry phase over the edge of a dot.
UNFILTERED = DecodeOptions(filter_taps=0)
# Edge pixels to leave out, as a share of the feature distance (at least one pixel).
EDGE_SHARE = 0.03


@dataclass(frozen=True, eq=False)
class Observation:
    """Features of one board pose.

    Parameters
    ----------
    name : of the pose, for messages
    points_mm : (n, 3) float, board frame
    radii_mm : (n,) float, of dots; 0 for corners
    camera_px : (n, 2) float; for dots the centre of the imaged ellipse, not the imaged centre
    projector_px : (n, 2) float, column and row of the place seen at `camera_px`
    slopes : (n, 2, 2) float, d(projector) / d(camera) on the board there
    ids : (n,) int
    camera_size_px, projector_size_px : width, height
    """

    name: str
    points_mm: Doubles
    radii_mm: Doubles
    camera_px: Doubles
    projector_px: Doubles
    slopes: Doubles
    ids: Indices
    camera_size_px: tuple[int, int]
    projector_size_px: tuple[int, int]


def observe(capture: BoardCapture, board: Board, name: str = "pose") -> Observation:
    """Find the board's features and where the projector sees them.

    Raises
    ------
    InputError : the board is not recognised, or no fringes are decoded on it; names the pose
    """
    try:
        return _observe(capture, board, name)
    except InputError as error:
        raise InputError(f"{name}: {error}") from error


def _observe(capture: BoardCapture, board: Board, name: str) -> Observation:
    decoded = decode(capture.stack, capture.patterns, capture.sensor, UNFILTERED, capture.scale)
    relative = relative_brightness(brightness(decoded, capture.sensor))
    threshold = ink_threshold(relative)
    ids, camera_px = _features(board, relative, threshold)
    points_mm = board.points_mm[ids]
    spacing_px = _spacing_px(points_mm, camera_px)
    margin_px = max(1, round(EDGE_SHARE * spacing_px))
    white = white_print(relative, 0.5 * (1.0 + threshold), margin_px)
    there = projector_points(decoded, white, camera_px, WINDOW * spacing_px)
    found = there.found
    if found.sum() < 6:
        raise InputError(f"only {found.sum()} features have decoded fringes round them, needed 6")
    radii = board.radii_mm[ids] if isinstance(board, DotBoard) else np.zeros(len(ids))
    rows, cols = capture.stack.shape[1:]
    return Observation(
        name=name,
        points_mm=points_mm[found],
        radii_mm=radii[found],
        camera_px=camera_px[found],
        projector_px=there.pixels_px[found],
        slopes=there.slopes[found],
        ids=ids[found],
        camera_size_px=(cols, rows),
        projector_size_px=(capture.patterns.width_px, capture.patterns.height_px),
    )


def _features(board: Board, relative: FloatImage, threshold: float) -> tuple[Indices, Doubles]:
    """Return ids (n,) and camera pixels (n, 2) of the features seen."""
    if not isinstance(board, DotBoard):
        return find_corners(board, relative)
    dots = find_dots(relative, threshold)
    ids, members = label_dots(board, dots)
    centres, found = refine_centres(relative, dots.chosen(np.array(members)))
    return np.array(ids)[found], centres[found]


def _spacing_px(points_mm: Doubles, camera_px: Doubles) -> float:
    """Return the image distance of two neighbouring features in the middle of the view."""
    H = fit_homography(points_mm[:, :2], camera_px)
    middle = points_mm[:, :2].mean(axis=0)
    gaps = np.linalg.norm(points_mm[:, np.newaxis, :2] - points_mm[:, :2], axis=-1)
    step_mm = float(gaps[gaps > 0.0].min())
    ends = apply_homography(H, middle + step_mm * np.array([[0.0, 0], [1, 0], [0, 1]]))
    return float(np.mean(np.linalg.norm(ends[1:] - ends[0], axis=1)))
