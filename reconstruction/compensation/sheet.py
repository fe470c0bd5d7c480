"""The rigid object under a thin sheet, from the measured coat alone; lengths mm, pressures kPa.

World frame, the coat above the object. On the coat's own grid, with its unit normal n:

- the sheet is spread on its surface (`membrane`), which tells the local thickness h lambda and the
  tension N, both of the surface midway between the faces: z - (h lambda / 2) n;
- along the normal tension, air and contact balance: p_contact = p_air - N : b, b the curvature,
  positive in a valley. (To first order in h / R this is the pressure on the clear face: by as much
  as that is smaller, squeezing takes off the tension.) Where it is more than half of the air's the
  object carries the sheet; where the sheet hangs free it is zero, to within its uncertainty;
- there the object's surface is the parallel one a local thickness below: r - h lambda n.

Frictionless. A sheet that sticks keeps its place where it first touched; how much it had stretched
by then is between nothing and what a free one does. Its lambda is taken in the middle between them,
all of that range as likely; tension and force are those of a free one.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.compensation.membrane import MaterialMap, SurfaceMetric, material_map
from reconstruction.compensation.relief import Relief, SheetOpening, relief_on_frame
from reconstruction.compensation.rim import on_springs
from reconstruction.errors import FitError

# Of the membrane: the stretch is smooth, a cell of the relief is a third of one of its elements.
_ELEMENT_MM = 0.3
_CELLS_PER_ELEMENT = 3
_MOST_ELEMENTS = 12_000
# Once for all, once with the surface between the faces and the squeeze, once with those anew.
_TURNS = 3
NORMAL_SIGMA_MM = 0.1
"""Gaussian filter of the heights whose slopes give normals and metric."""
CURVATURE_SIGMA_MM = 0.3
"""Gaussian filter of the heights whose curvature tells contact from free span."""
SHEET_THEORY = 0.07
"""Error of heights of a thin sheet over h^2 / R, against solid elements."""
_SIGMAS_OF_CONTACT = 2.0
# Force of sheets to 0.3 mm against the one-dimensional solver: tests/compensation.
_FORCE_METHOD = 0.03
_FLAT = 1 / np.sqrt(12.0)


@dataclass(frozen=True)
class SheetLayer:
    """What is known of the mounted sheet and its load; sigma_: standard uncertainties.

    Attributes
    ----------
    frame : opening in which it is held
    thickness_mm : as it was made, before it was stretched into its frame
    young_modulus_kpa : of the incompressible silicone
    pre_stretch : of the mounted sheet, equal along x and y
    rim_compliance_mm2_per_n : by how much its edge gives along the frame per line tension beyond
        that of the mounted sheet; 0: rigid
    back_pressure_kpa : of the air on the coat
    sticks : whether it keeps its place once it has touched
    """

    frame: SheetOpening
    thickness_mm: float
    young_modulus_kpa: float
    pre_stretch: float = 1.0
    rim_compliance_mm2_per_n: float = 0.0
    back_pressure_kpa: float = 0.0
    sticks: bool = False
    sigma_thickness_mm: float = 0.0
    sigma_young_modulus_kpa: float = 0.0
    sigma_pre_stretch: float = 0.0
    sigma_rim_compliance_mm2_per_n: float = 0.0
    sigma_back_pressure_kpa: float = 0.0

    @property
    def tension_unit_n_mm(self) -> float:
        """Shear modulus times thickness, N/mm."""
        return self.young_modulus_kpa / 3e3 * self.thickness_mm

    @property
    def rim_yield(self) -> float:
        """Compliance of the rim times shear modulus times thickness, mm."""
        return self.rim_compliance_mm2_per_n * self.tension_unit_n_mm

    @property
    def sigma_rim_yield(self) -> float:
        """Standard uncertainty of `rim_yield` by the compliance, mm."""
        return self.sigma_rim_compliance_mm2_per_n * self.tension_unit_n_mm


@dataclass(frozen=True, eq=False)
class ContactBalance:
    """Contact and its pressure; arrays (row, col) on the relief's cells.

    Attributes
    ----------
    pressure_kpa : of the object on the clear face
    sigma_kpa : its standard uncertainty, from noise and texture of the coat
    contact : bool
    upright_mm2 : area of the clear face in each cell, projected along z
    """

    pressure_kpa: FloatArray
    sigma_kpa: float
    contact: BoolArray
    upright_mm2: FloatArray


@dataclass(frozen=True, eq=False)
class CompensatedSheet:
    """The object and the contact; all (row, col) on the relief's cells.

    Attributes
    ----------
    relief : the measured coat
    thinning : local thickness over that of the sheet as it was made
    sigma_thinning : its standard uncertainty
    normal : (row, col, xyz) unit normal of the coat, upwards
    layer : what it was compensated with
    """

    relief: Relief
    thinning: FloatArray
    sigma_thinning: FloatArray
    normal: FloatArray
    balance: ContactBalance
    layer: SheetLayer

    @property
    def contact(self) -> BoolArray:
        """Where the object carries the sheet, (row, col)."""
        return self.balance.contact

    @property
    def pressure_kpa(self) -> FloatArray:
        """Pressure of the object on the clear face, (row, col)."""
        return self.balance.pressure_kpa

    @property
    def blur_mm(self) -> float:
        """How far the contact's edge is blurred."""
        return CURVATURE_SIGMA_MM

    @property
    def area_mm2(self) -> float:
        """Area of the contact seen along z."""
        return float(self.balance.upright_mm2[self.contact].sum())

    @property
    def layer_moves_mm(self) -> list[FloatArray]:
        """Return by how much all points of a part may lie off along their normals, each (row, col).

        How a sheet that sticks thins from a part's middle to its edge is open, too: by as much.
        """
        layer = self.layer
        of_stretch = layer.thickness_mm * self.sigma_thinning
        moves = [self.thinning * layer.sigma_thickness_mm, of_stretch]
        if layer.sticks:
            inwards = np.asarray(ndimage.distance_transform_edt(self.contact))
            moves.append(of_stretch * (2 * inwards / max(float(inwards.max()), 1.0) - 1))
        return moves

    def theory_mm(self, radius_mm: float) -> float:
        """Return what the theory of thin sheets leaves out of a radius: docs/sheet.md."""
        return SHEET_THEORY * self.layer.thickness_mm**2 / radius_mm

    @property
    def object_mm(self) -> FloatArray:
        """Points of the clear face, (row, col, xyz); the object's where there is contact."""
        behind = self.layer.thickness_mm * self.thinning
        return np.asarray(self.relief.points_mm - behind[..., None] * self.normal)

    @property
    def force_n(self) -> float:
        """Force of the object along z: contact pressure over the contact and its blurred edge."""
        balance = self.balance
        return float((balance.pressure_kpa * balance.upright_mm2)[self._grown()].sum() * 1e-3)

    def _grown(self) -> BoolArray:
        """Return the contact with its blurred edge, (row, col)."""
        reach = int(np.ceil(2 * CURVATURE_SIGMA_MM / min(self.relief.pitch_mm)))
        grown = ndimage.binary_dilation(self.contact, iterations=reach)
        return np.asarray(grown & self.relief.inside)

    @property
    def force_sigma_n(self) -> float:
        """Standard uncertainty of the force: modulus, thickness and air, noise, and the method.

        Tension is in proportion to E h, and so is its share of the force.
        """
        layer, balance = self.layer, self.balance
        area_mm2 = self.area_mm2
        of_air = 1e-3 * area_mm2
        of_tension = self.force_n - of_air * layer.back_pressure_kpa
        share = np.hypot(
            layer.sigma_young_modulus_kpa / layer.young_modulus_kpa,
            layer.sigma_thickness_mm / layer.thickness_mm,
        )
        # Noise is common to some 4 pi s^2 of surface.
        together = 4 * np.pi * CURVATURE_SIGMA_MM**2
        noise = 1e-3 * balance.sigma_kpa * np.sqrt(area_mm2 * min(together, area_mm2))
        shares = (
            of_tension * share,
            of_air * layer.sigma_back_pressure_kpa,
            noise,
            _FORCE_METHOD * self.force_n,
        )
        return float(np.linalg.norm(shares))

    def modulus_of_force_kpa(self, force_n: float, sigma_n: float = 0.0) -> tuple[float, float]:
        """Return the modulus with which the object carries a known force, and its uncertainty.

        What the air does not press, over the contact and its blurred edge, is the tension's share,
        in proportion to E h.

        Raises
        ------
        FitError : the air alone presses as hard, or a sheet that sticks, whose tension is not known
        """
        layer = self.layer
        pressed_mm2 = float(self.balance.upright_mm2[self._grown()].sum())
        of_air = 1e-3 * pressed_mm2 * layer.back_pressure_kpa
        found, known = self.force_n - of_air, force_n - of_air
        if layer.sticks or min(found, known) <= 0:
            raise FitError("modulus: the tension's share of the force is not known")
        modulus = layer.young_modulus_kpa * known / found
        of_force = np.linalg.norm(
            (
                sigma_n,
                _FORCE_METHOD * force_n,
                of_air * layer.sigma_back_pressure_kpa / max(layer.back_pressure_kpa, 1e-9),
            )
        )
        of_thickness = layer.sigma_thickness_mm / layer.thickness_mm
        return modulus, modulus * float(np.hypot(of_force / known, of_thickness))

    @property
    def sigma_thickness_mm(self) -> FloatArray:
        """Standard uncertainty of the local thickness, (row, col)."""
        return np.hypot(
            self.thinning * self.layer.sigma_thickness_mm,
            self.layer.thickness_mm * self.sigma_thinning,
        )

    def free_span(self) -> BoolArray:
        """Return the cells that hang free, away from contact, rim and gaps."""
        reach = int(np.ceil(3 * CURVATURE_SIGMA_MM / min(self.relief.pitch_mm)))
        apart = ndimage.binary_erosion(self.relief.measured & ~self.contact, iterations=reach)
        return np.asarray(apart & off_the_rim(self.relief))

    def modulus_of_free_span_kpa(self) -> tuple[float, float] | None:
        """Return the modulus with which the free span carries the air, and its scatter.

        p_air = N : b there, N in proportion to E h. None without air, or where nothing hangs free.
        """
        free, air = self.free_span(), self.layer.back_pressure_kpa
        if air <= 0 or free.sum() < 50:
            return None
        carried = (air - self.balance.pressure_kpa[free]) / self.layer.young_modulus_kpa
        middle = float(np.median(carried))
        if middle <= 0:
            return None
        scatter = 1.4826 * float(np.median(np.abs(carried - middle)))
        return air / middle, air / middle * scatter / middle


