"""The undeformed sheet on a grid of spline cells, with a fixed rim or springs at the rim.

The parameters (x, y) of the splines are coordinates on the undeformed sheet, mm, before it is
stretched into its frame. With a pre-stretch of 1.1, a sheet of span L was cut to L / 1.1. For a
round sheet the parameters cover a square that is mapped to the disc, so that the rim is a grid
line.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from reconstruction.arrays import FloatArray
from twin.mechanics.sheet.laws import Rest
from twin.mechanics.sheet.splines import SplineLine
from twin.mechanics.sheet.surface import points_on, surface_at
from twin.mechanics.sheet.thickness import SheetThickness

Outline = Literal["rectangular", "round"]
Rim = Literal["clamped", "simple"]
_NO_DEVIATION = np.zeros((0, 0, 0))


@dataclass(frozen=True)
class Frame:
    """Frame of the sheet: its opening, centred on the world's origin, support and pre-stretch."""

    length_x_mm: float
    length_y_mm: float
    outline: Outline = "rectangular"
    rim: Rim = "clamped"
    pre_stretch: float = 1.0
    #: displacement of the edge along the frame per line tension, mm per N/mm
    rim_compliance_mm2_per_n: float = 0.0

    @property
    def half_mm(self) -> tuple[float, float]:
        """Half lengths of the opening along x and y, mm."""
        return self.length_x_mm / 2, self.length_y_mm / 2


