"""Height of a step between the highest and the lowest level (ISO 5436-1 type A1)."""

from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.errors import FitError
from reconstruction.evaluate.estimates import step_between
from twin.config.measurands import ObjectMeasurand
from twin.results.features import Feature
from twin.results.measurands import (
    MEASURANDS,
    Curve,
    FittedValue,
    MeasurandKind,
    SectionLine,
    fitted,
)
from twin.results.object_points import Heights, ObjectPoints, ObjectView

# Cells within this share of the step height from a level belong to the level.
_LEVEL_SHARE = 0.1


class IsoStepHeight(MeasurandKind):
    """Measurand: the height of a step, mm."""

    name = "step_height"
    summary = "between the highest and the lowest level (ISO 5436-1 A1)"
    hidden = True
    bound_name = "crb_step_um"

    def fit(
        self,
        request: ObjectMeasurand,
        feature: Feature,
        observed: ObjectView,
        points: ObjectPoints,
    ) -> FittedValue:
        """Fit two parallel planes to the two levels without their edges, see `levels`."""
        step_mm = self.requested_mm(request, feature)
        return step_of(points.part(points.touching), feature, observed, step_mm)

    def curves(self, points_mm: FloatArray, line: SectionLine, observed: ObjectView) -> list[Curve]:
        """Return the lines of both levels along the section."""
        place, z = line.position(points_mm[:, 0], points_mm[:, 1]), points_mm[:, 2]
        middle = (float(z.min()) + float(z.max())) / 2
        upper = z > middle
        design = np.column_stack([np.ones(len(z)), points_mm[:, :2], upper])
        plane: Any = np.linalg.lstsq(design, z, rcond=None)[0]
        ends = np.array([float(place.min()), float(place.max())])
        base = plane[0] + line.points(ends) @ plane[1:3]
        return [(ends, base), (ends, base + plane[3])]


def step_of(
    points: ObjectPoints, feature: Feature, observed: ObjectView, step_mm: float | None
) -> FittedValue:
    """Fit two parallel planes to the upper and the lower level of a step.

    Points near the edges of the levels are left out, as in ISO 5436-1 type A1. Heights are
    measured along the specimen's own z axis, also if the specimen is tilted.

    Parameters
    ----------
    step_mm : nominal step height, mm; None: the difference between the highest and the lowest cell

    Raises
    ------
    FitError : there is no point or no step, or a level has no cell after its edges are removed
    """
    if not len(points.points_mm):
        raise FitError("step: no point of the object in the given ranges")
    xy, upright = points.points_mm[:, :2], feature.world_from_own.rotation[:, 2]
    heights = Heights.over(observed.surface, xy).across(upright)
    upper, lower = levels(heights, step_mm)
    at = heights.cells_of(xy)
    return fitted(points, step_between(xy, points.points_mm @ upright, upper[at], lower[at]))


def levels(heights: Heights, step_mm: float | None = None) -> tuple[BoolImage, BoolImage]:
    """Return masks (row, col) of the upper and of the lower level of a step without their edges.

    The upper level has the cells at most 0.1 x the step below the highest cell. The lower level has
    the cells within 0.1 x the step of the height one step below the highest cell. W, the width of a
    ridge, is twice the largest distance of a cell of the upper level from the level's edge.

    Of the upper level, the cells at least W / 3 from its edge are kept. Of the lower level, the
    cells are kept that are W / 3 to W from the upper level and at least W / 3 from the lower
    level's own edge. If the lower level is narrower than W, W / 3 is replaced by 1/3 of its own
    width.

    Parameters
    ----------
    step_mm : step height, mm; None: the difference between the highest and the lowest cell

    Raises
    ------
    FitError : there is no step, or the specimen is not in the given ranges
    """
    z, known = heights.z_mm, np.isfinite(heights.z_mm)
    if not known.any():
        raise FitError("step: no specimen in the given ranges")
    top = float(z[known].max())
    step = top - float(z[known].min()) if step_mm is None else step_mm
    if step <= 0:
        raise FitError("step: the specimen is flat in the given ranges")
    near = _LEVEL_SHARE * step
    upper, lower = np.abs(z - top) <= near, np.abs(z - (top - step)) <= near
    if upper.all() or not lower.any():
        raise FitError(f"step: the specimen has no level {step:g} mm below its top there")
    inside, clear = (_inward_mm(level, heights.pitch_mm) for level in (upper, lower))
    width = 2 * float(inside.max())
    margin = min(width, 2 * float(clear.max())) / 3
    away = np.asarray(distance_transform_edt(~upper)) * heights.pitch_mm
    lower_inside = lower & (clear >= margin) & (away >= margin) & (away <= width)
    return upper & (inside >= width / 3), lower_inside


def _inward_mm(level: BoolImage, pitch_mm: float) -> FloatArray:
    return np.asarray(distance_transform_edt(level), np.float64) * pitch_mm


MEASURANDS.register(IsoStepHeight())
