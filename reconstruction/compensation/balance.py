"""Compute the contact pressure of an object under a sheet from sheet tension and air pressure.

Lengths are in mm, pressures in kPa, line tensions in kPa mm. In equilibrium along the coat's normal
p_contact = p_air - N : b. b is the curvature of the surface midway between the faces, positive in a
valley. N is the line tension of the sheet, computed from its stretch.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.compensation.line_loads import PressureMap, line_loads
from reconstruction.compensation.relief import Relief
from reconstruction.compensation.sheet_layer import SheetLayer
from reconstruction.evaluate.fit import spread

NORMAL_SIGMA_MM = 0.1
"""Standard deviation of the Gaussian filter of the heights for normals and metric."""
CURVATURE_SIGMA_MM = 0.3
"""Standard deviation of the Gaussian filter of the heights for the curvature."""
_SIGMAS_OF_CONTACT = 2.0
# Ratio of the least contact pressure to the pressure's noise, for the narrowest filter.
_SIGMAS_AT_FINE_SCALE = 4.0
_FINE_SIGMAS_MM = (0.1, 0.14, 0.2, 0.28)
_LEAST_FREE = 50
# Reach of an uneven curvature, in widths of the total blur.
_NEAR_WIDTHS = 2.0
# Half width at half maximum of a Gaussian, over its standard deviation.
_HALF_WIDTH = float(np.sqrt(2 * np.log(2)))


@dataclass(frozen=True, eq=False)
class StretchedCoat:
    """Thinning and line tension of the stretched sheet in each cell of the relief.

    Attributes
    ----------
    thinning : (row, col) ratio of the local thickness to the thickness of the undeformed sheet
    tension_kpa_mm : (row, col, 3) contravariant components xx, xy, yy of the line tension
    """

    thinning: FloatArray
    tension_kpa_mm: FloatArray

    def mean_tension_kpa_mm(self, shape: "CoatShape") -> FloatArray:
        """Return the mean of the two principal line tensions on a surface, (row, col)."""
        parts = self.tension_kpa_mm * shape.metric
        return np.asarray((parts[..., 0] + 2 * parts[..., 1] + parts[..., 2]) / 2)


@dataclass(frozen=True, eq=False)
class ContactBalance:
    """Contact pressure in each cell of the relief, and the cells in contact; arrays (row, col).

    Attributes
    ----------
    pressure_kpa : pressure of the object on the clear face
    sigma_kpa : standard uncertainty of the pressure, from noise and texture of the coat
    least_kpa : smallest pressure that counts as contact
    contact : bool, True for cells in contact
    upright_mm2 : area of the clear face in each cell, projected on the plane of x and y
    """

    pressure_kpa: FloatArray
    sigma_kpa: float
    least_kpa: float
    contact: BoolArray
    upright_mm2: FloatArray


@dataclass(frozen=True, eq=False)
class Footing:
    """Contact at the finest scale that noise and texture of the coat allow; (row, col) each.

    Attributes
    ----------
    sure : bool, cells that are certainly in contact: without those that the curvature's filter may
        have blurred, and without the bands next to edges in which the sheet may have lifted off
    enclosed : bool, cells with edges on all four sides
    uneven_per_mm : largest minus smallest curvature (sum of the two principal curvatures) of the
        contact cells near each cell; 0 if no contact cell is near
    pressure_kpa : pressure of the object on the clear face, at the contact's cells at least 0; 0 in
        the other cells
    """

    sure: BoolArray
    enclosed: BoolArray
    uneven_per_mm: FloatArray
    pressure_kpa: FloatArray


@dataclass(frozen=True, eq=False)
class CoatShape:
    """First and second fundamental forms and unit normals of the coat in each cell of the relief.

    Attributes
    ----------
    metric : (row, col, 3) components xx, xy, yy of the first fundamental form over x and y
    curvature : (row, col, 3) components xx, xy, yy of the second one, 1/mm, positive in a valley
    normal : (row, col, xyz) unit normal, upwards
    """

    metric: FloatArray
    curvature: FloatArray
    normal: FloatArray

    @classmethod
    def of(cls, relief: Relief, heights_mm: FloatArray) -> "CoatShape":
        """Return the fundamental forms and normals of filtered heights (row, col), mm."""
        # Heights are mirrored at the rim, as in the filter: the clamp's bend is in the first cells.
        z = np.pad(heights_mm, 2, mode="symmetric")
        step_x, step_y = relief.pitch_mm
        z_y, z_x = np.gradient(z, step_y, step_x)
        z_yy, z_yx = np.gradient(z_y, step_y, step_x)
        z_xx = np.gradient(z_x, step_x, axis=1)
        z_x, z_y, z_xx, z_yx, z_yy = (
            np.asarray(d)[2:-2, 2:-2] for d in (z_x, z_y, z_xx, z_yx, z_yy)
        )
        upright: FloatArray = np.asarray(1 / np.sqrt(1 + z_x**2 + z_y**2), np.float64)
        metric = np.stack((1 + z_x**2, z_x * z_y, 1 + z_y**2), axis=-1)
        curvature = np.stack((z_xx, z_yx, z_yy), axis=-1) * upright[..., None]
        normal = np.stack((-z_x, -z_y, np.ones_like(z_x)), axis=-1) * upright[..., None]
        return cls(metric, curvature, normal)

    @property
    def bend_per_mm(self) -> FloatArray:
        """Sum of the two principal curvatures of the coat, (row, col), positive in a valley."""
        g_xx, g_xy, g_yy = np.moveaxis(self.metric, -1, 0)
        b_xx, b_xy, b_yy = np.moveaxis(self.curvature, -1, 0)
        trace = g_yy * b_xx - 2 * g_xy * b_xy + g_xx * b_yy
        return np.asarray(trace / (g_xx * g_yy - g_xy**2))

    def between(self, below_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return metric and curvature of the surface at a depth below the coat, over x and y.

        Both are (row, col, 3) with the components xx, xy, yy. For a depth t = `below_mm` (row, col)
        the differential of r - t n is dr + t (G^-1 b) dr, with the coat's metric G and curvature b.
        The metric of that surface is G + 2 t b + t^2 b G^-1 b, its curvature b + t b G^-1 b.
        """
        t = below_mm[..., None]
        determinant = self.metric[..., 0] * self.metric[..., 2] - self.metric[..., 1] ** 2
        g_xx, g_xy, g_yy = np.moveaxis(self.metric / determinant[..., None], -1, 0)
        b_xx, b_xy, b_yy = np.moveaxis(self.curvature, -1, 0)
        square = np.stack(
            (
                g_yy * b_xx**2 - 2 * g_xy * b_xx * b_xy + g_xx * b_xy**2,
                g_yy * b_xx * b_xy - g_xy * (b_xx * b_yy + b_xy**2) + g_xx * b_xy * b_yy,
                g_yy * b_xy**2 - 2 * g_xy * b_xy * b_yy + g_xx * b_yy**2,
            ),
            axis=-1,
        )
        return (
            np.asarray(self.metric + 2 * t * self.curvature + t**2 * square),
            np.asarray(self.curvature + t * square),
        )


