"""Arc of a circle fitted to a section of a coat, without or with a kink; lengths in mm.

A free span that touches an obstacle along a line has a kink there: the line load F turns the line
of tension by the angle F / N, with the tension N. N and the air pressure are the same on both sides
of the kink, and so is the curvature. Bending rounds the kink: a beam under tension with a line load
at u = 0 has the deflection F / N (max(u, 0) + l / 2 exp(-|u| / l)), l = sqrt(B / N), with the
bending stiffness B. The angle of the kink may change with the coordinate y along the bar, as a
polynomial of degree 2.
"""

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.compensation.scatter import scatter_of
from reconstruction.errors import FitError
from reconstruction.evaluate.fit import inliers

# Least number of cells for any fit next to or on a bar.
LEAST_CELLS = 40
# Least length of the arc on each side of a kink: a shorter one does not determine its slope.
LEAST_ARC_MM = 0.4
_ARC_TURNS, _PLACES_OF_KINKS = 8, 40
# Index of the kink's angle at y = 0 among the parameters of `Arc`.
_KINK = 7
_LARGEST_SINE = 0.99


@dataclass(frozen=True, eq=False)
class CoatSection:
    """Points of a coat next to a bar.

    Attributes
    ----------
    points_mm : (n, 3) coordinates across, up and along the bar, relative to the mean of the first
        two
    cells : (row, col) bool, cell of the relief of each point, in row-major order
    """

    points_mm: FloatArray
    cells: BoolArray

    def first(self, length_mm: float) -> "CoatSection":
        """Return the part of the section that is nearest to the bar."""
        across = self.points_mm[:, 0]
        inner, cells = across < across.min() + length_mm, self.cells.copy()
        cells[self.cells] = inner
        return CoatSection(self.points_mm[inner], cells)

    def reaches_beyond(self, kink: "Kink") -> bool:
        """Return True if the section determines the arc beyond a kink."""
        return bool(self.points_mm[:, 0].max() > kink.across_mm + LEAST_ARC_MM)


@dataclass(frozen=True)
class Kink:
    """Position of a kink, mm, across and up, and the length over which bending decays, mm."""

    across_mm: float
    up_mm: float
    tail_mm: float

    def deflection(
        self, place_mm: FloatArray, curvature_per_mm: float, at_mm: float, turn_rad: float = 0.0
    ) -> tuple[FloatArray, FloatArray]:
        """Return the change of the height by the kink, mm, and its derivative by the angle, mm/rad.

        The arc beyond the kink is turned about the kink. Both results are (n,).

        Parameters
        ----------
        place_mm : (n,) coordinates s along the chord
        at_mm : coordinate s of the kink
        turn_rad : angle of the kink, positive upwards
        """
        beyond = np.maximum(place_mm - at_mm, 0.0)
        start = float(np.arcsin(_limited(curvature_per_mm * at_mm)))
        before, _ = _rise(beyond, curvature_per_mm, start)
        after, slope = _rise(beyond, curvature_per_mm, start + turn_rad)
        rounded = self.tail_mm / 2 * np.exp(-np.abs(place_mm - at_mm) / self.tail_mm)
        return after - before + turn_rad * rounded, beyond + after * slope + rounded


@dataclass(frozen=True, eq=False)
class Arc:
    """Least-squares arc in the frame of its chord: s along the chord, and a height normal to it.

    Attributes
    ----------
    angle_rad : angle by which the axis of s descends
    place_mm : (n,) coordinate s of each point
    parameters : (k,) height, slope and half the curvature at s = 0, four changes along the bar,
        and for an arc with a kink its angle and two changes along the bar
    covariance : (k, k) of the parameters, including the correlation of neighbouring cells
    design : (n, k) derivatives of the heights by the parameters
    rest_mm : (n,) residuals
    used : (n,) bool, points that are no outliers
    """

    angle_rad: float
    place_mm: FloatArray
    parameters: FloatArray
    covariance: FloatArray
    design: FloatArray
    rest_mm: FloatArray
    used: BoolArray

    @property
    def curvature_per_mm(self) -> float:
        """Curvature, positive in a valley."""
        return float(2 * self.parameters[2])

    @property
    def kink_over_sigma(self) -> float:
        """Ratio of the angle of the kink to its standard uncertainty; positive on an obstacle."""
        return -float(self.parameters[_KINK] / np.sqrt(self.covariance[_KINK, _KINK]))