@dataclass(frozen=True, eq=False)
class SheetGrid:
    """Cells (row along y, col along x), their control points, and which components are free."""

    frame: Frame
    x: SplineLine
    y: SplineLine
    rest: Rest
    #: (row + 2, col + 2, 3) control points of the mounted, unloaded sheet, z = 0
    mounted_mm: FloatArray
    #: (row + 2, col + 2, xyz) components of the control points that may move
    free: npt.NDArray[np.bool_]
    #: thickness field of the undeformed sheet; None: uniform
    thickness: SheetThickness | None = None

    def with_thickness(self, field: SheetThickness | None) -> "SheetGrid":
        """Return this grid with another thickness field; None: uniform."""
        if field is None:
            rest = self.rest._replace(deviation_mm=_NO_DEVIATION)
            return replace(self, rest=rest, thickness=None)
        x, y = self.x.points.ravel(), self.y.points.ravel()
        along = replace(self, thickness=field)
        deviation = along.deviation_mm(self.evaluate(self.mounted_mm, x, y)[..., 0, :2])
        rows, cols = self.y.cells, self.x.cells
        by_point = deviation.reshape(rows, 2, cols, 2).transpose(0, 2, 1, 3)
        rest = self.rest._replace(deviation_mm=by_point.reshape(rows, cols, 4))
        return replace(along, rest=rest)

    def deviation_mm(self, material_mm: FloatArray) -> FloatArray:
        """Return local minus mean undeformed thickness, mm; 0 for a uniform sheet.

        `material_mm` (..., xy) are positions on the mounted sheet.
        """
        if self.thickness is None:
            return np.zeros(material_mm.shape[:-1])
        X, Y = np.moveaxis(material_mm / self.frame.pre_stretch, -1, 0)
        return self.thickness.deviation_mm(X, Y)

    def evaluate(self, control_mm: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return position, mm, and derivatives along the undeformed sheet, (y, x, 3, xyz).

        Parameters
        ----------
        control_mm : (row + 2, col + 2, xyz)
        x, y : (x,) and (y,) parameters of the grid's points, ascending
        """
        return surface_at(control_mm, points_on(self.x, x), points_on(self.y, y), self.cut(x, y))

    def cut(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the map of the undeformed sheet at parameters x and y, see `surface_at`."""
        if self.frame.outline == "rectangular":
            return np.zeros((5, 0, 0))
        return _Map(self.frame, self.x, self.y).sampled(x, y)

    def moved_from(self, source: "SheetGrid", control_mm: FloatArray) -> FloatArray:
        """Return control points of this grid for a surface that is given on the grid `source`.

        `control_mm` are the control points of `source`, (row + 2, col + 2, xyz).
        """
        across, along = self.y.interpolated_from(source.y), self.x.interpolated_from(source.x)
        displaced = control_mm - source.mounted_mm
        moved = np.einsum("ai,ijk,bj->abk", across, displaced, along, optimize=True)
        return self.mounted_mm + np.where(self.free, moved, 0.0)


def sheet_grid(frame: Frame, x: SplineLine, y: SplineLine) -> SheetGrid:
    """Return the grid of a mounted sheet on spline lines that cover its unstretched span."""
    control = _Map(frame, x, y).control_mm()
    mounted = np.concatenate((control * frame.pre_stretch, np.zeros((y.size, x.size, 1))), axis=2)
    free = np.zeros(mounted.shape, dtype=bool)
    free[1:-1, 1:-1] = True
    if frame.rim == "clamped":  # the slope follows from the height of the next control points
        free[..., 2] = False
        free[2:-2, 2:-2, 2] = True
    if frame.rim_compliance_mm2_per_n:
        free[..., :2] = True
    return SheetGrid(frame, x, y, _rest(frame, x, y, control), mounted, free)


def span_mm(frame: Frame) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the ends (low, high), mm, of the unstretched sheet along x and along y."""
    half_x, half_y = (half / frame.pre_stretch for half in frame.half_mm)
    return (-half_x, half_x), (-half_y, half_y)


@dataclass(frozen=True, eq=False)
class _Map:
    """Map from the spline parameters to positions on the undeformed sheet; the map is a spline."""

    frame: Frame
    x: SplineLine
    y: SplineLine

    def control_mm(self) -> FloatArray:
        """Return the control points of the map, (row + 2, col + 2, xy), mm."""
        u, v = np.meshgrid(self.x.greville, self.y.greville)
        if self.frame.outline == "rectangular":
            return np.stack((u, v), axis=-1)
        # A square to a disc: lines of constant u and v become ellipses.
        across, along = u / u.max(), v / v.max()
        radius = u.max()
        values = radius * np.stack(
            (across * np.sqrt(1 - along**2 / 2), along * np.sqrt(1 - across**2 / 2)), axis=-1
        )
        back_y = np.linalg.inv(self.y.matrix(self.y.greville))
        back_x = np.linalg.inv(self.x.matrix(self.x.greville))
        control: FloatArray = np.einsum("ai,ijk,bj->abk", back_y, values, back_x, optimize=True)
        return control

    def sampled(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return X_u, Y_u, X_v, Y_v and their determinant, (5, y, x), at parameters x and y.

        (X, Y) is the position on the undeformed sheet; u and v are the parameters.
        """
        control = self.control_mm()
        (xu, yu), (xv, yv) = (
            np.einsum(
                "ai,ijk,bj->kab", self.y.matrix(y, dy), control, self.x.matrix(x, dx), optimize=True
            )
            for dx, dy in ((1, 0), (0, 1))
        )
        return np.stack((xu, yu, xv, yv, xu * yv - yu * xv))


def normal_of(surface: FloatArray) -> FloatArray:
    """Return the unit normals (..., xyz) of a surface.

    `surface` is (..., 3, xyz): position, and its derivatives by the two sheet coordinates.
    """
    across, stretch = _across(surface)
    return np.stack([component / stretch for component in across], axis=-1)


def thinning_of(surface: FloatArray) -> FloatArray:
    """Return the thickness stretch lambda = 1 / area stretch of a surface, as for `normal_of`."""
    thinning: FloatArray = 1 / _across(surface)[1]
    return thinning


def _across(surface: FloatArray) -> tuple[list[FloatArray], FloatArray]:
    """Return the three components of the derivatives' cross product, and the area stretch.

    The area stretch is the length of the cross product.
    """
    # Component by component: Numpy's own takes five times as long.
    (ax, ay, az), (bx, by, bz) = (np.moveaxis(surface[..., n, :], -1, 0) for n in (1, 2))
    across = [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx]
    return across, np.sqrt(across[0] ** 2 + across[1] ** 2 + across[2] ** 2)


def _products(along_x: FloatArray, along_y: FloatArray) -> FloatArray:
    """Return the nine functions of each cell at its Gauss points, (row, col, 4, 9, 6).

    The last axis is the value and the derivatives d/du, d/dv, d2/du2, d2/dv2, d2/dudv by the spline
    parameters.
    """
    orders = ((0, 0), (1, 0), (0, 1), (2, 0), (0, 2), (1, 1))
    # (row, col, qy, qx, b, a, derivative)
    parts = [np.einsum("jqb,ipa->jiqpba", along_y[:, :, y], along_x[:, :, x]) for x, y in orders]
    shape = (along_y.shape[0], along_x.shape[0], 4, 9)
    return np.stack([part.reshape(shape) for part in parts], axis=-1)


def _rest(frame: Frame, x: SplineLine, y: SplineLine, control: FloatArray) -> Rest:
    """Return the undeformed sheet at its Gauss points."""
    shape = (y.cells, x.cells, 4)
    area = np.einsum("jq,ip->jiqp", y.weights, x.weights).reshape(shape)
    if frame.outline == "rectangular":
        return Rest(x.table, y.table, np.zeros((0, 0, 0, 0, 0)), area, _NO_DEVIATION)
    turned, det = _along_the_sheet(_products(x.table, y.table), control)
    return Rest(x.table, y.table, turned, area * det, _NO_DEVIATION)


def _along_the_sheet(functions: FloatArray, control: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the map of derivatives by the parameters to those along the sheet, and its area ratio.

    The map is (row, col, 4, 5, 5), see `Rest.turned`; the area ratio is (row, col, 4).
    """
    rows, cols = functions.shape[:2]
    cell = np.arange(9)
    local = control[
        np.arange(rows)[:, None, None] + cell // 3, np.arange(cols)[None, :, None] + cell % 3
    ]
    geometry = np.einsum("jiqnd,jink->dkjiq", functions, local)[..., None]
    (xu, yu), (xv, yv) = geometry[1], geometry[2]
    (xuu, yuu), (xvv, yvv), (xuv, yuv) = geometry[3], geometry[4], geometry[5]
    det = xu * yv - yu * xv
    by = np.eye(5)
    along_x = (by[0] * yv - by[1] * yu) / det
    along_y = (by[1] * xu - by[0] * xv) / det
    # Second derivatives less the map's own curvature, then J^-T (.) J^-1.
    uu = by[2] - xuu * along_x - yuu * along_y
    vv = by[3] - xvv * along_x - yvv * along_y
    uv = by[4] - xuv * along_x - yuv * along_y
    ux, uy, vx, vy = yv / det, -xv / det, -yu / det, xu / det
    second = (
        uu * ux * ux + 2 * uv * ux * vx + vv * vx * vx,
        uu * uy * uy + 2 * uv * uy * vy + vv * vy * vy,
        uu * ux * uy + uv * (ux * vy + uy * vx) + vv * vx * vy,
    )
    return np.stack((along_x, along_y, *second), axis=-2), det[..., 0]