def compensate_sheet(
    points_mm: FloatArray, sigma_z_mm: FloatArray, layer: SheetLayer
) -> CompensatedSheet:
    """Find contact, pressure and object under a sheet.

    Parameters
    ----------
    points_mm : (n, xyz) measured points of the coat, world
    sigma_z_mm : (n,)

    Raises
    ------
    FitError : too little was measured, or the sheet finds no rest on what was
    """
    frame = layer.frame
    element = max(
        _ELEMENT_MM, float(np.sqrt(frame.length_x_mm * frame.length_y_mm / _MOST_ELEMENTS))
    )
    elements = tuple(round(length / element) for length in (frame.length_x_mm, frame.length_y_mm))
    cells = (elements[0] * _CELLS_PER_ELEMENT, elements[1] * _CELLS_PER_ELEMENT)
    relief = relief_on_frame(points_mm, sigma_z_mm, frame, cells)
    fine, wide = (_Shape.of(relief, sigma) for sigma in (NORMAL_SIGMA_MM, CURVATURE_SIGMA_MM))
    thinning = np.full(relief.measured.shape, layer.pre_stretch**-2)
    carried_kpa = np.zeros_like(thinning)
    spread_out: MaterialMap | None = None
    for _ in range(_TURNS):
        metric = fine.between(layer.thickness_mm / 2 * thinning)[0]
        squeeze = 3 * carried_kpa / layer.young_modulus_kpa
        surface = on_springs(_on_elements(relief, metric, squeeze), relief, frame, layer.rim_yield)
        spread_out = material_map(surface, layer.pre_stretch, near=spread_out)
        thinning = _on_cells(spread_out.thinning, relief)
        balance = _balanced(relief, layer, wide, spread_out)
        carried_kpa = np.where(balance.contact, balance.pressure_kpa, 0.0)
    thinning, sigma_thinning = _with_sticking(
        layer, thinning, _open_of_rim(surface, relief, layer, spread_out)
    )
    return CompensatedSheet(
        relief=relief,
        thinning=thinning,
        sigma_thinning=sigma_thinning,
        normal=fine.normal,
        balance=balance,
        layer=layer,
    )