def fitted_arc(section: CoatSection, kink: Kink | None = None) -> Arc:
    """Fit an arc to a section; the arc may shift and turn along the bar.

    Raises
    ------
    FitError : the section is not curved like a valley
    """
    across, up, along = section.points_mm.T
    angle, curvature = float(np.arctan(-np.polyfit(across, up, 1)[0])), 0.0
    used, turn = np.ones(len(along), bool), 0.0
    for _ in range(_ARC_TURNS):
        descent, c, s = angle, np.cos(angle), np.sin(angle)
        place, height = across * c - up * s, across * s + up * c
        design = _design(place, along)
        flat = height - _over_parabola(place, curvature)
        if kink is not None:
            at_mm = kink.across_mm * c - kink.up_mm * s
            change, by_turn = kink.deflection(place, curvature, at_mm, turn)
            flat = flat - change + turn * by_turn
            design = np.column_stack([design, by_turn, by_turn * along, by_turn * along**2])
        parameters = np.linalg.lstsq(design[used], flat[used])[0]
        rest = flat - design @ parameters
        used = inliers(rest)
        angle, curvature = angle - float(np.arctan(parameters[1])), float(2 * parameters[2])
        turn = float(parameters[_KINK]) if kink is not None else 0.0
    if curvature <= 0:
        raise FitError("width: the coat next to the bar is not curved like a free span")
    covariance = _covariance(section, design, rest, used)
    return Arc(descent, place, parameters, covariance, design, rest, used)


def likely_kink(section: CoatSection, smooth: Arc, tail_mm: float) -> Kink | None:
    """Return the kink on an obstacle that reduces the residuals of an arc most; None: no kink does.

    Parameters
    ----------
    smooth : arc without a kink
    tail_mm : length over which the bending of the sheet decays
    """
    low, high = smooth.place_mm.min() + LEAST_ARC_MM, smooth.place_mm.max() - LEAST_ARC_MM
    if high <= low:
        return None
    step = (high - low) / _PLACES_OF_KINKS
    at, gain = _best_place(smooth, np.linspace(low, high, _PLACES_OF_KINKS + 1), tail_mm)
    if gain <= 0:
        return None
    near = np.clip(at + step * np.linspace(-1, 1, _PLACES_OF_KINKS + 1), low, high)
    at, _ = _best_place(smooth, near, tail_mm)
    c, s = np.cos(smooth.angle_rad), np.sin(smooth.angle_rad)
    height = float(smooth.parameters[0] + _rise(np.array([at]), smooth.curvature_per_mm)[0][0])
    return Kink(float(at * c + height * s), float(height * c - at * s), tail_mm)


def _best_place(smooth: Arc, places_mm: FloatArray, tail_mm: float) -> tuple[float, float]:
    """Return the best of some positions s of a kink, mm, and the square root of its gain, mm.

    The gain is the reduction of the sum of squared residuals. Its root is negative if the sheet
    would have to be below the obstacle.
    """
    kink, curvature = Kink(0.0, 0.0, tail_mm), smooth.curvature_per_mm
    place, rest = smooth.place_mm[smooth.used], smooth.rest_mm[smooth.used]
    turned = np.column_stack([kink.deflection(place, curvature, at)[1] for at in places_mm])
    # Without the part that the other parameters fit, too (Frisch, Waugh and Lovell).
    basis = np.linalg.qr(smooth.design[smooth.used])[0]
    turned -= basis @ (basis.T @ turned)
    gain = -(rest @ turned) / np.maximum(np.linalg.norm(turned, axis=0), 1e-12)
    best = int(np.argmax(gain))
    return float(places_mm[best]), float(gain[best])


def _design(place: FloatArray, along: FloatArray) -> FloatArray:
    ones = np.ones_like(place)
    return np.column_stack(
        [ones, place, place**2, along, along**2, place * along, place * along**2]
    )


def _covariance(
    section: CoatSection, design: FloatArray, rest: FloatArray, used: BoolArray
) -> FloatArray:
    residuals, members = np.zeros(section.cells.shape), np.zeros(section.cells.shape, bool)
    residuals[section.cells], members[section.cells] = rest, used
    scatter = scatter_of(residuals, members)
    normal = design[used].T @ design[used]
    return np.asarray(np.linalg.inv(normal) * scatter.variance * scatter.correlated_cells)


def _rise(
    place_mm: FloatArray, curvature_per_mm: float, start_rad: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Return the heights, mm, of a circle over its point at 0, and its slopes; (n,) each.

    Parameters
    ----------
    start_rad : angle of the circle's tangent at 0
    """
    sine = _limited(np.sin(start_rad) + curvature_per_mm * place_mm)
    cosine = np.sqrt(1 - sine**2)
    return place_mm * (np.sin(start_rad) + sine) / (np.cos(start_rad) + cosine), sine / cosine


def _limited(sine: FloatArray | float) -> FloatArray:
    return np.asarray(np.clip(sine, -_LARGEST_SINE, _LARGEST_SINE))


def _over_parabola(place_mm: FloatArray, curvature_per_mm: float) -> FloatArray:
    """Return the height, mm, of a circle above the parabola of equal curvature at the vertex."""
    return _rise(place_mm, curvature_per_mm)[0] - curvature_per_mm * place_mm**2 / 2