class CoatShapes:
    """Fundamental forms of a relief after simple Gaussian filters, each computed once."""

    def __init__(self, relief: Relief) -> None:
        self._relief = relief
        self._shapes: dict[float, CoatShape] = {}

    def blurred(self, sigma_mm: float) -> CoatShape:
        """Return the fundamental forms after a filter of the given standard deviation."""
        if sigma_mm not in self._shapes:
            self._shapes[sigma_mm] = CoatShape.of(self._relief, self._relief.blurred(sigma_mm))
        return self._shapes[sigma_mm]


@dataclass(frozen=True, eq=False)
class FinestPressure:
    """Contact pressure at the finest scale that noise and texture of the coat allow.

    Attributes
    ----------
    pressure_kpa : (row, col)
    shape : fundamental forms of the coat after the filter
    sigma_mm : standard deviation of the filter
    noise_kpa : standard deviation of the noise of `pressure_kpa`
    """

    pressure_kpa: FloatArray
    shape: CoatShape
    sigma_mm: float
    noise_kpa: float

    def in_contact_kpa(self, contact: BoolArray) -> FloatArray:
        """Return the pressure in the cells in contact, at least 0, and 0 in other cells."""
        return np.where(contact, np.maximum(self.pressure_kpa, 0.0), 0.0)


