"""Fit what a measurand asks for to the points of an object.

Each fit takes points in the world and returns a value with its slope by each point's height: mm,
but for the resolution, a pitch. Only points where the object is touched (or seen) take part: where
an elastomer spans freely its surface is not the object's. Where fits differ from a caliper, the
docs say so (docs/evaluation.md).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import distance_transform_edt

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.compensation import bar_under_sheet
from reconstruction.errors import FitError
from reconstruction.evaluate import BarWidth, bar_width
from reconstruction.evaluate.deviation import deviations, normals_of
from reconstruction.evaluate.estimates import (
    FittedDimension,
    GrooveFit,
    ball_radius,
    cylinder_radius,
    step_between,
    v_groove,
    wave_depth,
)
from twin.config.measurands import ObjectMeasurand
from twin.config.nominal import NominalBar, NominalGrating, NominalGroove, NominalRod
from twin.results.features import Feature, bar_places, nominal_mm
from twin.results.object_points import Heights, ObjectPoints, SeenObject
from twin.results.under_sheet import ObjectUnderSheet

# Of a rod's or ball's radius: beyond it a wall is too steep to be seen from above.
_CAP_SHARE = 0.9
# Of a step: levels are known to so much of it.
_LEVEL_SHARE = 0.1
_SECTION_MM = 2.0
# Cells of a sheet's contact that a fit needs, as `reconstruction.compensation.parts_of`.
_LEAST_CELLS = 30
# Of a groove's or a wave's parts that must be touched each.
_LEAST_IN_PART, _PARTS_OF_WAVE = 3, 8
# Grooves narrower than this part of the contact's blur look touched where the sheet spans them.
_LEAST_PITCH_OVER_BLUR = 6.0
_LEAST_IN_BIN = 3
KEPT_SHARE = 0.5
"""Of a grating's depth that must be left for it to be resolved: ISO 25178-600's lateral period
limit."""
_SIGMAS_ABOVE_NOISE = 3.0


@dataclass(frozen=True, eq=False)
class FittedValue:
    """A fitted value, and the points that it rests on.

    Attributes
    ----------
    value : in mm
    noise_mm : standard uncertainty from the points
    points_mm : (n, xyz) the points that took part
    estimate : how the value follows from the heights of `of`; None where that is no fit
    of : the points that were looked at
    """

    value: float
    noise_mm: float
    points_mm: FloatArray
    estimate: FittedDimension | None = None
    of: ObjectPoints | None = None


Fitter = Callable[[ObjectMeasurand, Feature, SeenObject, ObjectPoints], FittedValue]


def fit(
    asked: ObjectMeasurand, feature: Feature, seen: SeenObject, points: ObjectPoints
) -> FittedValue:
    """Fit one quantity to measured points, or to the true face's.

    Raises
    ------
    FitError : the points do not determine it
    """
    fitted = _FITTERS[asked.quantity](asked, feature, seen, _where(asked, points))
    require_determined(asked.quantity, fitted.noise_mm, fitted.points_mm)
    return fitted


def require_determined(quantity: str, noise_mm: float, points_mm: FloatArray) -> None:
    """Refuse a fit that noise leaves open by more than the extent of its points: no measurement.

    A groove that the coat does not show has any width, a flat face any radius.

    Parameters
    ----------
    noise_mm : standard deviation of the fitted value by noise
    points_mm : (n, xyz) float, mm; world

    Raises
    ------
    FitError : names both lengths
    """
    extent_mm = float(np.ptp(points_mm[:, :2], axis=0).max()) if len(points_mm) else 0.0
    if noise_mm > extent_mm:
        raise FitError(
            f"{quantity}: not determined, noise leaves it open by {noise_mm:.3g} mm (1 sigma), "
            f"more than the {extent_mm:.3g} mm that its points extend over"
        )


def _where(asked: ObjectMeasurand, points: ObjectPoints) -> ObjectPoints:
    kept = np.ones(len(points.points_mm), bool)
    for axis, bounds in enumerate((asked.x_mm, asked.y_mm)):
        if bounds is not None:
            kept &= (points.points_mm[:, axis] >= bounds[0]) & (
                points.points_mm[:, axis] <= bounds[1]
            )
    return points.part(kept)


def _fitted(
    points: ObjectPoints, estimate: FittedDimension, value: float | None = None
) -> FittedValue:
    used = points.points_mm[estimate.used]
    shown = estimate.value if value is None else value
    return FittedValue(shown, points.noise_mm(estimate), used, estimate, points)


def _radius(
    asked: ObjectMeasurand, feature: Feature, seen: SeenObject, points: ObjectPoints
) -> FittedValue:
    """Fit ball or rod where it is touched."""
    del seen
    if feature.balls:
        cap = _cap_of_ball(asked, feature, points)
        estimate, _ = ball_radius(cap.points_mm)
    else:
        cap, axis = _top_of_rod(asked, feature, points)
        estimate, _ = cylinder_radius(cap.points_mm, axis)
    return _fitted(cap, estimate)


def _enough(points: ObjectPoints, of: str) -> ObjectPoints:
    """Return points under a sheet, or those of another method, if they are enough for a fit."""
    cells = len(points.points_mm)
    if points.under is not None and cells < _LEAST_CELLS:
        raise FitError(f"the sheet touches {of} on {cells} cells, {_LEAST_CELLS} are needed")
    return points


def _cap_of_ball(asked: ObjectMeasurand, feature: Feature, points: ObjectPoints) -> ObjectPoints:
    balls = feature.balls
    if asked.number > len(balls):
        raise FitError(f"number: found {asked.number}, the specimen has {len(balls)} balls")
    x, y = points.points_mm[:, 0], points.points_mm[:, 1]
    squared = [(x - ball.x_mm) ** 2 + (y - ball.y_mm) ** 2 for ball in balls]
    own = squared[asked.number - 1]
    near = own <= np.min(squared, axis=0)
    near &= own <= (_CAP_SHARE * balls[asked.number - 1].radius_mm) ** 2
    return _enough(points.part(near & points.touching), f"ball {asked.number}")


def _top_of_rod(
    asked: ObjectMeasurand, feature: Feature, points: ObjectPoints
) -> tuple[ObjectPoints, FloatArray]:
    rods, own = feature.specimen.nominal(NominalRod), feature.own(points.points_mm)
    if asked.number > len(rods):
        raise FitError(f"radius {asked.number}: the specimen has no such ball or rod")
    rod = rods[asked.number - 1]
    axis, other = (0, 1) if rod.along == "x" else (1, 0)
    top = (np.abs(own[:, other] - rod.middle_mm) <= _CAP_SHARE * rod.radius_mm) & points.touching
    end_mm = rod.length_mm / 2 - rod.edge_radius_mm - 0.25 * rod.radius_mm
    top &= np.abs(own[:, axis]) <= end_mm
    cap = _enough(points.part(top), f"rod {asked.number}")
    return cap, feature.world_from_own.rotation[:, axis]


def _step(
    asked: ObjectMeasurand, feature: Feature, seen: SeenObject, points: ObjectPoints
) -> FittedValue:
    """Fit the two levels, their edges left out as in ISO 5436-1 type A1, see `levels`.

    Heights are across the specimen's own plane, however it is tilted.
    """
    points = points.part(points.touching)
    if not len(points.points_mm):
        raise FitError("step: no point of the object in the given ranges")
    xy, upright = points.points_mm[:, :2], feature.world_from_own.rotation[:, 2]
    heights = Heights.over(seen.surface, xy).across(upright)
    upper, lower = levels(heights, nominal_mm(feature, asked))
    at = heights.cells_of(xy)
    estimate = step_between(xy, points.points_mm @ upright, upper[at], lower[at])
    return _fitted(points, estimate)


def levels(heights: Heights, step_mm: float | None = None) -> tuple[BoolImage, BoolImage]:
    """Return the cells (row, col) of the upper and of the lower level without their edges.

    The upper level is what lies within a tenth of the step below the highest cell, the lower one
    what lies as near to a step below. W is twice the farthest that a cell of the upper level is
    from its edge, the width of a ridge. Kept are the upper level's cells W / 3 or more from the
    edge, and the lower level's ones up to W from the upper level and W / 3 from all else; where the
    lower level is narrower than W, a third of its own width.

    Parameters
    ----------
    step_mm : None: from the highest to the lowest cell

    Raises
    ------
    FitError : no step, or no cell is left
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
    kept = lower & (clear >= margin) & (away >= margin) & (away <= width)
    return upper & (inside >= width / 3), kept


