"""Compute the stretch of a sheet on its deformed surface by minimising the stretching energy.

Lengths are in mm. A sheet without friction slides along its own deformed surface until the tension
is in equilibrium. Contact force and air pressure act along the normal and do no work on that
motion. The stretch is therefore determined by the surface and the clamped rim, without pressure or
modulus. There is one small exception. In contact the sheet is squeezed: a piece that becomes
thicker lifts its own middle by half of the increase against the contact pressure p. This changes
the stretch by p / mu, with the shear modulus mu.

The unknown is X(x, y): the point of the undeformed sheet that is now on the surface at (x, y). X is
bilinear on square elements. With the surface's metric G, B = dX/dx, D = det B, the undeformed
thickness h and the incompressible neo-Hookean energy mu h/2 (tr a + 1/det a - 3),
a = B^-T G B^-1, an element has the energy per area of x, y

    psi = tr(A^T G A) / D + D^3 / det G - (3 - p / mu) D,  A = adj B   (in units of mu h / 2).

A compliant rim lets the sheet slide in by s X - x relative to the mounted sheet, against springs of
stiffness k per length of the rim. Their energy is k / (mu h) |s X - x|^2 in the same units. The
mounted sheet is in equilibrium: the springs carry its tension.

Newton's method minimises the energy. If Newton's step does not lower the energy, it is repeated
without the part of the second derivative that may be indefinite, the derivative of energy by D
times the second derivative of D. Bending is neglected: its force along the surface is of order
(h / R)^2 for a radius of curvature R.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.errors import FitError

_MOST_STEPS = 60
_TOLERANCE = 1e-7
_LEAST_SHARE = 1e-4
# Least det B of an element after a step, as a share of the value before it.
_SHRINKS_TO = 0.2
_GAUSS = 0.5 / np.sqrt(3.0)
_CORNERS = np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]]) / 2.0
_HESSIAN_OF_D = np.zeros((4, 4))
_HESSIAN_OF_D[0, 3] = _HESSIAN_OF_D[3, 0] = 1.0
_HESSIAN_OF_D[1, 2] = _HESSIAN_OF_D[2, 1] = -1.0


@dataclass(frozen=True, eq=False)
class SurfaceMetric:
    """Metric of a surface, and the boundary conditions of the sheet, on a grid of elements.

    Attributes
    ----------
    x_mm, y_mm : (col + 1,), (row + 1,) coordinates of the nodes, increasing
    xx, xy, yy : (row, col) components of the metric, means over each element
    squeeze : (row, col) ratio of contact pressure to shear modulus
    held : (row + 1, col + 1) bool, nodes at which the frame holds the sheet
    springs : (row + 1, col + 1) stiffness of the springs at held nodes over shear modulus x
        thickness; a held node with the value 0 is fixed; None: all held nodes are fixed
    """

    x_mm: FloatArray
    y_mm: FloatArray
    xx: FloatArray
    xy: FloatArray
    yy: FloatArray
    squeeze: FloatArray
    held: BoolArray
    springs: FloatArray | None = None

    @property
    def flat(self) -> "SurfaceMetric":
        """Metric of the flat surface of the mounted sheet, on the same elements, not squeezed."""
        ones, none = np.ones_like(self.xx), np.zeros_like(self.xx)
        return replace(self, xx=ones, xy=none, yy=ones, squeeze=none)

    @property
    def determinant(self) -> FloatArray:
        """Squared ratio of the surface's area to its area projected on x and y, (row, col)."""
        return self.xx * self.yy - self.xy**2


@dataclass(frozen=True, eq=False)
class MaterialMap:
    """Solution of `material_map`: thinning, tension and material points on a grid of elements.

    Attributes
    ----------
    thinning : (row, col) ratio of local to undeformed thickness, at the middles of the elements
    tension : (row, col, 3) contravariant components xx, xy, yy of the line tension over mu h
    material_mm : (row + 1, col + 1, xy) X at the nodes, a point of the undeformed sheet
    steps : number of Newton steps
    """

    thinning: FloatArray
    tension: FloatArray
    material_mm: FloatArray
    steps: int