def balanced(
    relief: Relief, layer: SheetLayer, shape: CoatShape, stretched: StretchedCoat
) -> ContactBalance:
    """Return the contact pressure in each cell of the relief, and the cells in contact.

    Parameters
    ----------
    shape : fundamental forms of the coat, from heights filtered with `CURVATURE_SIGMA_MM`
    stretched : thinning and line tension of the sheet on the cells of the relief
    """
    tension, below = stretched.tension_kpa_mm, layer.thickness_mm / 2 * stretched.thinning
    pressure = _pressure(relief, layer, shape, stretched)
    sigma = _sigma_of_pressure(relief, tension)
    least = max(layer.back_pressure_kpa / 2, _SIGMAS_OF_CONTACT * sigma)
    if layer.back_pressure_kpa == 0.0:
        least = max(least, 0.25 * float(np.percentile(pressure[relief.measured], 99)))
    carried = (pressure > least) & relief.measured & off_the_rim(relief)
    upright_mm2 = _area(shape.between(2 * below)[0]) * shape.normal[..., 2] * relief.cell_area_mm2
    contact = _up_to_half(_without_specks(carried, relief), pressure, relief, CURVATURE_SIGMA_MM)
    return ContactBalance(pressure, sigma, least, contact, upright_mm2)


def footing_of(
    relief: Relief,
    layer: SheetLayer,
    stretched: StretchedCoat,
    balance: ContactBalance,
    finest: FinestPressure,
) -> Footing:
    """Return the contact at the finest scale, and the cells that are certainly in contact.

    The contact pressure of an edge is a line load, which the curvature's filter spreads over the
    neighbouring free span. The pressure is therefore that of the narrowest filter that noise and
    texture of the coat allow, `finest_pressure`. A cell is certainly in contact only if it exceeds
    `balance.least_kpa`. The width of filter, cell and sheet bending is then removed from
    the contact's border, which also removes line contacts. Last, the bands next to edges are
    removed in which the sheet may have lifted off (`line_loads`).
    """
    pressure, shape = finest.pressure_kpa, finest.shape
    width_mm = float(np.hypot(finest.sigma_mm, layer.thickness_mm))
    carried = (pressure > balance.least_kpa) & relief.measured & off_the_rim(relief)
    pressed = _up_to_half(carried, pressure, relief, width_mm)
    edge_distance_mm = ndimage.distance_transform_edt(pressed, sampling=relief.pitch_mm[::-1])
    off_edges = edge_distance_mm > _HALF_WIDTH * width_mm + min(relief.pitch_mm)
    pressed_map = PressureMap(
        pressure_kpa=np.where(carried, pressure, 0.0),
        noise_kpa=finest.noise_kpa,
        blur_mm=width_mm,
        tension_kpa_mm=stretched.mean_tension_kpa_mm(shape),
        local_mm=layer.thickness_mm * stretched.thinning,
    )
    loads = line_loads(pressed_map, relief, layer)
    # A contact that is now only one or two cells wide was a line contact.
    sure = np.asarray(ndimage.binary_opening(off_edges & ~loads.lifted(), np.ones((3, 3))))
    uneven = _unevenness(shape.bend_per_mm, pressed, relief, _NEAR_WIDTHS * width_mm)
    return Footing(sure, loads.enclosed(), uneven, finest.in_contact_kpa(balance.contact))


def _unevenness(
    bend_per_mm: FloatArray, among: BoolArray, relief: Relief, reach_mm: float
) -> FloatArray:
    """Return, for each cell, the range of the curvature over the `among` cells within a reach.

    The result is (row, col), 1/mm; 0 in a cell with no `among` cell within the reach.
    """
    size = [2 * round(reach_mm / step) + 1 for step in relief.pitch_mm[::-1]]
    most = ndimage.maximum_filter(np.where(among, bend_per_mm, -np.inf), size)
    least = ndimage.minimum_filter(np.where(among, bend_per_mm, np.inf), size)
    near = np.isfinite(most)
    return np.asarray(np.subtract(most, least, out=np.zeros_like(bend_per_mm), where=near))


def finest_pressure(
    relief: Relief,
    layer: SheetLayer,
    shapes: "CoatShapes",
    stretched: StretchedCoat,
    balance: ContactBalance,
) -> FinestPressure:
    """Return the contact pressure after the narrowest usable filter.

    A filter is usable if the pressure's noise is below 1/4 of the least contact pressure. The noise
    is measured on the free span, because the contact pressure is zero there.
    """
    free, sigmas = free_span(relief, balance.contact), (*_FINE_SIGMAS_MM, CURVATURE_SIGMA_MM)
    for sigma_mm in sigmas if free.sum() >= _LEAST_FREE else sigmas[-1:]:
        shape = shapes.blurred(sigma_mm)
        pressure = _pressure(relief, layer, shape, stretched)
        off_kpa = (pressure - balance.pressure_kpa)[free]
        noise_kpa = spread(off_kpa) if len(off_kpa) >= _LEAST_FREE else 0.0
        if noise_kpa < balance.least_kpa / _SIGMAS_AT_FINE_SCALE:
            break
    return FinestPressure(pressure, shape, sigma_mm, float(np.hypot(noise_kpa, balance.sigma_kpa)))