def _inward_mm(level: BoolImage, pitch_mm: float) -> FloatArray:
    return np.asarray(distance_transform_edt(level), np.float64) * pitch_mm


def _depth(
    asked: ObjectMeasurand, feature: Feature, seen: SeenObject, points: ObjectPoints
) -> FittedValue:
    points = points.part(points.touching)
    for grating in feature.specimen.nominal(NominalGrating):
        return _wave(grating, feature, points)
    for nominal in feature.specimen.nominal(NominalGroove):
        near, groove = _groove(nominal, feature, points)
        return _fitted(near, groove.depth)
    return _step(asked, feature, seen, points)


def _wave(grating: NominalGrating, feature: Feature, points: ObjectPoints) -> FittedValue:
    inside = points.part(_within(feature, points, grating.length_x_mm, grating.length_y_mm))
    place = feature.own(inside.points_mm)
    _check_wave(grating.pitch_mm, place[:, 0], points)
    return _fitted(inside, wave_depth(place[:, 0], place[:, 2], grating.pitch_mm))


def _check_wave(pitch_mm: float, s_mm: FloatArray, points: ObjectPoints) -> None:
    """Raise FitError where crests and roots are not all touched, or nobody could know it."""
    if points.under is not None and pitch_mm < _LEAST_PITCH_OVER_BLUR * points.under.blur_mm:
        least_mm = _LEAST_PITCH_OVER_BLUR * points.under.blur_mm
        raise FitError(
            f"grooves: a pitch of {pitch_mm:g} mm is finer than the contact under a sheet is known "
            f"({least_mm:g} mm): whether it touches their roots is open"
        )
    part = np.floor(s_mm / pitch_mm * _PARTS_OF_WAVE).astype(int) % _PARTS_OF_WAVE
    touched = np.bincount(part, minlength=_PARTS_OF_WAVE) >= _LEAST_IN_PART
    if not touched.all():
        raise FitError(
            f"grooves: {touched.sum()} of {_PARTS_OF_WAVE} parts of the wave from crest to root "
            "are touched"
        )