def material_map(
    metric: SurfaceMetric, pre_stretch: float = 1.0, near: MaterialMap | None = None
) -> MaterialMap:
    """Compute the map X of a sheet on a surface that has the least stretching energy.

    Parameters
    ----------
    metric : surface and boundary conditions of the sheet
    pre_stretch : ratio of mounted to undeformed length, equal along x and y
    near : map for a similar surface on the same elements, used as the starting point; None: the
        iteration starts at the mounted sheet

    Raises
    ------
    FitError : the iteration finds no equilibrium of the sheet on this surface
    """
    x, y = np.meshgrid(metric.x_mm, metric.y_mm)
    mounted = np.stack((x, y), axis=-1) / pre_stretch
    place = near.material_mm if near else mounted
    elements, held = _Elements.on(metric), metric.held
    if metric.springs is not None:
        elements = elements.on_springs(metric, metric.springs, mounted, pre_stretch)
        held = held & (metric.springs == 0)
    free = np.repeat(~held.ravel(), 2)
    size = float(np.sqrt(elements.weight.sum()))
    value, gradient, rows = elements.energy(place)
    for step in range(_MOST_STEPS):
        if float(np.abs(gradient[free]).max(initial=0.0)) <= _TOLERANCE * size:
            return _solved(elements, metric, place, step)
        move = _newton_move(elements, rows, gradient, free)
        place, value, gradient, rows = _along(elements, place, move, (value, gradient))
    raise FitError(
        f"membrane: no equilibrium in {_MOST_STEPS} steps; the relief is too rough: smooth it more"
    )


