"""Undeformed coat of a domed gel: a photometric sensor measures its slopes relative to this shape.

A pixel images points along a straight line inside the gel, its line of sight. The line has the
inclination e, (downwards, to the right), mm per mm of height. On a surface with the slopes s the
height changes from one pixel to the next, at a distance P on a level surface, by

    s P (1 - z / D) / (1 - s . e),

because the imaged point also moves along its line of sight, and points at the height z are nearer
to the pinhole, at the distance D from the level surface z = 0. For a flat gel both are small and
are neglected. On the flank of a dome they are not: a slope of 0.3 under e = 0.15 changes by 5 %.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray, FloatImage
from reconstruction.errors import InputError, require_number

# Frame and unit of each array of `RestSurface`, for files.
_MEANING = {
    "rest_x_mm": "x of the undeformed coat, to the right",
    "rest_y_mm": "y of the undeformed coat, upwards",
    "rest_z_mm": "height of the undeformed coat",
    "rest_slope_row": "slope of the undeformed coat down the rows",
    "rest_slope_col": "slope of the undeformed coat along the columns",
    "sight_row": "inclination of the line of sight down the rows, per height",
    "sight_col": "inclination of the line of sight along the columns, per height",
}


@dataclass(frozen=True, eq=False)
class RestSurface:
    """Undeformed coat of a domed gel, and the camera's lines of sight inside the gel, per pixel.

    Parameters
    ----------
    points_mm : (row, col, xyz) float32, the point that the pixel images: x right, y up from the
        middle of the image, z towards the camera
    slopes : (2, row, col) float32, mm/mm, downwards and to the right
    sight : (2, row, col) float32, displacement of the imaged point, downwards and to the right, per
        mm that the coat moves towards the camera; 0 for a telecentric camera

    Raises
    ------
    InputError : shapes differ, or a value is not finite
    """

    points_mm: FloatImage
    slopes: FloatImage
    sight: FloatImage

    def __post_init__(self) -> None:
        rows_cols = self.points_mm.shape[:2]
        shapes = (*rows_cols, 3), (2, *rows_cols), (2, *rows_cols)
        for name, shape in zip(("points_mm", "slopes", "sight"), shapes, strict=True):
            values = getattr(self, name)
            if values.shape != shape or values.dtype != np.float32:
                raise InputError(
                    f"rest surface: {name} is {values.dtype} {values.shape}; give {shape} float32"
                )
            if not bool(np.all(np.isfinite(values))):
                raise InputError(f"rest surface: {name} has values that are not finite")

    @classmethod
    def of_sphere(
        cls,
        shape: tuple[int, int],
        pitch_mm: float,
        radius_mm: float,
        view_distance_mm: float = 0.0,
    ) -> "RestSurface":
        """Return a spherical dome whose apex is in the middle of the image, at z = 0.

        Parameters
        ----------
        shape : rows and columns of the images
        pitch_mm : distance on the plane z = 0 of the points that adjacent pixels image
        radius_mm : radius of the undeformed coat, which bulges away from the camera
        view_distance_mm : distance D of the pinhole from z = 0 inside the gel, which is the
            distance in air times the refractive index of the gel; 0: a telecentric camera

        Raises
        ------
        InputError : a value is out of range, or the sphere does not fill the image
        """
        require_number("radius_mm", radius_mm, 0.0, open_low=True)
        require_number("view_distance_mm", view_distance_mm, 0.0, 10_000.0)
        rows, cols = shape
        row, col = np.indices(shape, dtype=np.float64)
        level = pitch_mm * np.stack([row - (rows - 1) / 2, col - (cols - 1) / 2])
        per_mm = 1.0 / view_distance_mm if view_distance_mm else 0.0
        height = _height_of_sphere(np.sum(level**2, axis=0), radius_mm, per_mm)
        down, right = level * (1.0 - height * per_mm)
        slopes = np.stack([down, right]) / (radius_mm - height)
        parts = np.stack([right, -down, height], axis=-1), slopes, -level * per_mm
        return cls(*(part.astype(np.float32) for part in parts))

    def points_at(self, height_mm: FloatImage) -> FloatArray:
        """Return the imaged points (row, col, xyz), mm, of a coat with heights (row, col), mm."""
        rest = self.points_mm.astype(np.float64)
        raised = height_mm - rest[..., 2]
        down, right = self.sight
        return np.stack(
            [rest[..., 0] + raised * right, rest[..., 1] - raised * down, rest[..., 2] + raised],
            axis=-1,
        )

    def relative_rise(
        self, slopes: FloatArray, pitch_mm: float, relief_mm: FloatArray | float = 0.0
    ) -> FloatArray:
        """Return the change of the height above the undeformed coat, (2, row, col), per pitch.

        Parameters
        ----------
        slopes : (2, row, col) mm/mm, slopes of the pressed coat
        pitch_mm : distance on the level surface z = 0 of the points that adjacent pixels image
        relief_mm : (row, col), height of the pressed coat above the undeformed one
        """
        undeformed = self._rise(self.slopes.astype(np.float64)) * self.widths(pitch_mm)
        return self._rise(slopes) * self.widths(pitch_mm, relief_mm) - undeformed

    def ball_axis(
        self, place_px: tuple[float, float], ball_radius_mm: float, pitch_mm: float
    ) -> tuple[tuple[float, float], float]:
        """Return row and column, px, of the axis of a ball in contact, and the pitch there, mm.

        In the middle of the contact, ball and undeformed dome have the same normal. On a flank, the
        ball's axis (parallel to z) is therefore not in the middle of the contact.

        Parameters
        ----------
        place_px : row and column of the middle of the contact, in the image
        pitch_mm : as for `relative_rise`
        """
        last = np.array(self.slopes.shape[1:]) - 1
        row, col = np.clip(np.rint(place_px), 0, last).astype(np.intp)
        slope = self.slopes[:, row, col].astype(np.float64)
        width_mm = pitch_mm * float(self.widths(pitch_mm)[row, col])
        offset_px = ball_radius_mm * slope / np.sqrt(1.0 + float(slope @ slope)) / width_mm
        return (place_px[0] + float(offset_px[0]), place_px[1] + float(offset_px[1])), width_mm

    def _rise(self, slopes: FloatArray) -> FloatArray:
        along = np.sum(slopes * self.sight, axis=0)
        return np.asarray(slopes / (1.0 - along))

    def widths(self, pitch_mm: float, relief_mm: FloatArray | float = 0.0) -> FloatArray:
        """Return the pitch at a relief above the undeformed coat over that on z = 0, (row, col)."""
        spread = np.gradient(self.sight[0], axis=0) + np.gradient(self.sight[1], axis=1)
        height_mm = self.points_mm[..., 2] + relief_mm
        return np.asarray(1.0 + height_mm * float(np.median(spread)) / 2.0 / pitch_mm)

    def arrays(self) -> dict[str, tuple[NDArray[Any], str]]:
        """Return arrays (row, col) with their meaning by name, for files; see `from_arrays`."""
        values = (*np.moveaxis(self.points_mm, -1, 0), *self.slopes, *self.sight)
        return {
            name: (value, meaning)
            for (name, meaning), value in zip(_MEANING.items(), values, strict=True)
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any]) -> "RestSurface | None":
        """Return the surface from stored arrays; None if there are none.

        Raises
        ------
        KeyError : some of the arrays are missing
        InputError : shapes differ, or a value is not finite
        """
        if not any(name in arrays for name in _MEANING):
            return None
        parts = [np.asarray(arrays[name], np.float32) for name in _MEANING]
        if any(part.shape != parts[0].shape or part.ndim != 2 for part in parts):
            raise InputError("rest surface: its arrays have different shapes")
        return cls(np.stack(parts[:3], axis=-1), np.stack(parts[3:5]), np.stack(parts[5:]))


def _height_of_sphere(squared_mm2: FloatArray, radius_mm: float, per_mm: float) -> FloatArray:
    """Return the height, mm, at which lines of sight meet a sphere with its apex at z = 0.

    A line passes z = 0 at the distance r from the axis, and the height z at r (1 - z / D). With
    u = 1 / D this gives (1 + r^2 u^2) z^2 - 2 (R + r^2 u) z + r^2 = 0.

    Parameters
    ----------
    squared_mm2 : r^2
    per_mm : u

    Raises
    ------
    InputError : a line does not meet the sphere on its side of the apex
    """
    square, half = 1.0 + squared_mm2 * per_mm**2, radius_mm + squared_mm2 * per_mm
    root = half**2 - square * squared_mm2
    height = (half - np.sqrt(np.maximum(root, 0.0))) / square
    if root.min() <= 0.0 or height.max() >= radius_mm:
        most = float(squared_mm2.max())
        least_mm = np.sqrt(most**2 * per_mm**2 + most) - most * per_mm
        raise InputError(
            f"radius_mm: found {radius_mm:g}, allowed more than {least_mm:.4g}: the dome must fill "
            "the image; give the radius of the undeformed coat, and crop the image to it"
        )
    return np.asarray(height)