def _groove(
    own: NominalGroove, feature: Feature, points: ObjectPoints
) -> tuple[ObjectPoints, GrooveFit]:
    """Fit a V groove to the points where it is touched: its face and both flanks must be."""
    near, place = _over_groove(own, feature, points.part(points.touching))
    fitted = v_groove(place[:, 0], place[:, 2], own.depth_mm, own.opening_mm)
    aside = 2 * (place[:, 0] - fitted.root_mm) / fitted.width.value
    parts = (aside > 1, aside < -1, (aside > 0) & (aside < 1), (aside < 0) & (aside > -1))
    if min(int(part.sum()) for part in parts) < _LEAST_IN_PART:
        raise FitError("groove: its face and both flanks must be touched")
    return near, fitted


def _within(feature: Feature, points: ObjectPoints, x_mm: float, y_mm: float) -> BoolImage:
    own = np.abs(feature.own(points.points_mm))
    return np.asarray((own[:, 0] <= x_mm / 2) & (own[:, 1] <= y_mm / 2))


def _over_groove(
    groove: NominalGroove, feature: Feature, points: ObjectPoints
) -> tuple[ObjectPoints, FloatArray]:
    """Return the points within an opening on both sides of a groove, and their own places."""
    wide = min(groove.length_x_mm, 3 * groove.opening_mm)
    near = points.part(_within(feature, points, wide, 0.9 * groove.length_y_mm))
    return near, feature.own(near.points_mm)