@dataclass(frozen=True, eq=False)
class _Shape:
    """First and second fundamental forms of the coat, (row, col, 3): xx, xy, yy."""

    metric: FloatArray
    curvature: FloatArray
    normal: FloatArray

    @classmethod
    def of(cls, relief: Relief, sigma_mm: float) -> "_Shape":
        # Even about the rim, as the filter takes it: the clamp's bend lies within the first cells.
        z = np.pad(relief.smoothed(sigma_mm), 2, mode="symmetric")
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

    def between(self, below_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return metric and curvature of the surface so far below, over the coat's x and y.

        r - t n has dr + t (G^-1 b) dr: G + 2 t b + t^2 b G^-1 b, and b + t b G^-1 b.
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


def _balanced(
    relief: Relief, layer: SheetLayer, shape: _Shape, spread_out: MaterialMap
) -> ContactBalance:
    """Weigh tension against air, and tell contact from free span."""
    tension = np.stack(
        [_on_cells(spread_out.tension[..., part], relief) for part in range(3)], axis=-1
    )
    below = layer.thickness_mm / 2 * _on_cells(spread_out.thinning, relief)
    curvature = shape.between(below)[1]
    unit_kpa_mm = 1e3 * layer.tension_unit_n_mm
    parts = tension * curvature
    pulls = unit_kpa_mm * (parts[..., 0] + 2 * parts[..., 1] + parts[..., 2])
    pressure = np.where(relief.inside, layer.back_pressure_kpa - pulls, 0.0)
    sigma = _sigma_of_pressure(relief, unit_kpa_mm * tension)
    least = max(layer.back_pressure_kpa / 2, _SIGMAS_OF_CONTACT * sigma)
    if layer.back_pressure_kpa == 0.0:
        least = max(least, 0.25 * float(np.percentile(pressure[relief.measured], 99)))
    carried = (pressure > least) & relief.measured & off_the_rim(relief)
    upright_mm2 = _area(shape.between(2 * below)[0]) * shape.normal[..., 2] * relief.cell_area_mm2
    contact = _up_to_half(_without_specks(carried, relief), pressure, relief)
    return ContactBalance(pressure, sigma, contact, upright_mm2)


def _area(metric: FloatArray) -> FloatArray:
    """Return the area of a surface over that of x and y."""
    return np.asarray(np.sqrt(metric[..., 0] * metric[..., 2] - metric[..., 1] ** 2))


def _up_to_half(contact: BoolArray, pressure_kpa: FloatArray, relief: Relief) -> BoolArray:
    """Take off the edge that the filter has blurred outwards: where it is half of what is near."""
    reach = 2 * int(np.ceil(2 * CURVATURE_SIGMA_MM / min(relief.pitch_mm))) + 1
    half = ndimage.maximum_filter(np.where(contact, pressure_kpa, 0.0), reach) / 2
    for _ in range(reach):
        edge = contact & ~ndimage.binary_erosion(contact)
        off = edge & (pressure_kpa < half)
        if not off.any():
            break
        contact = contact & ~off
    return contact


def off_the_rim(relief: Relief) -> BoolArray:
    """Return the cells so far from the rim that the clamp's bend is not in their curvature."""
    reach = int(np.ceil(3 * CURVATURE_SIGMA_MM / min(relief.pitch_mm)))
    inner = ndimage.binary_erosion(np.pad(relief.inside, 1), iterations=reach + 1)
    return np.asarray(inner[1:-1, 1:-1])


def _without_specks(contact: BoolArray, relief: Relief) -> BoolArray:
    """Drop parts narrower than the filter, which its noise makes; close holes of that size."""
    reach = max(1, round(CURVATURE_SIGMA_MM / min(relief.pitch_mm) / 2))
    opened = ndimage.binary_opening(contact, iterations=reach)
    return np.asarray(ndimage.binary_closing(opened, iterations=reach) & relief.measured)


def _sigma_of_pressure(relief: Relief, tension_kpa_mm: FloatArray) -> float:
    """Return the median standard uncertainty of N : b from noise and texture.

    The second derivative of white noise of variance s^2 and correlation area A after a Gaussian of
    sigma g has the variance 3 s^2 A / (16 pi g^6), both of them together, for equal tensions,
    8 / 3 of that.
    """
    variance, area = relief.noise_area_mm2(CURVATURE_SIGMA_MM)
    both = float(np.sqrt(variance * area / (2 * np.pi * CURVATURE_SIGMA_MM**6)))
    mean = (tension_kpa_mm[..., 0] + tension_kpa_mm[..., 2]) / 2
    return both * float(np.median(mean[relief.inside]))


def _open_of_rim(
    surface: SurfaceMetric, relief: Relief, layer: SheetLayer, found: MaterialMap | None
) -> FloatArray:
    """Return the standard uncertainty of the thinning by the rim's compliance, (row, col)."""
    if found is None or not layer.sigma_rim_compliance_mm2_per_n:
        return np.zeros(relief.measured.shape)
    softer = on_springs(surface, relief, layer.frame, layer.rim_yield + layer.sigma_rim_yield)
    moved = material_map(softer, layer.pre_stretch, near=found)
    return np.abs(_on_cells(moved.thinning - found.thinning, relief))


def _with_sticking(
    layer: SheetLayer, thinning: FloatArray, of_rim: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return thinning and what pre-stretch, rim and sticking leave open of it."""
    # Stretch multiplies: the mounted sheet's share of the thinning is s^-2.
    mounted = layer.pre_stretch**-2
    of_pre_stretch = 2 * thinning / layer.pre_stretch * layer.sigma_pre_stretch
    of_stretch = np.hypot(of_pre_stretch, of_rim)
    if not layer.sticks:
        return thinning, of_stretch
    return (mounted + thinning) / 2, np.hypot(_FLAT * (mounted - thinning), of_stretch)


def _on_elements(relief: Relief, metric: FloatArray, squeeze: FloatArray) -> SurfaceMetric:
    """Average the metric over the elements of the membrane."""
    rows, cols = (count // _CELLS_PER_ELEMENT for count in relief.measured.shape)

    def mean(values: FloatArray) -> FloatArray:
        cells = values.reshape(rows, _CELLS_PER_ELEMENT, cols, _CELLS_PER_ELEMENT)
        return np.asarray(cells.mean(axis=(1, 3)))

    inside = mean(relief.inside.astype(np.float64)) > 0.5
    held = np.ones((rows + 1, cols + 1), bool)
    held[1:-1, 1:-1] = ~(inside[:-1, :-1] & inside[1:, :-1] & inside[:-1, 1:] & inside[1:, 1:])
    ends = [
        (axis[0] - step / 2, axis[-1] + step / 2, count + 1)
        for axis, step, count in zip(
            (relief.x_mm, relief.y_mm), relief.pitch_mm, (cols, rows), strict=True
        )
    ]
    x, y = (np.linspace(*one) for one in ends)
    xx, xy, yy = (mean(metric[..., part]) for part in range(3))
    return SurfaceMetric(x, y, xx, xy, yy, mean(squeeze), held)


def _on_cells(values: FloatArray, relief: Relief) -> FloatArray:
    """Interpolate values of the elements' middles at the cells' middles."""
    rows, cols = relief.measured.shape
    at = [(np.arange(count) + 0.5) / _CELLS_PER_ELEMENT - 0.5 for count in (rows, cols)]
    grid = np.meshgrid(*at, indexing="ij")
    return np.asarray(ndimage.map_coordinates(values, grid, order=1, mode="nearest"))
