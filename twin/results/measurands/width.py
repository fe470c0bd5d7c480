"""Width of a bar at 50 % of its height, or of a V groove at the face that it is cut into."""

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.compensation import bar_under_sheet
from reconstruction.errors import FitError
from reconstruction.evaluate import BarWidth, bar_width
from reconstruction.evaluate.estimates import FittedDimension
from twin.config.measurands import ObjectMeasurand
from twin.config.nominal import NominalBar, NominalGroove
from twin.results.features import Feature, bar_places
from twin.results.measurands import (
    MEASURANDS,
    SIGMAS_ABOVE_NOISE,
    FittedValue,
    MeasurandKind,
    fitted,
)
from twin.results.measurands.depth import groove_of
from twin.results.object_points import ObjectPoints, ObjectView
from twin.results.under_sheet import ObjectUnderSheet

_SECTION_MM = 2.0
_LEAST_IN_BIN = 3


class SectionWidth(MeasurandKind):
    """Measurand: the width of a bar or of a groove, mm."""

    name = "width"
    summary = "of a bar, a groove"
    hidden = True
    bound_name = "crb_width_um"

    def fit(
        self,
        request: ObjectMeasurand,
        feature: Feature,
        observed: ObjectView,
        points: ObjectPoints,
    ) -> FittedValue:
        """Return the width of a bar's section at 50 % of its height, or a V groove's opening."""
        for nominal in feature.specimen.nominal(NominalGroove):
            near, groove = groove_of(nominal, feature, points)
            return fitted(near, groove.width)
        if points.under is not None:
            return _width_under_sheet(request, feature, points, points.under)
        place = feature.own(points.points_mm)
        band = np.abs(place[:, 1]) <= _SECTION_MM / 2
        if bars := feature.specimen.nominal(NominalBar):
            if request.number > len(bars):
                raise FitError(f"width {request.number}: the specimen has {len(bars)} bars")
            bar = bars[request.number - 1]
            band &= np.abs(place[:, 0] - bar.middle_mm) <= (bar.width_mm + bar.gap_mm) / 2
        return _section_width(points.part(band), place[band], observed.pixel_mm)

    def count(self, feature: Feature) -> int | None:
        """Return the number of bars and grooves; None if the specimen has no nominal width."""
        return len(self.known_mm(feature)) or None


def _width_under_sheet(
    request: ObjectMeasurand, feature: Feature, points: ObjectPoints, under: ObjectUnderSheet
) -> FittedValue:
    """Return the width between the walls of a bar, determined from the sheet's free spans.

    A sheet does not touch the walls of a bar.
    """
    places = bar_places(feature)
    if request.number > len(places):
        raise FitError(
            f"width {request.number}: under a sheet those of bars and V grooves are found; the "
            f"specimen has {len(places)} bars"
        )
    bar = bar_under_sheet(under.sheet, places[request.number - 1])
    top = points.part(points.touching & points.over)
    layer_mm = float(np.linalg.norm((bar.layer_mm, bar.edge_mm, bar.theory_mm)))
    return FittedValue(bar.width_mm, bar.noise_mm, top.points_mm, layer_mm=layer_mm)


def _section_width(points: ObjectPoints, place: FloatArray, pixel_mm: float) -> FittedValue:
    """Return the width of a section at 50 % of its height.

    `place` (n, xyz), mm, are the points in the own frame of the feature.
    """
    pitch = 1.5 * pixel_mm
    numbers, where = np.unique(np.round(place[:, 0] / pitch).astype(int), return_inverse=True)
    counts = np.bincount(where)
    means = np.bincount(where, place[:, 2]) / counts
    full = counts >= _LEAST_IN_BIN
    if not full.any():
        raise FitError("width: no points across the section")
    s, z = numbers[full] * pitch, means[full]
    bar = bar_width(s, z)
    scatter = 0.0 if points.sigma_mm is None else float(np.sqrt(np.mean(points.sigma_mm**2)))
    if bar.height_mm <= SIGMAS_ABOVE_NOISE * scatter:
        raise FitError("width: no ground next to the walls is visible")
    touched = np.bincount(where, points.touching)[full] > 0
    for edge in (bar.left_mm, bar.right_mm):
        at = int(np.searchsorted(s, edge))
        if not touched[max(at - 1, 0) : at + 1].any():
            raise FitError("width: the walls are not touched at half of their height")
    slope = np.gradient(z, s)
    noise = 0.0
    for edge in (bar.left_mm, bar.right_mm):
        at = int(np.argmin(np.abs(s - edge)))
        sigma = _mean_sigma(points, where == np.flatnonzero(full)[at])
        # Errors of the height, and of the position within the cell where the profile crosses the
        # level.
        noise += (sigma / max(abs(float(slope[at])), 1e-9)) ** 2 + pitch**2 / 12
    edges = _between_edges(bar, place[:, 0], (s, z, counts[full].astype(np.float64)))
    return FittedValue(bar.width_mm, float(np.sqrt(noise)), points.points_mm, edges, points)


def _between_edges(
    bar: BarWidth, place_mm: FloatArray, profile: tuple[FloatArray, FloatArray, FloatArray]
) -> FittedDimension:
    """Return the width at 50 % of the height with its derivatives by the points' heights.

    The error of the width follows from the heights of the four cells between which the profile
    crosses 50 % of its height. For the bound, the model is a profile with two flanks that shift
    independently and a free level.

    Parameters
    ----------
    place_mm : (n,) positions of the points across the bar, mm
    profile : position, mm, height, mm, and number of points of each cell
    """
    s, z, counts = profile
    cell = np.abs(place_mm[:, None] - s).argmin(axis=1)
    per_cell, flank = np.zeros(len(s)), np.gradient(z, s)
    for edge, sign in ((bar.left_mm, -1.0), (bar.right_mm, 1.0)):
        at = int(np.searchsorted(s, edge)) - 1
        rise, share = z[at + 1] - z[at], (edge - s[at]) / (s[at + 1] - s[at])
        step = s[at + 1] - s[at]
        per_cell[at] -= sign * (1.0 - share) * step / rise
        per_cell[at + 1] -= sign * share * step / rise
    middle = (bar.left_mm + bar.right_mm) / 2
    left = np.where(s < middle, -flank, 0.0)[cell]
    right = np.where(s >= middle, -flank, 0.0)[cell]
    design = np.column_stack([left, right, np.ones(len(cell))])
    slope = (per_cell / counts)[cell]
    used = np.ones(len(cell), bool)
    gradient = np.array([-1.0, 1.0, 0.0])
    return FittedDimension(bar.width_mm, slope, np.zeros(len(cell)), used, design, gradient)


def _mean_sigma(points: ObjectPoints, members: BoolImage) -> float:
    """Return the standard uncertainty, mm, of the mean height of selected points."""
    if points.sigma_mm is None:
        return float(np.std(points.points_mm[members, 2]))
    sigma = points.sigma_mm[members]
    return float(np.sqrt(np.mean(sigma**2) * min(1.0, points.together / len(sigma))))


MEASURANDS.register(SectionWidth())