def _width(
    asked: ObjectMeasurand, feature: Feature, seen: SeenObject, points: ObjectPoints
) -> FittedValue:
    """Width at half height of a section across; of a V groove its opening, by the flanks."""
    for nominal in feature.specimen.nominal(NominalGroove):
        near, groove = _groove(nominal, feature, points)
        return _fitted(near, groove.width)
    if points.under is not None:
        return _width_under_sheet(asked, feature, points, points.under)
    place = feature.own(points.points_mm)
    band = np.abs(place[:, 1]) <= _SECTION_MM / 2
    if bars := feature.specimen.nominal(NominalBar):
        if asked.number > len(bars):
            raise FitError(f"width {asked.number}: the specimen has {len(bars)} bars")
        bar = bars[asked.number - 1]
        band &= np.abs(place[:, 0] - bar.middle_mm) <= (bar.width_mm + bar.gap_mm) / 2
    return _section_width(points.part(band), place[band], seen.pixel_mm)


def _width_under_sheet(
    asked: ObjectMeasurand, feature: Feature, points: ObjectPoints, under: ObjectUnderSheet
) -> FittedValue:
    """Return the width between the walls of a bar, which no sheet touches: by its free spans."""
    places = bar_places(feature)
    if asked.number > len(places):
        raise FitError(
            f"width {asked.number}: under a sheet those of bars and V grooves are found; the "
            f"specimen has {len(places)} bars"
        )
    found = bar_under_sheet(under.sheet, places[asked.number - 1])
    top = points.part(points.touching & points.over)
    return FittedValue(found.width_mm, found.sigma_mm, top.points_mm)


def _section_width(points: ObjectPoints, place: FloatArray, pixel_mm: float) -> FittedValue:
    """Return the width of a section, from the points' places (n, xyz) in the feature's frame."""
    pitch = 1.5 * pixel_mm
    numbers, where = np.unique(np.round(place[:, 0] / pitch).astype(int), return_inverse=True)
    counts = np.bincount(where)
    means = np.bincount(where, place[:, 2]) / counts
    full = counts >= _LEAST_IN_BIN
    if not full.any():
        raise FitError("width: no points across the section")
    s, z = numbers[full] * pitch, means[full]
    found = bar_width(s, z)
    scatter = 0.0 if points.sigma_mm is None else float(np.sqrt(np.mean(points.sigma_mm**2)))
    if found.height_mm <= _SIGMAS_ABOVE_NOISE * scatter:
        raise FitError("width: no ground beside the walls is seen")
    touched = np.bincount(where, points.touching)[full] > 0
    for edge in (found.left_mm, found.right_mm):
        at = int(np.searchsorted(s, edge))
        if not touched[max(at - 1, 0) : at + 1].any():
            raise FitError("width: the walls are not touched at half of their height")
    slope = np.gradient(z, s)
    noise = 0.0
    for edge in (found.left_mm, found.right_mm):
        at = int(np.argmin(np.abs(s - edge)))
        sigma = _mean_sigma(points, where == np.flatnonzero(full)[at])
        # What the height errs by, and where within its cell the profile crosses.
        noise += (sigma / max(abs(float(slope[at])), 1e-9)) ** 2 + pitch**2 / 12
    edges = _between_edges(found, place[:, 0], (s, z, counts[full].astype(np.float64)))
    return FittedValue(found.width_mm, float(np.sqrt(noise)), points.points_mm, edges, points)


