"""Measure the width of a bar under a sheet from its flat top and the neighbouring free spans.

Lengths are in mm, pressures in kPa. Over an edge the coat is not parallel to the bar: the sheet
resists bending, and its texture and the camera's filter are as wide as the edge. Away from the edge
the free span carries tension only.
A frictionless rounded edge of centre O and radius r exerts no moment about O. The span's line of
tension therefore passes O at a distance d set by the bending moment B / R of the sheet:

    d = R + l q - R q^2 / 2,   q = min(2 sin(turn / 4), l / R),   R = r + t / 2,   l^2 = B / N,

where t is the local thickness, N the tension, l the length over which bending decays, and turn the
change of the sheet's direction over the edge. For q = l / R the sheet is in contact along the
rounded edge and d = R + l^2 / (2 R). (N d = N_edge R + B / R with N_edge = N would double the
second term; but sliding without friction gives N_edge = N - B / (2 R^2) by energy balance.)
On a sharper edge the contact is one line, with an Euler elastica on each side of the line.
d, the height of the top and the curve of the span give the position of O. The wall is at the
distance r outside O.

For an incompressible neo-Hookean sheet of shear modulus mu and undeformed thickness h, stretched by
the factor a across the bar and thinned to t = c h, B = mu (a^2 + c^2) t^3 / 6. N is the tension of
a span that carries the air pressure by its curvature.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from reconstruction.arrays import FloatArray
from reconstruction.compensation.arc import LEAST_CELLS
from reconstruction.compensation.free_span import (
    SPAN_MM,
    BarAxes,
    FreeSpan,
    SpanFit,
    fit_span,
    smooth_span,
)
from reconstruction.compensation.sheet import CompensatedSheet
from reconstruction.errors import FitError
from reconstruction.evaluate.fit import fit_plane, inliers

# Share of the bar's length, about its middle, that the effect of the ends does not reach.
_MIDDLE_SHARE = 0.3
# Margin between top cells and rounded edges: near the edges the sheet lifts off.
_TOP_OFF_MM = 0.3
_TURNS = 3
# Largest offset of the bar from its stated position, and drop of the coat at which a flank starts.
_ASIDE_MM, _FALLEN_MM = 1.0, 0.12
_FLAT_DEG, _LEAST_TURN_DEG = 3.0, 15.0
# Change of an edge's position by a half span, over the standard uncertainty of the change by noise.
_SIGNIFICANT = 2.0
THEORY_ON_EDGE, THEORY_OFF_EDGE = 0.2, 0.5
"""Relative errors of d - R by comparison with solid elements (tests/compensation/test_bar.py): for
contact along the rounded edge, and for contact on one line."""


@dataclass(frozen=True)
class BarPlace:
    """Approximate position, direction and size of a bar, and the radius of its edges.

    Attributes
    ----------
    x_mm, y_mm : world coordinates of the bar's middle, accurate to 0.5 mm
    along_deg : direction of its length, from world y towards -x, accurate to about 4 degrees
    width_mm : approximate distance between its walls, accurate to some 0.1 mm
    length_mm : length between its ends, or a lower limit of that length
    edge_radius_mm : radius of the rounding of its upper edges
    sigma_edge_radius_mm : standard uncertainty of `edge_radius_mm`
    """

    x_mm: float
    y_mm: float
    along_deg: float
    width_mm: float
    length_mm: float
    edge_radius_mm: float
    sigma_edge_radius_mm: float = 0.0


@dataclass(frozen=True)
class BarUnderSheet:
    """Measured width of a bar and its uncertainty budget.

    Attributes
    ----------
    width_mm : distance between the walls of the bar
    sigma_mm : standard uncertainty, the root sum of squares of the five shares below
    noise_mm : share from noise and texture of the coat
    layer_mm : share from the uncertain values of the sheet and of the air pressure
    edge_mm : share from the uncertain edge radius
    theory_mm : share from the model of bending over an edge
    span_mm : share from the shape of the free spans: kinks that are not significant, and the
        change by a fit to half spans where it is significant
    turn_deg : change of the sheet's direction at each of the two edges
    on_edge : True if the sheet is in contact along both rounded edges; False if its contact with
        an edge is one line only
    span_touches : for each of the two free spans, True if it touches an obstacle next to the bar
    """

    width_mm: float
    sigma_mm: float
    noise_mm: float
    layer_mm: float
    edge_mm: float
    theory_mm: float
    span_mm: float
    turn_deg: tuple[float, float]
    on_edge: bool
    span_touches: tuple[bool, bool]


def bending_offset_mm(radius_mm: float, tail_mm: float, turn_rad: float) -> float:
    """Return d - R, mm, for the rounded edge of a bar; the module docstring gives the equation.

    d is the distance between the span's line of tension and the centre of the rounding. R is the
    radius of the surface midway between the sheet's faces where it bends round the edge.

    Parameters
    ----------
    radius_mm : R
    tail_mm : l, the length over which bending decays
    turn_rad : change of the sheet's direction from one side of the edge to the opposite side
    """
    turned = 2 * np.sin(turn_rad / 4)
    if turned * radius_mm > tail_mm:
        turned = tail_mm / radius_mm
    return float(tail_mm * turned - radius_mm * turned**2 / 2)


@dataclass(frozen=True)
class _Sheet:
    """Values of the sheet and its load on which the measured width depends."""

    thickness_mm: float
    young_modulus_kpa: float
    pressure_kpa: float
    thinning: float

    @property
    def local_mm(self) -> float:
        return self.thickness_mm * self.thinning

    def tension(self, curvature_per_mm: float) -> float:
        """Return the line tension N, kPa mm, of a free span with the given coat curvature."""
        return self.pressure_kpa * (1 / curvature_per_mm + self.local_mm / 2)

    def tail_mm(self, tension: float) -> float:
        shear, t = self.young_modulus_kpa / 3, self.local_mm
        # a^2 by N = mu h c (a^2 - c^2).
        return float(np.sqrt(t**2 / 6 + shear * self.thinning**2 * t**3 / (3 * tension)))


@dataclass(frozen=True)
class _Edge:
    """Position of the rounding's centre O of one edge, and the bending of the sheet over the edge.

    Attributes
    ----------
    across_mm : distance of O from the bar's middle, across the bar
    turn_rad : change of the sheet's direction over the edge
    offset_mm : d - R
    tail_mm : length l over which bending decays
    noise_mm : standard uncertainty of `across_mm` from noise and texture of the coat
    on_edge : True if the sheet is in contact along the rounded edge, False if on one line
    """

    across_mm: float
    turn_rad: float
    offset_mm: float
    tail_mm: float
    noise_mm: float
    on_edge: bool


def bar_under_sheet(result: CompensatedSheet, bar: BarPlace) -> BarUnderSheet:
    """Measure the width of a bar with a flat top under a sheet.

    Parameters
    ----------
    result : compensated sheet of the measurement
    bar : approximate position and width, and the edge radius

    Raises
    ------
    FitError : the air pressure is 0, the sheet sticks, or the measured top or free spans do not
        determine a width
    """
    if result.layer.back_pressure_kpa <= 0:
        raise FitError("width: back_pressure_kpa is 0; air must press the sheet onto the bar")
    if result.layer.sticks:
        raise FitError("width: the tension at an edge is unknown for a sheet that sticks")
    bar = _placed(result, bar)
    for _ in range(_TURNS):
        measured = _measured_width(result, bar)
        if not bar.width_mm / 2 < measured.width_mm < 2 * bar.width_mm:
            raise FitError(f"width: found {measured.width_mm:.2f} mm, not near {bar.width_mm:g} mm")
        bar = replace(bar, width_mm=measured.width_mm)
    return measured


def _placed(result: CompensatedSheet, bar: BarPlace) -> BarPlace:
    """Return the bar with its position and direction from the measured coat.

    They are those of the line through the middles between the flanks in the bar's two halves.
    """
    turn, shift = np.deg2rad(bar.along_deg), _MIDDLE_SHARE * bar.length_mm / 4
    along = np.array([-np.sin(turn), np.cos(turn)])
    across = np.array([along[1], -along[0]])
    middle = np.array([bar.x_mm, bar.y_mm])
    points = result.relief.points_mm[result.relief.measured]
    own = (points[:, :2] - middle) @ np.stack([across, along], axis=1)
    near, ends = np.abs(own[:, 0]) < bar.width_mm / 2 + _ASIDE_MM, []
    for side in (-1.0, 1.0):
        half = near & (np.abs(own[:, 1] - side * shift) < shift)
        between = _between_flanks(
            own[half, 0], points[half, 2], result.relief.pitch_mm[0], bar.width_mm / 3
        )
        ends.append(middle + between * across + side * shift * along)
    (x, y), line = np.mean(ends, axis=0), ends[1] - ends[0]
    direction = float(np.rad2deg(np.arctan2(-line[0], line[1])))
    return replace(bar, x_mm=float(x), y_mm=float(y), along_deg=direction)


def _between_flanks(
    across_mm: FloatArray, z_mm: FloatArray, pitch_mm: float, top_mm: float
) -> float:
    """Return the position, mm, midway between the flanks, which start `_FALLEN_MM` below the crest.

    Parameters
    ----------
    across_mm, z_mm : (n,) coordinates across the bar, and heights of the coat
    pitch_mm : width of the strips in which the heights are averaged
    top_mm : half width that is certainly on the bar's flat top; the tilt of this part is subtracted
    """
    number = np.floor(across_mm / pitch_mm).astype(int)
    first = int(number.min()) if len(number) else 0
    count = np.bincount(number - first)
    strips = np.flatnonzero(count)
    # The points of cells may all miss a strip of the cells' width, but not two.
    if not len(number) or np.diff(strips).max(initial=1) > 2:
        raise FitError("width: the coat was not measured over the whole bar")
    heights = np.bincount(number - first, z_mm)[strips] / count[strips]
    profile = np.interp(np.arange(len(count)), strips, heights)
    places = (first + np.arange(len(count)) + 0.5) * pitch_mm
    top = np.abs(places) < top_mm
    if top.sum() > 2:
        profile = profile - np.polyfit(places[top], profile[top], 1)[0] * places
    crest = int(np.argmax(profile))
    fallen = profile < profile[crest] - _FALLEN_MM
    left, right = np.flatnonzero(fallen[:crest]), crest + np.flatnonzero(fallen[crest:])
    if not len(left) or not len(right):
        raise FitError("width: the coat next to the bar is not below the bar's top")
    return float(first + (left[-1] + right[0] + 1) / 2) * pitch_mm


def _measured_width(result: CompensatedSheet, bar: BarPlace) -> BarUnderSheet:
    axes = _axes(result, bar)
    sheet = _sheet(result, axes, bar)
    fits = [_span(result, axes, bar, sheet, side) for side in (-1.0, 1.0)]

    def edges(of: _Sheet, radius_mm: float, spans: list[FreeSpan] | None = None) -> list[_Edge]:
        # With a thicker sheet the bar's top is deeper below the coat.
        drop_mm = of.local_mm - sheet.local_mm
        chosen = [fit.best for fit in fits] if spans is None else spans
        return [_edge(span, of, radius_mm, drop_mm) for span in chosen]

    def width(of: _Sheet, radius_mm: float) -> float:
        return sum(edge.across_mm for edge in edges(of, radius_mm)) + 2 * radius_mm

    radius, best = bar.edge_radius_mm, width(sheet, bar.edge_radius_mm)
    here = edges(sheet, radius)
    layer = [width(changed, radius) - best for changed in _moved(result, sheet)]
    others = ([fit.kinked for fit in fits], [fit.near or fit.best for fit in fits])
    kinked, near = (edges(sheet, radius, spans) for spans in others)
    shares = {
        "noise_mm": float(np.linalg.norm([edge.noise_mm for edge in here])),
        "layer_mm": float(np.linalg.norm(layer)),
        "edge_mm": abs(width(sheet, radius + bar.sigma_edge_radius_mm) - best),
        "theory_mm": sum(_theory_mm(edge) for edge in here),
        "span_mm": float(np.linalg.norm([*map(_span_mm, here, kinked, near)])),
    }
    left, right = (float(np.rad2deg(edge.turn_rad)) for edge in here)
    return BarUnderSheet(
        best,
        sigma_mm=float(np.linalg.norm(list(shares.values()))),
        turn_deg=(left, right),
        on_edge=all(edge.on_edge for edge in here),
        span_touches=(fits[0].touches, fits[1].touches),
        **shares,
    )


def _span_mm(edge: _Edge, kinked: _Edge, near: _Edge) -> float:
    """Return the uncertainty of an edge's position, mm, from the shape of its free span.

    It has two parts: the change by the most likely kink, and the change by a fit to the half of the
    span near the bar, if that change is significant. Its variance by noise is the difference of the
    variances of the two fits (Hausman, Econometrica 46, 1978).
    """
    change = near.across_mm - edge.across_mm
    by_noise = np.sqrt(max(near.noise_mm**2 - edge.noise_mm**2, 0.0))
    of_half = change if abs(change) > _SIGNIFICANT * by_noise else 0.0
    return float(np.hypot(kinked.across_mm - edge.across_mm, of_half))


def _axes(result: CompensatedSheet, bar: BarPlace) -> BarAxes:
    turn, relief = np.deg2rad(bar.along_deg), result.relief
    along, middle = np.array([-np.sin(turn), np.cos(turn), 0.0]), (bar.x_mm, bar.y_mm, 0.0)
    own = (relief.points_mm - middle) @ np.stack([np.cross(along, (0, 0, 1.0)), along], axis=1)
    band = (np.abs(own[..., 1]) < _MIDDLE_SHARE * bar.length_mm / 2) & relief.measured
    top = band & (np.abs(own[..., 0]) < bar.width_mm / 2 - bar.edge_radius_mm - _TOP_OFF_MM)
    if top.sum() < LEAST_CELLS:
        raise FitError(f"width: {int(top.sum())} cells on the bar's top, {LEAST_CELLS} needed")
    points = result.object_mm[top]
    flat = fit_plane(points)
    flat = fit_plane(points[inliers(flat.residuals_mm)])
    along -= (along @ flat.normal) * flat.normal
    along /= np.linalg.norm(along)
    rotation = np.stack([np.cross(along, flat.normal), along, flat.normal])
    up = (flat.centroid_mm - middle) @ flat.normal / flat.normal[2]
    return BarAxes(np.array([bar.x_mm, bar.y_mm, up]), rotation, band)


def _sheet(result: CompensatedSheet, axes: BarAxes, bar: BarPlace) -> _Sheet:
    layer, across = result.layer, axes.own(result.relief.points_mm)[..., 0]
    near_walls = axes.band & (np.abs(np.abs(across) - bar.width_mm / 2) < SPAN_MM)
    thinning = float(np.median(result.thinning[near_walls]))
    return _Sheet(layer.thickness_mm, layer.young_modulus_kpa, layer.back_pressure_kpa, thinning)


def _moved(result: CompensatedSheet, sheet: _Sheet) -> list[_Sheet]:
    """Return four sheets, each with one value changed by that value's standard uncertainty."""
    layer = result.layer
    return [
        replace(sheet, thickness_mm=sheet.thickness_mm + layer.sigma_thickness_mm),
        replace(sheet, young_modulus_kpa=sheet.young_modulus_kpa + layer.sigma_young_modulus_kpa),
        replace(sheet, pressure_kpa=sheet.pressure_kpa + layer.sigma_back_pressure_kpa),
        replace(sheet, thinning=sheet.thinning + float(np.median(result.sigma_thinning))),
    ]


