"""Heights of a specimen at any point, and results of finite elements on the grids of a press.

A specimen returns its heights on grids only, but finite elements need heights, slopes and
curvatures at any point. Heights are therefore sampled once and interpolated by bicubic splines.
Results at scattered points are interpolated on the grids of `PressedElastomer`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy import ndimage
from scipy.interpolate import LinearNDInterpolator, RectBivariateSpline

from reconstruction.arrays import BoolArray, FloatArray
from twin.config.models import Elastomer, Press
from twin.mechanics.errors import PressError
from twin.mechanics.layouts import cell_centres, face_nodes
from twin.mechanics.press import PressedElastomer
from twin.mechanics.validity import Validity, contact_validity, with_sides
from twin.shape import Shape

# A cell touches if this share of the integration points round it is loaded: under a curved specimen
# some points of a facet in contact are not loaded.
_TOUCHING = 0.3

# Height error over depth of the default bricks, from comparisons with the spectral press at small
# strain and with elements of half the size.
_ELEMENT_ERROR = 5e-3

FaceHeight = Callable[[FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True)
class Scattered:
    """Result of a press by finite elements, at scattered points; mm, world frame."""

    #: functions of x and y (...), mm, that return world z of each face (...), mm
    touched: FaceHeight
    coated: FaceHeight
    #: integration points of the touched face: (point, [x, y]) positions, (point,) force over
    #: modulus, mm^2, and (point,) area in plan
    at_mm: FloatArray
    force: FloatArray
    plan_mm2: FloatArray
    #: the points are sorted by facet
    points_per_facet: int
    depth_mm: float
    iterations: int
    #: True if solved at large strain, which a linear slab neglects
    large_strain: bool = False


def on_grids(
    solved: Scattered, shape: Shape, elastomer: Elastomer, load: Press, modulus_kpa: float
) -> PressedElastomer:
    """Return the result of finite elements on the solver's cells and the relief's nodes.

    The pressure on a cell is interpolated between the means of facets. It is scaled so that its sum
    over the cells is the force.

    Raises
    ------
    PressError : the contact is too small for the cells
    """
    x, y = cell_centres(elastomer.length_x_mm, load), cell_centres(elastomer.length_y_mm, load)
    nodes_x, nodes_y = (
        face_nodes(length, load) for length in (elastomer.length_x_mm, elastomer.length_y_mm)
    )
    cell_mm2 = float((x[1] - x[0]) * (y[1] - y[0]))
    pressure = _pressure(solved, x, y, cell_mm2)
    force = float(solved.force.sum())
    face_z = solved.coated(*np.meshgrid(nodes_x, nodes_y))
    contact = pressure > 0
    return PressedElastomer(
        x_mm=x,
        y_mm=y,
        pressure_kpa=pressure * modulus_kpa,
        contact=contact,
        touched_face_mm=solved.touched(*np.meshgrid(x, y)),
        # kPa mm^2 = 1e-3 N
        force_n=force * modulus_kpa * 1e-3,
        depth_mm=solved.depth_mm,
        young_modulus_kpa=modulus_kpa,
        face_x_mm=nodes_x,
        face_y_mm=nodes_y,
        face_z_mm=face_z,
        validity=_validity(solved, shape, elastomer, (x, y, contact), float(np.abs(face_z).max())),
        iterations=solved.iterations,
        converged=True,
    )


def check_depth(depth_mm: float, elastomer: Elastomer) -> None:
    """Raise an error if the depth that was solved is the slab's thickness or more.

    Raises
    ------
    PressError : the message states depth and thickness
    """
    if depth_mm >= elastomer.thickness_mm:
        raise PressError(
            f"press: needs a depth of {depth_mm:.3g} mm, which is not less than the slab's "
            f"thickness of {elastomer.thickness_mm:g} mm; press less or use a thicker slab"
        )


def _validity(
    solved: Scattered,
    shape: Shape,
    elastomer: Elastomer,
    cells: tuple[FloatArray, FloatArray, BoolArray],
    peak_mm: float,
) -> Validity:
    judge = partial(contact_validity, shape, elastomer, cells)
    judged = judge(solved.depth_mm, peak_mm)
    if not solved.large_strain:
        return with_sides(judged)
    # At large strain, depth and deflection need no warning: only the other warnings remain.
    remaining = judge(0.0, 0.0).warnings
    error_mm = _ELEMENT_ERROR * solved.depth_mm
    return replace(judged, height_error_mm=error_mm, warnings=remaining)


def _pressure(solved: Scattered, x: FloatArray, y: FloatArray, cell_mm2: float) -> FloatArray:
    """Return pressure over modulus (row, col), 0 on cells that do not touch the specimen."""
    # The pressure oscillates between the points of a facet: means over facets are used.
    at, force, area = (
        data.reshape(-1, solved.points_per_facet, *data.shape[1:])
        for data in (solved.at_mm, solved.force, solved.plan_mm2)
    )
    mean, loaded = force.sum(axis=1) / area.sum(axis=1), np.mean(force > 0, axis=1)
    values = np.stack((mean, loaded), axis=1)
    on_cells = LinearNDInterpolator(at.mean(axis=1), values, fill_value=0.0)(*np.meshgrid(x, y))
    near = on_cells[..., 1] > min(_TOUCHING, 0.5 * float(loaded.max()))
    pressure: FloatArray = np.where(near, np.maximum(on_cells[..., 0], 0.0), 0.0)
    total = float(pressure.sum()) * cell_mm2
    if total <= 0:
        raise PressError(
            "press: the contact is smaller than a cell; use a finer press.solver_pitch_mm"
        )
    return np.asarray(pressure * (float(solved.force.sum()) / total))


_LARGEST_GRID = 800
_FINEST_PITCH_MM = 0.02
# Number of cells by which the grid extends beyond the specimen, more than a spline's support.
_REACH_CELLS = 2


@dataclass(frozen=True)
class HeightField:
    """Height of a specimen behind its foremost point, sampled on a grid."""

    #: (col,) and (row,) positions of the samples
    x_mm: FloatArray
    y_mm: FloatArray
    #: (row, col) mm, inf outside the specimen
    height_mm: FloatArray

    def value(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return the height at points (n,), mm; inf outside the specimen."""
        height = np.asarray(self._spline.ev(y_mm, x_mm), dtype=np.float64)
        return np.where(self._is_present(x_mm, y_mm), height, np.inf)

    def slope(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return the first derivatives of the height (n, [x, y]), smooth also outside it."""
        along = [self._spline.ev(y_mm, x_mm, dx=dy, dy=dx) for dx, dy in ((1, 0), (0, 1))]
        return np.stack(along, axis=-1)

    def curvature(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return the second derivatives of the height (n, [x, y], [x, y]), 1/mm."""
        xx, xy, yy = (
            self._spline.ev(y_mm, x_mm, dx=dy, dy=dx) for dx, dy in ((2, 0), (1, 1), (0, 2))
        )
        return np.stack((np.stack((xx, xy), axis=-1), np.stack((xy, yy), axis=-1)), axis=-1)

    def _is_present(self, x_mm: FloatArray, y_mm: FloatArray) -> BoolArray:
        row = np.clip(np.searchsorted(self.y_mm, y_mm) - 1, 0, self.y_mm.size - 2)
        col = np.clip(np.searchsorted(self.x_mm, x_mm) - 1, 0, self.x_mm.size - 2)
        known = np.isfinite(self.height_mm)
        whole = known[:-1, :-1] & known[1:, :-1] & known[:-1, 1:] & known[1:, 1:]
        within = (x_mm >= self.x_mm[0]) & (x_mm <= self.x_mm[-1])
        within &= (y_mm >= self.y_mm[0]) & (y_mm <= self.y_mm[-1])
        return np.asarray(whole[row, col] & within)

    @cached_property
    def _spline(self) -> RectBivariateSpline:
        absent = ~np.isfinite(self.height_mm)
        nearest = ndimage.distance_transform_edt(
            absent, return_distances=False, return_indices=True
        )
        return RectBivariateSpline(self.y_mm, self.x_mm, self.height_mm[tuple(nearest)])


def sample(shape: Shape, length_x_mm: float, length_y_mm: float) -> HeightField:
    """Sample the heights of a specimen within a centred rectangle, at most some 800 per axis.

    Raises
    ------
    PressError : the specimen is outside the rectangle
    """
    x_low, x_high, y_low, y_high = shape.bounds_mm()
    x = _axis(max(x_low, -length_x_mm / 2), min(x_high, length_x_mm / 2))
    y = _axis(max(y_low, -length_y_mm / 2), min(y_high, length_y_mm / 2))
    height = shape.height_above_lowest(x, y) if x.size and y.size else np.full((1, 1), np.inf)
    if not np.isfinite(height).any():
        raise PressError("specimen: outside the pad's touched face; move it")
    return HeightField(x, y, height)


def _axis(low: float, high: float) -> FloatArray:
    """Return sample positions (n,), mm, from 2 cells below `low` to 2 cells above `high`."""
    if high <= low:
        return np.zeros(0)
    pitch = max((high - low) / _LARGEST_GRID, _FINEST_PITCH_MM)
    half = np.ceil((high - low) / 2 / pitch) + _REACH_CELLS
    return (low + high) / 2 + pitch * np.arange(-half, half + 1)
