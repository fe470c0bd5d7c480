"""Free span of a sheet next to a bar: the arc of a circle that fits the coat there; mm.

The span carries the air pressure by tension only, so that its cross section is an arc.
"""

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.compensation.balance import CURVATURE_SIGMA_MM, off_the_rim
from reconstruction.compensation.scatter import variance_and_area
from reconstruction.compensation.sheet import CompensatedSheet
from reconstruction.errors import FitError
from reconstruction.evaluate.fit import inliers

# Largest length of a span, and least number of cells for any fit next to or on a bar.
SPAN_MM = 3.5
LEAST_CELLS = 40
_ARC_TURNS = 8


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
    """Circular arc fitted to the free span next to an edge.

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


def fit_span(
    result: CompensatedSheet,
    axes: BarAxes,
    wall: tuple[float, float],
    clear_mm: float,
    length_mm: float = SPAN_MM,
) -> FreeSpan:
    """Fit the span next to one wall of a bar.

    Parameters
    ----------
    wall : side of the bar, -1 or 1, and distance of the wall from the bar's middle, mm
    clear_mm : distance from both ends of the span within which bending matters
    length_mm : largest length of the fitted part, which begins near the wall

    Raises
    ------
    FitError : too few cells, or a coat that is not curved like a free span
    """
    relief, own, (side, half_mm) = result.relief, axes.own(result.relief.points_mm), wall
    beyond = side * own[..., 0] - half_mm
    start = result.layer.thickness_mm + relief.pitch_mm[0] + clear_mm
    end = min(start + length_mm, _free_to_mm(result, axes, beyond) - clear_mm)
    span_cells = axes.band & (beyond > start) & (beyond < end)
    if span_cells.sum() < LEAST_CELLS:
        raise FitError(
            f"width: {int(span_cells.sum())} cells of a free span next to the bar, "
            f"{LEAST_CELLS} needed"
        )
    across, along, up = np.moveaxis(own[span_cells], -1, 0)
    return _arc(np.stack((side * across, up, along), axis=-1), span_cells, result)


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


def _arc(points: FloatArray, span_cells: BoolArray, result: CompensatedSheet) -> FreeSpan:
    """Fit an arc to points (n, across up along), mm; it may shift and turn along the bar."""
    origin, y = points[:, :2].mean(axis=0), points[:, 2]
    across, up = (points[:, :2] - origin).T
    angle, curvature = float(np.arctan(-np.polyfit(across, up, 1)[0])), 0.0
    used, ones = np.ones(len(y), bool), np.ones_like(y)
    for _ in range(_ARC_TURNS):
        c, s = np.cos(angle), np.sin(angle)
        place, height = across * c - up * s, across * s + up * c
        design = np.column_stack([ones, place, place**2, y, y**2, place * y, place * y**2])
        flat = height - _over_parabola(place, curvature)
        sagging, slope, half, *_ = fitted = np.linalg.lstsq(design[used], flat[used])[0]
        rest = flat - design @ fitted
        used = inliers(rest)
        angle, curvature = angle - float(np.arctan(slope)), float(2 * half)
    if curvature <= 0:
        raise FitError("width: the coat next to the bar is not curved like a free span")
    spread, members = np.zeros(span_cells.shape), np.zeros(span_cells.shape, bool)
    spread[span_cells], members[span_cells] = rest, used
    variance, area = variance_and_area(spread, members, result.relief.cell_area_mm2)
    covariance = np.linalg.inv(design[used].T @ design[used])[:3, :3] * variance
    together = area / result.relief.cell_area_mm2
    return FreeSpan(
        origin, angle, float(sagging), curvature, covariance * together, float(place.min())
    )


def _over_parabola(place_mm: FloatArray, curvature_per_mm: float) -> FloatArray:
    """Return the height, mm, of a circle above the parabola of equal curvature at the vertex."""
    if not curvature_per_mm:
        return np.zeros_like(place_mm)
    turned = np.clip(curvature_per_mm * place_mm, -0.99, 0.99)
    return np.asarray((1 - np.sqrt(1 - turned**2) - turned**2 / 2) / curvature_per_mm)
