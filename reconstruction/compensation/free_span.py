"""Free span of a sheet next to a bar: the arc of a circle that fits the coat there; mm.

The span carries the air pressure by tension only, so that its cross section is an arc. A slack span
may touch an obstacle next to the bar, for example the edge of the bar's plate. It then has a kink
there. The most likely kink is therefore fitted as well, and used if it is significant.
"""

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.compensation.arc import (
    LEAST_CELLS,
    Arc,
    CoatSection,
    Kink,
    fitted_arc,
    likely_kink,
)
from reconstruction.compensation.balance import CURVATURE_SIGMA_MM, off_the_rim
from reconstruction.compensation.sheet import CompensatedSheet
from reconstruction.errors import FitError

# Largest length of a span.
SPAN_MM = 3.5
# In lengths over which bending decays: distance from the ends of a span at which it is negligible.
_TAILS = 3.0
# Angle of a kink over its standard uncertainty. A kink is fitted at the most likely of about 10
# independent positions: by chance the ratio exceeds 3 in about 1 % of the spans.
_SIGNIFICANT = 3.0


@dataclass(frozen=True, eq=False)
class BarAxes:
    """Frame of a bar: axes across, along and up, with the origin on its flat top; lengths in mm.

    Attributes
    ----------
    middle_mm : (xyz) world position of the origin
    rotation : (3, xyz) unit vectors of the three axes in the world frame
    band : (row, col) bool, measured cells of the relief away from the bar's ends
    """

    middle_mm: FloatArray
    rotation: FloatArray
    band: BoolArray

    def own(self, points_mm: FloatArray) -> FloatArray:
        """Return world points (..., xyz) in the bar's frame, (..., across along up)."""
        return np.asarray((points_mm - self.middle_mm) @ self.rotation.T)


@dataclass(frozen=True, eq=False)
class FreeSpan:
    """Circular arc of the free span next to an edge, between the edge and the first kink.

    The arc has a frame of its own: s, mm, along the chord, and a height normal to the chord.

    Attributes
    ----------
    origin : position of s = 0, mm: (across the bar from its middle towards the span, up)
    slope_rad : angle by which the axis of s descends
    sagging_mm : height of the arc at s = 0
    curvature_per_mm : curvature of the arc, positive in a valley
    covariance : (3, 3) of the fitted height, slope and half the curvature at s = 0
    from_mm : smallest s of the measured points
    """

    origin: FloatArray
    slope_rad: float
    sagging_mm: float
    curvature_per_mm: float
    covariance: FloatArray
    from_mm: float

    def at(self, s_mm: float) -> tuple[FloatArray, float]:
        """Return the (across, up) position of the coat at s, mm, and its descent angle, rad."""
        turned = float(np.arcsin(np.clip(self.curvature_per_mm * s_mm, -1, 1)))
        height = self.sagging_mm + (1 - np.cos(turned)) / self.curvature_per_mm
        c, s = np.cos(self.slope_rad), np.sin(self.slope_rad)
        place = self.origin + np.array([s_mm * c + height * s, height * c - s_mm * s])
        return place, self.slope_rad - turned

    def steeper_than(self, least_deg: float) -> float:
        """Return the largest s, mm, at which the coat still descends by more than an angle."""
        turned = np.clip(self.slope_rad - np.deg2rad(least_deg), -np.pi / 2, np.pi / 2)
        return float(np.sin(turned)) / self.curvature_per_mm

    def sigma_mm(self, s_mm: float) -> float:
        """Return the standard uncertainty of the coat's height at s."""
        by = np.array([1.0, s_mm, s_mm**2])
        return float(np.sqrt(by @ self.covariance @ by))


@dataclass(frozen=True, eq=False)
class SpanFit:
    """Arcs fitted to the free span next to one edge.

    Attributes
    ----------
    best : arc with a kink if the kink is significant, else without
    kinked : arc with the most likely kink, significant or not
    near : as `best`, fitted to the half of the span near the bar; None if the span is short
    touches : True if the kink is significant: the span touches an obstacle
    """

    best: FreeSpan
    kinked: FreeSpan
    near: FreeSpan | None
    touches: bool


