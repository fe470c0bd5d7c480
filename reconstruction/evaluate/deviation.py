"""Compute the deviation of points from a known surface after an alignment; lengths in mm.

The alignment is the "best fit" of coordinate metrology: a rigid motion of the points, without a
change of scale, that makes the sum of squared distances least. `none` does not move the points,
`offset` shifts them along z, `offset_tilt` also tilts them, `rigid` shifts and rotates them with
all six degrees of freedom. Degrees of freedom that the surface does not constrain, such as the
rotation of a ball, are zero.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import Alignment as Alignment
from reconstruction.arrays import FloatArray
from reconstruction.errors import FitError
from reconstruction.evaluate.estimates import FittedDimension
from reconstruction.evaluate.fit import inliers, p95_of_size, rms

ALIGNMENTS: tuple[Alignment, ...] = ("none", "offset", "offset_tilt", "rigid")
Distance = Callable[[FloatArray], FloatArray]
"""Function that returns signed distances (n,), mm, of points (n, xyz) from a surface, positive
outside."""

_FREE = {"none": 0, "offset": 1, "offset_tilt": 3, "rigid": 6}
# The second pass corrects for the surface's curvature; a third has no effect.
_TURNS = 2
_STEP_MM = 1e-4
# Singular values below this ratio to the largest one belong to motions that shift the surface along
# itself; they are not 0 because of rounding and facets.
_STIFF = 1e-3
_DISPERSION = (0.025, 0.975)
_WINDOW = 0.01


@dataclass(frozen=True, eq=False)
class Deviations:
    """Deviations of points from a surface after alignment, and the motion of the alignment.

    Attributes
    ----------
    deviation_mm : (n,) signed distances along the surface's normal, positive outside
    points_mm : (n, xyz) the aligned points
    offset_mm : shift of the centroid of the points along z
    tilt_deg : angle of the rotation of the points
    """

    deviation_mm: FloatArray
    points_mm: FloatArray
    offset_mm: float
    tilt_deg: float

    def rms(self, upward: FloatArray) -> FittedDimension:
        """Return the root mean square of the deviations, mm, with its derivatives.

        Parameters
        ----------
        upward : (n,) z component of the surface's unit normal at each point
        """
        value, count = rms(self.deviation_mm), len(self.deviation_mm)
        slope = upward * self.deviation_mm / max(count * value, 1e-12)
        return FittedDimension(value, slope, self.deviation_mm, np.ones(count, bool))

    def form(self, upward: FloatArray) -> FittedDimension:
        """Return the width, mm, of the band with the middle 95 % of the deviations.

        This is D95 % of ISO 10360-8. The result includes the derivatives of the width by the
        heights of the points. For them, each end of the band is taken as the mean of the points
        next to it in rank: 1 % of all points below and 1 % above.

        Parameters
        ----------
        upward : (n,) z component of the surface's unit normal at each point
        """
        low, high = np.quantile(self.deviation_mm, _DISPERSION)
        order = np.argsort(self.deviation_mm)
        slope = np.zeros(len(order))
        half = max(1, round(_WINDOW * len(order)))
        for share, sign in zip(_DISPERSION, (-1.0, 1.0), strict=True):
            at = round(share * (len(order) - 1))
            near = order[max(0, at - half) : at + half + 1]
            slope[near] += sign * upward[near] / len(near)
        used = np.ones(len(order), bool)
        return FittedDimension(float(high - low), slope, self.deviation_mm, used)

    @property
    def p95_mm(self) -> float:
        """95th percentile of the absolute deviations, mm."""
        return p95_of_size(self.deviation_mm)


def normals_of(points_mm: FloatArray, distance: Distance) -> FloatArray:
    """Return the unit normals (n, xyz) of a surface nearest to each of the points (n, xyz).

    They are gradients of the distance, by central differences of +-0.1 um.
    """
    steps = np.eye(3) * _STEP_MM
    sides = [distance(points_mm + step) - distance(points_mm - step) for step in steps]
    gradient = np.stack(sides, axis=-1) / (2 * _STEP_MM)
    return np.asarray(gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-9))


def deviations(
    points_mm: FloatArray, distance: Distance, alignment: Alignment, normals: FloatArray
) -> Deviations:
    """Align points to a surface, and return their deviations from it.

    Parameters
    ----------
    points_mm : (n, xyz) float
    distance : signed distance from the surface
    alignment : degrees of freedom of the alignment, see the module docstring
    normals : (n, xyz) unit normals of the surface nearest to each point, see `normals_of`

    Raises
    ------
    FitError : there are fewer points than the alignment's degrees of freedom plus four
    """
    freedoms = _FREE[alignment]
    if len(points_mm) < freedoms + 4:
        raise FitError(f"{len(points_mm)} points do not fix an alignment by {alignment}")
    centre, moved = points_mm.mean(axis=0), points_mm
    motion = np.zeros(6)
    for _ in range(_TURNS if freedoms else 0):
        left = distance(moved)
        columns = _columns(moved - centre, normals)[:, :freedoms]
        used = inliers(left)
        step = np.linalg.pinv(columns[used], rcond=_STIFF) @ -left[used]
        motion[:freedoms] += step
        moved = _moved(points_mm - centre, motion) + centre
    turned_deg = float(np.rad2deg(np.linalg.norm(motion[[1, 2, 5]])))
    return Deviations(distance(moved), moved, float(motion[0]), turned_deg)


def _columns(lever_mm: FloatArray, normals: FloatArray) -> FloatArray:
    """Return the derivatives (n, 6) of the distances by the six motions of an alignment.

    The motions are: shift along z, rotation about x and y, shift along x and y, rotation about z.
    """
    turns = np.cross(lever_mm, normals)
    columns = [normals[:, 2], turns[:, 0], turns[:, 1], normals[:, 0], normals[:, 1], turns[:, 2]]
    return np.column_stack(columns)


def _moved(lever_mm: FloatArray, motion: FloatArray) -> FloatArray:
    """Return points (n, xyz), relative to their centroid, after a rotation about it and a shift.

    motion : (6,) in the order of `_columns`, mm and rad
    """
    turn, shift = motion[[1, 2, 5]], motion[[3, 4, 0]]
    angle = float(np.linalg.norm(turn))
    if angle:
        axis = turn / angle
        across = np.cross(axis, lever_mm)
        lever_mm = lever_mm + np.sin(angle) * across + (1 - np.cos(angle)) * np.cross(axis, across)
    return np.asarray(lever_mm + shift)