@dataclass(frozen=True, eq=False)
class _Elements:
    """Bilinear elements with four Gauss points each, and the energy of the sheet on them.

    B at a Gauss point is a linear function of X at the nodes of the element.
    """

    nodes: np.ndarray  # (element, 4) node numbers
    slopes: FloatArray  # (point, 2, 4) derivatives of the shape functions, for all elements
    metric: FloatArray  # (element, 3)
    linear: FloatArray  # (element,) of the energy in D
    weight: FloatArray  # (element,) area of x and y of a Gauss point
    quadratic: FloatArray  # (element, 4, 4): tr(A^T G A) = b^T Q b
    count: int
    rim: "_Springs | None" = field(default=None)

    @classmethod
    def on(cls, metric: SurfaceMetric) -> "_Elements":
        rows, cols = metric.xx.shape
        number = np.arange((rows + 1) * (cols + 1)).reshape(rows + 1, cols + 1)
        corners = (number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:])
        nodes = np.stack([corner.ravel() for corner in corners], axis=-1)
        step = (metric.x_mm[1] - metric.x_mm[0], metric.y_mm[1] - metric.y_mm[0])
        points = _GAUSS * 2 * _CORNERS
        slopes = np.stack([_slopes(point, step) for point in points])
        g = np.stack([metric.xx.ravel(), metric.xy.ravel(), metric.yy.ravel()], axis=-1)
        weight = np.full(len(nodes), step[0] * step[1] / 4)
        linear = metric.squeeze.ravel() - 3.0
        return cls(nodes, slopes, g, linear, weight, _quadratic(g), number.size)

    def on_springs(
        self, metric: SurfaceMetric, rim: FloatArray, mounted: FloatArray, pre_stretch: float
    ) -> "_Elements":
        """Return the elements with springs at the rim that carry the tension of the mounted sheet.

        Parameters
        ----------
        rim : (row + 1, col + 1) `SurfaceMetric.springs`
        mounted : (row + 1, col + 1, xy) X of the mounted sheet, mm
        """
        # Elements outside the frame get no weight: the sheet slides there without resistance.
        beyond = metric.held.ravel()[self.nodes].all(axis=1)
        flat = replace(_Elements.on(metric.flat), weight=np.where(beyond, 0.0, self.weight))
        springs = 2 * pre_stretch**2 * np.repeat(rim.ravel(), 2)
        pulled = np.where(springs > 0, flat.energy(mounted)[1], 0.0)
        return replace(self, weight=flat.weight, rim=_Springs(mounted.ravel(), springs, pulled))

    def gradients(self, place: FloatArray) -> FloatArray:
        """Return B at the Gauss points, (point, element, 4): B_xx, B_xy, B_yx, B_yy."""
        corners = place.reshape(-1, 2)[self.nodes]
        slopes = self.slopes.reshape(-1, 4)
        b = slopes @ np.moveaxis(corners, 1, 0).reshape(4, -1)
        b = b.reshape(len(self.slopes), 2, len(corners), 2)
        return np.asarray(np.moveaxis(b, 1, 3).reshape(*b.shape[::2], 4))

    def determinants(self, place: FloatArray) -> FloatArray:
        """Return det B at the Gauss points, (point, element)."""
        b = self.gradients(place)
        return np.asarray(b[..., 0] * b[..., 3] - b[..., 1] * b[..., 2])

    def value(self, place: FloatArray) -> float:
        return self._value(place, self.gradients(place))

    def _value(self, place: FloatArray, b: FloatArray) -> float:
        d = b[..., 0] * b[..., 3] - b[..., 1] * b[..., 2]
        if float(d.min()) <= 0:
            return np.inf
        g = self.metric[:, 0] * self.metric[:, 2] - self.metric[:, 1] ** 2
        q = _dot(b, self._by_quadratic(b))
        of_rim = self.rim.energy(place) if self.rim else 0.0
        return float(np.sum(self.weight * (q / d + d**3 / g + self.linear * d))) + of_rim

    def energy(self, place: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Return the energy, its gradient (2 node + xy,), and B at the Gauss points.

        The energy is in units of mu h / 2.
        """
        b = self.gradients(place)
        d, to_d, pull, _g, _q, q_slope = self._parts(b)
        by_b = self.weight[:, None] * (q_slope / d[..., None] + pull[..., None] * to_d)
        by_node = sum(
            np.matmul(by_b_i.reshape(-1, 2, 2), slopes)
            for by_b_i, slopes in zip(by_b, self.slopes, strict=True)
        )
        by_node = np.swapaxes(by_node, 1, 2)
        gradient = np.zeros(2 * self.count)
        for axis in range(2):
            gradient[axis::2] = np.bincount(
                self.nodes.ravel(), by_node[..., axis].ravel(), self.count
            )
        if self.rim:
            gradient += self.rim.gradient(place)
        return self._value(place, b), gradient, b

    def tangent(self, b: FloatArray, *, whole: bool) -> sparse.csc_matrix:
        """Return the second derivative of the energy, square with 2 unknowns per node.

        Parameters
        ----------
        b : (point, element, 4) B at the Gauss points
        whole : True to include the part that may be indefinite
        """
        d, to_d, pull, g, q, q_slope = self._parts(b)
        outer = q_slope[..., :, None] * to_d[..., None, :]
        second = 2 * self.quadratic[None] / d[..., None, None]
        second = second - (outer + np.swapaxes(outer, -1, -2)) / d[..., None, None] ** 2
        both = (2 * q / d**3 + 6 * d / g)[..., None, None]
        second = second + both * (to_d[..., :, None] * to_d[..., None, :])
        if whole:
            second = second + pull[..., None, None] * _HESSIAN_OF_D
        points, count = b.shape[:2]
        parts = (second * self.weight[:, None, None]).reshape(points, count, 2, 2, 2, 2)
        block = np.einsum("peidjf,pdn,pfm->enimj", parts, self.slopes, self.slopes, optimize=True)
        unknown = (2 * self.nodes[:, :, None] + np.arange(2)).reshape(count, 8)
        rows = np.repeat(unknown, 8, axis=1).ravel()
        cols = np.tile(unknown, (1, 8)).ravel()
        values = block.reshape(count, 64).ravel()
        inner = sparse.csc_matrix((values, (rows, cols)), shape=(2 * self.count,) * 2)
        return inner + sparse.diags(self.rim.stiffness, format="csc") if self.rim else inner

    def _by_quadratic(self, b: FloatArray) -> FloatArray:
        """Return Q b, (point, element, 4), with the components of Q as in `_quadratic`."""
        xx, xy, yy = self.metric.T
        rows = [yy * b[..., 0] - xy * b[..., 1], xx * b[..., 1] - xy * b[..., 0],
                yy * b[..., 2] - xy * b[..., 3], xx * b[..., 3] - xy * b[..., 2]]  # fmt: skip
        return np.stack(rows, axis=-1)

    def _parts(self, b: FloatArray) -> tuple[FloatArray, ...]:
        """Return D, dD/dB, the derivative of the energy by D, det G, b^T Q b and 2 Q b."""
        d = b[..., 0] * b[..., 3] - b[..., 1] * b[..., 2]
        to_d = np.stack((b[..., 3], -b[..., 2], -b[..., 1], b[..., 0]), axis=-1)
        g = self.metric[:, 0] * self.metric[:, 2] - self.metric[:, 1] ** 2
        by_q = self._by_quadratic(b)
        q = _dot(b, by_q)
        return d, to_d, -q / d**2 + 3 * d**2 / g + self.linear, g, q, 2 * by_q


@dataclass(frozen=True, eq=False)
class _Springs:
    """Springs of the rim's nodes; arrays in the order of the unknowns, index 2 node + xy.

    Attributes
    ----------
    mounted : X of the mounted sheet, mm
    stiffness : stiffness of each spring, 0 for nodes without a spring
    pulled : force of the mounted sheet, which the spring carries
    """

    mounted: FloatArray
    stiffness: FloatArray
    pulled: FloatArray

    def energy(self, place: FloatArray) -> float:
        off = place.ravel() - self.mounted
        return float(np.sum(off * (self.stiffness * off / 2 - self.pulled)))

    def gradient(self, place: FloatArray) -> FloatArray:
        return np.asarray(self.stiffness * (place.ravel() - self.mounted) - self.pulled)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the scalar products (point, element) of vectors (point, element, 4)."""
    return np.asarray((a * b).sum(axis=-1))


def _slopes(point: FloatArray, step: tuple[float, float]) -> FloatArray:
    """Return the derivatives of the four shape functions by x and y at a point, (2, 4), 1/mm.

    Parameters
    ----------
    point : (xy) position in the element, from -1/2 to 1/2
    step : (xy) edge lengths of an element, mm
    """
    along, across = 0.5 + 2 * _CORNERS[:, 0] * point[0], 0.5 + 2 * _CORNERS[:, 1] * point[1]
    by_x, by_y = 2 * _CORNERS[:, 0] * across / step[0], 2 * _CORNERS[:, 1] * along / step[1]
    return np.stack((by_x, by_y))


def _quadratic(g: FloatArray) -> FloatArray:
    """Return the matrices Q, (element, 4, 4), of tr(A^T G A) = b^T Q b.

    Here b = (B_xx, B_xy, B_yx, B_yy), and `g` (element, 3) are the components xx, xy, yy of G.
    """
    q = np.zeros((len(g), 4, 4))
    for first, second in ((1, 0), (3, 2)):
        q[:, first, first], q[:, second, second] = g[:, 0], g[:, 2]
        q[:, first, second] = q[:, second, first] = -g[:, 1]
    return q


def _newton_move(
    elements: _Elements, b: FloatArray, gradient: FloatArray, free: BoolArray
) -> FloatArray:
    """Return the step (2 node + xy,), mm, of the unknowns that lowers the energy.

    It is Newton's step, or, if that does not lower the energy, the step without the part of the
    second derivative that may be indefinite.
    """
    move = np.zeros_like(gradient)
    inner = np.flatnonzero(free)
    for whole in (True, False):
        tangent = elements.tangent(b, whole=whole)[inner][:, inner]
        move[inner] = -_factors(tangent).solve(gradient[inner])
        if float(move @ gradient) < 0:
            break
    return move


def _factors(symmetric: sparse.csc_matrix) -> SuperLU:
    # An ordering for symmetric matrices takes half the time.
    return splu(symmetric, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})