def smooth_span(
    result: CompensatedSheet, axes: BarAxes, wall: tuple[float, float], tail_mm: float
) -> FreeSpan:
    """Fit an arc without a kink to the span next to one wall of a bar; see `fit_span`."""
    section, origin = _section(result, axes, wall, tail_mm)
    return _span_of(fitted_arc(section), origin)


def fit_span(
    result: CompensatedSheet, axes: BarAxes, wall: tuple[float, float], tail_mm: float
) -> SpanFit:
    """Fit arcs without and with a kink to the span next to one wall of a bar.

    Parameters
    ----------
    wall : side of the bar, -1 or 1, and distance of the wall from the bar's middle, mm
    tail_mm : length over which the bending of the sheet decays

    Raises
    ------
    FitError : too few cells, or a coat that is not curved like a free span
    """
    section, origin = _section(result, axes, wall, tail_mm)
    arc = smooth = fitted_arc(section)
    kink, touches = likely_kink(section, smooth, tail_mm), False
    if kink is not None:
        with suppress(FitError):
            arc = fitted_arc(section, kink)
            touches = arc.kink_over_sigma > _SIGNIFICANT
    near = _near(section, kink if touches else None)
    return SpanFit(
        best=_span_of(arc if touches else smooth, origin),
        kinked=_span_of(arc, origin),
        near=None if near is None else _span_of(near, origin),
        touches=touches,
    )


def _near(section: CoatSection, kink: Kink | None) -> Arc | None:
    """Return the arc fitted to the half of a span near the bar; None if the span is short."""
    near = section.first(SPAN_MM / 2)
    if near.cells.sum() < LEAST_CELLS or (kink is not None and not near.reaches_beyond(kink)):
        return None
    with suppress(FitError):
        return fitted_arc(near, kink)
    return None


def _section(
    result: CompensatedSheet, axes: BarAxes, wall: tuple[float, float], tail_mm: float
) -> tuple[CoatSection, FloatArray]:
    """Return the free span without its ends, and the origin of the section's coordinates."""
    relief, own, (side, half_mm) = result.relief, axes.own(result.relief.points_mm), wall
    beyond, clear_mm = side * own[..., 0] - half_mm, _TAILS * tail_mm
    start = result.layer.thickness_mm + relief.pitch_mm[0] + clear_mm
    end = min(start + SPAN_MM, _free_to_mm(result, axes, beyond) - clear_mm)
    span_cells = axes.band & (beyond > start) & (beyond < end)
    if span_cells.sum() < LEAST_CELLS:
        raise FitError(
            f"width: {int(span_cells.sum())} cells of a free span next to the bar, "
            f"{LEAST_CELLS} needed"
        )
    across, along, up = np.moveaxis(own[span_cells], -1, 0)
    origin = np.array([side * across.mean(), up.mean()])
    points = np.stack((side * across - origin[0], up - origin[1], along), axis=-1)
    return CoatSection(points, span_cells), origin


def _free_to_mm(result: CompensatedSheet, axes: BarAxes, beyond_mm: FloatArray) -> float:
    """Return the distance from the wall, mm, at which the free span ends at contact or clamp.

    The pressure is averaged along the bar, because texture makes single cells seem in contact.
    """
    pitch = result.relief.pitch_mm[0]
    cells = axes.band & (beyond_mm > 0)
    number = (beyond_mm[cells] / pitch).astype(int)
    count = np.maximum(np.bincount(number), 1)
    free = off_the_rim(result.relief)[cells].astype(float)
    pressure, inner = (np.bincount(number, of) / count for of in (result.pressure_kpa[cells], free))
    taken = (pressure > result.layer.back_pressure_kpa / 2) | (inner < 1)
    first = int(np.ceil(3 * CURVATURE_SIGMA_MM / pitch))
    again = np.flatnonzero(taken[first:])
    return float(first + again[0] if len(again) else len(taken)) * pitch - CURVATURE_SIGMA_MM


def _span_of(arc: Arc, origin: FloatArray) -> FreeSpan:
    return FreeSpan(
        origin,
        arc.angle_rad,
        float(arc.parameters[0]),
        arc.curvature_per_mm,
        arc.covariance[:3, :3],
        float(arc.place_mm.min()),
    )
