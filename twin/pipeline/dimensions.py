"""Fit dimensions to a part of a measured surface, as defined in `reconstruction.evaluate`."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, at_pixels
from reconstruction.errors import InputError
from reconstruction.evaluate import (
    areal_roughness,
    bar_width,
    fit_ball,
    fit_cylinder,
    flatness,
    step_height,
)
from reconstruction.evaluate.fit import rms
from reconstruction.evaluate.surface import height_map
from reconstruction.pipeline import read_reconstruction
from reconstruction.triangulation import PointMap

Shape = Literal["plane", "ball", "cylinder", "bar", "step", "roughness"]
Range = tuple[float, float]

RECONSTRUCTION_FILE = "reconstruction.nc"


@dataclass(frozen=True)
class Region:
    """Part of the surface in which a dimension is fitted, and options of the fit.

    Attributes
    ----------
    x_mm, y_mm, z_mm : (lowest, highest) world coordinates of the part; None: no limit
    along : world axis that is parallel to the cylinder, bar or step
    fraction : level over the height of a bar or step at which its edges are located
    nesting_mm : nesting index of the roughness filter
    """

    x_mm: Range | None = None
    y_mm: Range | None = None
    z_mm: Range | None = None
    along: Literal["x", "y"] = "y"
    fraction: float = 0.5
    nesting_mm: float = 0.8


def dimensions(folder: Path, shape: Shape, region: Region) -> dict[str, float]:
    """Return the dimensions of a shape fitted to a part of a result's surface, by name.

    The units are in the names.

    Parameters
    ----------
    folder : result folder of `twin measure` or `twin reconstruct`, by a method with fringes

    Raises
    ------
    InputError : there are no points in the part, or the points do not determine the shape
    """
    file = folder / RECONSTRUCTION_FILE
    if not file.exists():
        raise InputError(
            f"{folder}: no {RECONSTRUCTION_FILE}; give a result of twin measure or twin reconstruct"
        )
    points = read_reconstruction(file).point_map
    if shape in _OF_POINTS:
        return _OF_POINTS[shape](_points_in(points, region), region)
    return _OF_HEIGHTS[shape](_heights_in(points, region), region)


@dataclass(frozen=True, eq=False)
class _Heights:
    """Height map of a part of a surface.

    x_mm (col,) increases, y_mm (row,) decreases; z_mm and valid are (row, col).
    """

    x_mm: FloatArray
    y_mm: FloatArray
    z_mm: FloatArray
    valid: BoolImage
    pitch_mm: float

    def profile(self, along: str) -> tuple[FloatArray, FloatArray]:
        """Return positions across an axis, increasing, and the mean heights along that axis; mm.

        Parameters
        ----------
        along : "x" or "y", the axis along which the valid heights are averaged
        """
        axis = 0 if along == "y" else 1
        count = self.valid.sum(axis=axis)
        place_mm, filled = (self.x_mm if along == "y" else self.y_mm), count > 0
        z_mm = np.sum(self.z_mm * self.valid, axis=axis)[filled] / count[filled]
        order = np.argsort(place_mm[filled])
        return place_mm[filled][order], z_mm[order]


def _within(values_mm: FloatArray, bounds_mm: Range | None) -> BoolImage:
    low, high = bounds_mm or (-np.inf, np.inf)
    inside: BoolImage = (values_mm >= low) & (values_mm <= high)
    return inside


def _points_in(points: PointMap, region: Region) -> FloatArray:
    """Return the valid points (n, xyz) within the limits of a region, world, mm."""
    points_mm = at_pixels(points.points_world_mm, points.valid).astype(np.float64)
    for axis, bounds_mm in enumerate((region.x_mm, region.y_mm, region.z_mm)):
        points_mm = points_mm[_within(points_mm[:, axis], bounds_mm)]
    if not len(points_mm):
        raise InputError("no valid point in the given ranges of x, y and z; widen them")
    return points_mm


def _heights_in(points: PointMap, region: Region) -> _Heights:
    """Return the height map within the limits of a region."""
    grid = height_map(points)
    rows, cols = _within(grid.y_mm, region.y_mm), _within(grid.x_mm, region.x_mm)
    inside = np.ix_(rows, cols)
    z_mm = grid.z_mm[inside].astype(np.float64)
    valid = grid.valid[inside] & _within(z_mm, region.z_mm)
    if not valid.any():
        raise InputError("no valid height in the given ranges of x, y and z; widen them")
    return _Heights(grid.x_mm[cols], grid.y_mm[rows], z_mm, valid, grid.pitch_mm)


def _kept(used: BoolImage) -> dict[str, float]:
    return {"points": int(used.sum()), "outliers": int((~used).sum())}


def _plane(points_mm: FloatArray, _: Region) -> dict[str, float]:
    fitted = flatness(points_mm)
    flat = {"flatness_um": 1e3 * fitted.peak_to_valley_mm, "flatness_rms_um": 1e3 * fitted.rms_mm}
    return _kept(fitted.inliers) | flat


def _ball(points_mm: FloatArray, _: Region) -> dict[str, float]:
    fitted = fit_ball(points_mm)
    return _kept(fitted.inliers) | {
        "radius_mm": fitted.radius_mm,
        "radius_sigma_um": 1e3 * fitted.radius_sigma_mm,
        "form_um": 1e3 * fitted.form_mm,
        "rmse_um": 1e3 * fitted.stats.rmse_mm,
    }


def _cylinder(points_mm: FloatArray, region: Region) -> dict[str, float]:
    fitted = fit_cylinder(points_mm, axis=(1, 0, 0) if region.along == "x" else (0, 1, 0))
    return _kept(fitted.inliers) | {
        "radius_mm": fitted.radius_mm,
        "cylindricity_um": 1e3 * float(np.ptp(fitted.residuals_mm)),
        "rmse_um": 1e3 * rms(fitted.residuals_mm),
    }


def _bar(heights: _Heights, region: Region) -> dict[str, float]:
    fitted = bar_width(*heights.profile(region.along), region.fraction)
    return {"width_mm": fitted.width_mm, "height_mm": fitted.height_mm}


def _step(heights: _Heights, region: Region) -> dict[str, float]:
    place_mm, z_mm = heights.profile(region.along)
    edges = bar_width(place_mm, z_mm, region.fraction)
    fitted = step_height(place_mm, z_mm, edges.left_mm, edges.right_mm)
    return {"step_height_mm": fitted.height_mm, "step_rms_um": 1e3 * fitted.rms_mm}


def _roughness(heights: _Heights, region: Region) -> dict[str, float]:
    roughness = areal_roughness(heights.z_mm, heights.valid, heights.pitch_mm, region.nesting_mm)
    return {
        "sa_um": 1e3 * roughness.sa_mm,
        "sq_um": 1e3 * roughness.sq_mm,
        "sz_um": 1e3 * roughness.sz_mm,
    }


_OF_POINTS: dict[str, Callable[[Any, Region], dict[str, float]]] = {
    "plane": _plane,
    "ball": _ball,
    "cylinder": _cylinder,
}
_OF_HEIGHTS: dict[str, Callable[[Any, Region], dict[str, float]]] = {
    "bar": _bar,
    "step": _step,
    "roughness": _roughness,
}
