"""Definitions of the calibration boards: positions of their features and of their ink.

Board frame: x right, y up, z out of the printed face, origin in the middle of the pattern, mm.
A feature is a dot or an inner corner. Columns and rows of features are counted from the top left;
the id of a feature is row * columns + column. The printing and the detection of a board use these
definitions.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError, require_integer, require_number

Indices = NDArray[np.integer[Any]]
MARKER_DICTIONARY = "DICT_4X4_250"
# Resolution, texels per square, of the image from which a ChArUco board is printed.
MARKER_TEXELS = 60


@dataclass(frozen=True)
class DotBoard:
    """Board with a square grid of dark dots on white; three of the dots are larger.

    The larger dots are a dot near the middle, the dot two columns to its right and the dot one row
    above it. They identify the visible part of the board and its rotation. A mirrored image of the
    board is rejected.

    Parameters
    ----------
    columns, rows : number of columns and rows of dots
    pitch_mm : distance of neighbouring dots
    dot_diameter_mm : diameter of the normal dots
    fiducial_diameter_mm : diameter of the three larger dots
    """

    columns: int
    rows: int
    pitch_mm: float
    dot_diameter_mm: float
    fiducial_diameter_mm: float

    def __post_init__(self) -> None:
        require_integer("board columns", self.columns, 4, 1000)
        require_integer("board rows", self.rows, 4, 1000)
        require_number("board pitch_mm", self.pitch_mm, 0.0, open_low=True)
        # Below a ratio of 1.4 of the diameters the areas differ by less than a factor of two, which
        # blur can hide. Above 0.72 of the pitch the white ring around a dot, from which brightness
        # and phase are measured, is too narrow.
        require_number("board dot_diameter_mm", self.dot_diameter_mm, 0.0, open_low=True)
        low_mm, high_mm = 1.4 * self.dot_diameter_mm, 0.72 * self.pitch_mm
        require_number("board fiducial_diameter_mm", self.fiducial_diameter_mm, low_mm, high_mm)

    @property
    def points_mm(self) -> FloatArray:
        """Centres of the dots in the order of their ids, (n, 3) mm, board frame."""
        return _grid_mm(self.columns, self.rows, self.pitch_mm)

    @property
    def radii_mm(self) -> FloatArray:
        """Radii of the dots in the order of their ids, (n,) mm."""
        radii = np.full(self.columns * self.rows, self.dot_diameter_mm / 2.0)
        radii[list(self.fiducial_ids)] = self.fiducial_diameter_mm / 2.0
        return radii

    @property
    def fiducial_ids(self) -> tuple[int, int, int]:
        """Ids of the larger dots: near the middle, two columns right of it, one row above it."""
        column, row = self.columns // 2 - 1, self.rows // 2
        origin = row * self.columns + column
        return origin, origin + 2, origin - self.columns

    def ink(self, x_mm: FloatArray, y_mm: FloatArray, edge_mm: float) -> FloatArray:
        """Return the share of ink, 0 to 1, (row, col), at board positions x (col,) and y (row,).

        At the edges of the print the share changes linearly over the width `edge_mm`.
        """
        centre = _grid_mm(self.columns, self.rows, self.pitch_mm)[0]
        column = np.clip(np.rint((x_mm - centre[0]) / self.pitch_mm), 0, self.columns - 1)
        row = np.clip(np.rint((centre[1] - y_mm) / self.pitch_mm), 0, self.rows - 1)
        dx = x_mm - centre[0] - column * self.pitch_mm
        dy = y_mm - centre[1] + row * self.pitch_mm
        ids = row.astype(int)[:, np.newaxis] * self.columns + column.astype(int)
        distance_mm = np.hypot(dx, dy[:, np.newaxis])
        return np.asarray(np.clip(0.5 + (self.radii_mm[ids] - distance_mm) / edge_mm, 0.0, 1.0))


@dataclass(frozen=True)
class Chessboard:
    """Board with a chessboard pattern without markers; the camera must view all of it.

    A rotation by 180 degrees may not be detected. It rotates the estimated pose of the board and
    has no other effect.

    Parameters
    ----------
    columns, rows : number of columns and rows of INNER corners
    square_mm : side length of a square
    """

    columns: int
    rows: int
    square_mm: float

    def __post_init__(self) -> None:
        require_integer("board columns", self.columns, 3, 1000)
        require_integer("board rows", self.rows, 3, 1000)
        require_number("board square_mm", self.square_mm, 0.0, open_low=True)

    @property
    def points_mm(self) -> FloatArray:
        """Positions of the inner corners in the order of their ids, (n, 3) mm, board frame."""
        return _grid_mm(self.columns, self.rows, self.square_mm)

    def ink(self, x_mm: FloatArray, y_mm: FloatArray, edge_mm: float) -> FloatArray:
        """Return the share of ink, 0 to 1, (row, col), at board positions x (col,) and y (row,).

        At the edges of the print the share changes linearly over the width `edge_mm`.
        """
        corner = self.points_mm[0]
        across = _square_wave(x_mm - corner[0], self.square_mm, edge_mm)
        down = _square_wave(corner[1] - y_mm, self.square_mm, edge_mm)
        return _on_plate(self, x_mm, y_mm) * (0.5 + 0.5 * across * down[:, np.newaxis])


@dataclass(frozen=True)
class CharucoBoard:
    """Chessboard with a coded marker in every white square (OpenCV's ChArUco, 4 x 4 bits).

    Parameters
    ----------
    columns, rows : number of columns and rows of INNER corners
    square_mm : side length of a square
    marker_mm : side length of a marker
    """

    columns: int
    rows: int
    square_mm: float
    marker_mm: float

    def __post_init__(self) -> None:
        require_integer("board columns", self.columns, 2, 30)
        require_integer("board rows", self.rows, 2, 30)
        if (self.columns + 1) * (self.rows + 1) > 500:
            raise InputError("board: more than 250 white squares; the dictionary has 250 markers")
        require_number("board square_mm", self.square_mm, 0.0, open_low=True)
        high_mm = 0.9 * self.square_mm
        require_number("board marker_mm", self.marker_mm, 0.0, high_mm, open_low=True)

    @property
    def points_mm(self) -> FloatArray:
        """Positions of the inner corners in the order of their ids, (n, 3) mm, board frame."""
        return _grid_mm(self.columns, self.rows, self.square_mm)

    def opencv(self) -> Any:
        """Return this board as a `cv2.aruco.CharucoBoard`."""
        import cv2

        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, MARKER_DICTIONARY))
        size = (self.columns + 1, self.rows + 1)
        return cv2.aruco.CharucoBoard(size, self.square_mm, self.marker_mm, dictionary)

    def ink(self, x_mm: FloatArray, y_mm: FloatArray, edge_mm: float) -> FloatArray:
        """Return the share of ink, 0 to 1, (row, col), at board positions x (col,) and y (row,).

        At the edges of the print the share changes linearly over the width `edge_mm`.
        """
        image = self.opencv().generateImage(
            ((self.columns + 1) * MARKER_TEXELS, (self.rows + 1) * MARKER_TEXELS)
        )
        ink = (image < 128).astype(np.float64)
        corner, half = self.points_mm[0], edge_mm / self.square_mm / 2.0
        across = (x_mm - corner[0]) / self.square_mm + 1.0
        down = (corner[1] - y_mm) / self.square_mm + 1.0
        ink = _box_average(ink, MARKER_TEXELS * (down - half), MARKER_TEXELS * (down + half))
        return _box_average(
            ink.T, MARKER_TEXELS * (across - half), MARKER_TEXELS * (across + half)
        ).T


Board = DotBoard | Chessboard | CharucoBoard


def _grid_mm(columns: int, rows: int, pitch_mm: float) -> FloatArray:
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    x_mm = (column - (columns - 1) / 2.0) * pitch_mm
    y_mm = ((rows - 1) / 2.0 - row) * pitch_mm
    return np.stack([x_mm, y_mm, np.zeros_like(x_mm)], axis=-1).reshape(-1, 3)


def _square_wave(offset_mm: FloatArray, square_mm: float, edge_mm: float) -> FloatArray:
    """Return a wave between -1 and 1 that changes sign at multiples of `square_mm`.

    The change is linear over the width `edge_mm`.
    """
    nearest = np.rint(offset_mm / square_mm)
    rise = np.clip(2.0 * (offset_mm - nearest * square_mm) / edge_mm, -1.0, 1.0)
    return np.asarray(np.where(nearest % 2.0 == 0.0, rise, -rise))


def _box_average(image: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the means of image rows between positions `low` and `high`, (n, columns).

    Parameters
    ----------
    image : (row, column); outside of it the value is 0
    low, high : (n,) ends of the n intervals; row k is between the positions k and k + 1
    """
    total = np.concatenate([np.zeros((1, image.shape[1])), np.cumsum(image, axis=0)])
    upper, lower = (_interpolate(total, np.clip(p, 0.0, len(image))) for p in (high, low))
    return np.asarray((upper - lower) / (high - low)[:, np.newaxis])


def _interpolate(table: FloatArray, position: FloatArray) -> FloatArray:
    first = np.minimum(position.astype(int), len(table) - 2)
    share = (position - first)[:, np.newaxis]
    return np.asarray((1.0 - share) * table[first] + share * table[first + 1])


def _on_plate(board: Chessboard, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    half_x = (board.columns + 1) / 2.0 * board.square_mm
    half_y = (board.rows + 1) / 2.0 * board.square_mm
    inside = (np.abs(x_mm) <= half_x) & (np.abs(y_mm) <= half_y)[:, np.newaxis]
    return np.asarray(inside, dtype=np.float64)