def _along(
    elements: _Elements, place: FloatArray, move: FloatArray, before: tuple[float, FloatArray]
) -> tuple[FloatArray, float, FloatArray, FloatArray]:
    """Return X at the nodes, energy, gradient and B after a line search along a step.

    Parameters
    ----------
    place : (row + 1, col + 1, xy) X at the nodes before the step
    before : energy and gradient before the step
    """
    value, gradient = before
    slope, least = float(move @ gradient), _SHRINKS_TO * elements.determinants(place)
    share, step = 1.0, move.reshape(place.shape)
    # In the last steps the decrease is as small as the sum's rounding error.
    slack = 1e-12 * abs(value)
    while share > _LEAST_SHARE:
        moved = place + share * step
        admissible = bool((elements.determinants(moved) > least).all())
        if admissible and elements.value(moved) <= value + 1e-4 * share * slope + slack:
            return moved, *elements.energy(moved)
        share /= 2
    raise FitError("membrane: no step lowers the energy; the relief is too rough: smooth it more")


def _solved(
    elements: _Elements, metric: SurfaceMetric, place: FloatArray, steps: int
) -> MaterialMap:
    """Return thinning and tension at the middles of the elements, from X at the nodes."""
    b = elements.gradients(place).mean(axis=0)
    d = b[:, 0] * b[:, 3] - b[:, 1] * b[:, 2]
    g = metric.determinant.ravel()
    # B^-1 B^-T = A A^T / D^2, A = [[B_yy, -B_xy], [-B_yx, B_xx]].
    away = np.stack(
        (
            b[:, 3] ** 2 + b[:, 1] ** 2,
            -b[:, 3] * b[:, 2] - b[:, 1] * b[:, 0],
            b[:, 2] ** 2 + b[:, 0] ** 2,
        ),
        axis=-1,
    )
    inverse = np.stack((elements.metric[:, 2], -elements.metric[:, 1], elements.metric[:, 0]), -1)
    area = np.sqrt(g) / d
    tension = (away / d[:, None] ** 2 - inverse / g[:, None] / area[:, None] ** 2) / area[:, None]
    shape = metric.xx.shape
    return MaterialMap((1 / area).reshape(shape), tension.reshape(*shape, 3), place, steps)