def free_span(relief: Relief, contact: BoolArray) -> BoolArray:
    """Return the cells of the free span, (row, col) bool, without those near contact, rim or gaps.

    Near means within three standard deviations of the curvature's filter.
    """
    reach = int(np.ceil(3 * CURVATURE_SIGMA_MM / min(relief.pitch_mm)))
    away_from_contact = ndimage.binary_erosion(relief.measured & ~contact, iterations=reach)
    return np.asarray(away_from_contact & off_the_rim(relief))


def _pressure(
    relief: Relief, layer: SheetLayer, shape: CoatShape, stretched: StretchedCoat
) -> FloatArray:
    """Return the contact pressure p_air - N : b, kPa, (row, col); 0 outside the frame."""
    curvature = shape.between(layer.thickness_mm / 2 * stretched.thinning)[1]
    parts = stretched.tension_kpa_mm * curvature
    pulls = parts[..., 0] + 2 * parts[..., 1] + parts[..., 2]
    return np.where(relief.inside, layer.back_pressure_kpa - pulls, 0.0)


def _area(metric: FloatArray) -> FloatArray:
    """Return the ratio of a surface's area to its area projected on x and y, (row, col)."""
    return np.asarray(np.sqrt(metric[..., 0] * metric[..., 2] - metric[..., 1] ** 2))


def _up_to_half(
    contact: BoolArray, pressure_kpa: FloatArray, relief: Relief, blur_mm: float
) -> BoolArray:
    """Return the contact without border cells below 50 % of the highest pressure nearby.

    These cells come from the blur of the curvature's filter.
    """
    reach = 2 * int(np.ceil(2 * blur_mm / min(relief.pitch_mm))) + 1
    half = ndimage.maximum_filter(np.where(contact, pressure_kpa, 0.0), reach) / 2
    for _ in range(reach):
        edge = contact & ~ndimage.binary_erosion(contact)
        beyond_edge = edge & (pressure_kpa < half)
        if not beyond_edge.any():
            break
        contact = contact & ~beyond_edge
    return contact


def off_the_rim(relief: Relief) -> BoolArray:
    """Return the cells, (row, col) bool, in which the bend at the clamp does not affect curvature.

    They are farther from the rim than three standard deviations of the curvature's filter.
    """
    reach = int(np.ceil(3 * CURVATURE_SIGMA_MM / min(relief.pitch_mm)))
    inner = ndimage.binary_erosion(np.pad(relief.inside, 1), iterations=reach + 1)
    return np.asarray(inner[1:-1, 1:-1])


def _without_specks(contact: BoolArray, relief: Relief) -> BoolArray:
    """Return the contact without parts narrower than the filter, and with such holes closed.

    Parts and holes narrower than the curvature's filter are noise.
    """
    reach = max(1, round(CURVATURE_SIGMA_MM / min(relief.pitch_mm) / 2))
    opened = ndimage.binary_opening(contact, iterations=reach)
    return np.asarray(ndimage.binary_closing(opened, iterations=reach) & relief.measured)


def _sigma_of_pressure(relief: Relief, tension_kpa_mm: FloatArray) -> float:
    """Return the standard uncertainty of N : b, kPa, from noise and texture, at the median tension.

    For white noise of variance s^2 and correlation area A, filtered by a Gaussian of standard
    deviation g, one second derivative has the variance 3 s^2 A / (16 pi g^6). The sum of the
    second derivatives along x and y has 8 / 3 of that variance, at equal tension along both.
    """
    variance, area = relief.noise_area_mm2(CURVATURE_SIGMA_MM)
    both = float(np.sqrt(variance * area / (2 * np.pi * CURVATURE_SIGMA_MM**6)))
    mean = (tension_kpa_mm[..., 0] + tension_kpa_mm[..., 2]) / 2
    return both * float(np.median(mean[relief.inside]))