def _span(
    result: CompensatedSheet, axes: BarAxes, bar: BarPlace, sheet: _Sheet, side: float
) -> SpanFit:
    """Fit an arc to the free span next to an edge, without the ends that bend.

    The first of two fits gives the length over which bending decays. `side` is -1 or 1.
    """
    wall, tail = (side, bar.width_mm / 2), 2 * sheet.local_mm
    first = smooth_span(result, axes, wall, tail)
    tail = sheet.tail_mm(sheet.tension(first.curvature_per_mm))
    return fit_span(result, axes, wall, tail)


def _edge(span: FreeSpan, sheet: _Sheet, radius_mm: float, drop_mm: float) -> _Edge:
    """Locate the centre O of an edge's rounding, at the distance d from the span's tension line.

    radius_mm : radius of the edge's rounding
    drop_mm : depth of the bar's top below the origin of `BarAxes`, for a changed local thickness
    """
    tension, middle = sheet.tension(span.curvature_per_mm), radius_mm + sheet.local_mm / 2
    tail = sheet.tail_mm(tension)

    def turn_and_offset(s_mm: float) -> tuple[float, float]:
        slope, offset = span.at(s_mm)[1], 0.0
        for _ in range(2):
            # Air lifts the end of the top by the offset, so the sheet leaves the edge inclined.
            turn = slope + float(np.sqrt(2 * sheet.pressure_kpa * offset / tension))
            offset = bending_offset_mm(middle, tail, turn)
        return turn, offset

    def above(s_mm: float) -> float:
        """Return the height, mm, above O of the point at the distance d from the span at s."""
        place, slope = span.at(s_mm)
        away = middle + turn_and_offset(s_mm)[1] + sheet.local_mm / 2
        return float(place[1] - away * np.cos(slope) + radius_mm + drop_mm)

    low, high = span.from_mm - SPAN_MM, min(span.from_mm + SPAN_MM, span.steeper_than(_FLAT_DEG))
    if high <= low or above(low) * above(high) > 0:
        raise FitError("width: the coat next to the bar does not lead to its top")
    s_mm = float(brentq(above, low, high))
    (across, _), slope = span.at(s_mm)
    if np.rad2deg(slope) < _LEAST_TURN_DEG:
        raise FitError(
            f"width: the sheet leaves the edge at {np.rad2deg(slope):.0f} degrees, "
            f"{_LEAST_TURN_DEG:g} needed; press with more air or deeper"
        )
    turn, offset = turn_and_offset(s_mm)
    away = middle + offset + sheet.local_mm / 2
    return _Edge(
        across_mm=float(across - away * np.sin(slope)),
        turn_rad=turn,
        offset_mm=offset,
        tail_mm=tail,
        noise_mm=span.sigma_mm(s_mm) / float(np.sin(slope)),
        on_edge=tail / middle <= 2 * np.sin(turn / 4),
    )


def _theory_mm(edge: _Edge) -> float:
    share = THEORY_ON_EDGE if edge.on_edge else THEORY_OFF_EDGE
    return share * edge.offset_mm / float(np.sin(edge.turn_rad))