def _between_edges(
    found: BarWidth, place_mm: FloatArray, profile: tuple[FloatArray, FloatArray, FloatArray]
) -> FittedDimension:
    """Return how a width at half height follows from the heights of a section's points.

    The width errs by the heights of the four cells between which the profile crosses. What bounds
    it is a shape whose two flanks may shift, each by itself, and whose level is free.

    Parameters
    ----------
    place_mm : (n,) across
    profile : cells' place, height and number of points
    """
    s, z, counts = profile
    cell = np.abs(place_mm[:, None] - s).argmin(axis=1)
    per_cell, flank = np.zeros(len(s)), np.gradient(z, s)
    for edge, sign in ((found.left_mm, -1.0), (found.right_mm, 1.0)):
        at = int(np.searchsorted(s, edge)) - 1
        rise, share = z[at + 1] - z[at], (edge - s[at]) / (s[at + 1] - s[at])
        step = s[at + 1] - s[at]
        per_cell[at] -= sign * (1.0 - share) * step / rise
        per_cell[at + 1] -= sign * share * step / rise
    middle = (found.left_mm + found.right_mm) / 2
    left = np.where(s < middle, -flank, 0.0)[cell]
    right = np.where(s >= middle, -flank, 0.0)[cell]
    design = np.column_stack([left, right, np.ones(len(cell))])
    slope = (per_cell / counts)[cell]
    used = np.ones(len(cell), bool)
    gradient = np.array([-1.0, 1.0, 0.0])
    return FittedDimension(found.width_mm, slope, np.zeros(len(cell)), used, design, gradient)


def _mean_sigma(points: ObjectPoints, members: BoolImage) -> float:
    """Return the standard uncertainty of the mean height of some points."""
    if points.sigma_mm is None:
        return float(np.std(points.points_mm[members, 2]))
    sigma = points.sigma_mm[members]
    return float(np.sqrt(np.mean(sigma**2) * min(1.0, points.together / len(sigma))))


def _resolution(
    asked: ObjectMeasurand, feature: Feature, seen: SeenObject, points: ObjectPoints
) -> FittedValue:
    """Find the finest pitch that, with all coarser ones, keeps half its depth, above the noise."""
    found = None
    # What a gel or sheet does not touch is not resolved either: its own relief counts.
    shown = points if points.under is None else _where(asked, seen.coat)
    points = replace(shown, touching=np.ones(len(shown.points_mm), bool))
    gratings = [(one.specimen.nominal(NominalGrating)[0], one) for one in seen.gratings]
    for grating, one in sorted(gratings, key=lambda pair: pair[0].pitch_mm, reverse=True):
        fitted = _depth(asked, one, seen, points)
        kept = fitted.value / grating.depth_mm
        if kept < KEPT_SHARE or fitted.value < _SIGMAS_ABOVE_NOISE * fitted.noise_mm:
            break
        found = FittedValue(grating.pitch_mm, 0.0, fitted.points_mm)
    if found is None:
        raise FitError("resolution: none of the gratings keeps half its depth above the noise")
    return found


def _deviation(
    asked: ObjectMeasurand, feature: Feature, seen: SeenObject, points: ObjectPoints
) -> FittedValue:
    """RMS, or for the form the band of 95 %, of the distances from the true object."""
    del feature
    kept = points.part(points.touching if asked.over == "contact" else points.over).thinned()
    if not len(kept.points_mm):
        raise FitError("deviation: no point on the object in the given ranges")
    distance = seen.surface.distance_mm
    normals = normals_of(kept.points_mm, distance)
    form = asked.quantity == "form"
    left = deviations(kept.points_mm, distance, "rigid" if form else asked.alignment, normals)
    upward = normals[:, 2]
    return _fitted(kept, left.form(upward) if form else left.rms(upward))


def _coverage(
    asked: ObjectMeasurand, feature: Feature, seen: SeenObject, points: ObjectPoints
) -> FittedValue:
    del asked, feature
    if seen.coverage is None:
        raise FitError("coverage: the camera sees nothing of the specimen")
    return FittedValue(seen.coverage, 0.0, points.points_mm[points.touching])


_FITTERS: dict[str, Fitter] = {
    "radius": _radius,
    "step_height": _step,
    "depth": _depth,
    "width": _width,
    "resolution": _resolution,
    "form": _deviation,
    "deviation": _deviation,
    "coverage": _coverage,
}
