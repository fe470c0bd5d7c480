"""The rigid object under a thin sheet, from the measured coat only; lengths mm, pressures kPa.

World frame, the coat above the object. On the coat's grid, with its unit normal n:

- the map of the sheet on its surface (`membrane`) gives the local thickness h lambda and the
  tension N, both for the surface midway between the faces: z - (h lambda / 2) n;
- along the normal, tension, air and contact balance: p_contact = p_air - N : b, b the curvature,
  positive in a valley. (To first order in h / R this is the pressure on the clear face: squeezing
  reduces the tension by the ratio of the faces' areas.) A cell is in contact if p_contact exceeds
  50 % of the air pressure; on the free span it is zero within its uncertainty;
- in contact the object's surface is the parallel one a local thickness below: r - h lambda n.

Frictionless. A sheet that sticks keeps its place where it first touched. Its stretch at that moment
is between zero and that of a frictionless sheet. Its lambda is therefore the middle of that range,
with a uniform distribution over it; tension and force are those of a frictionless sheet.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.compensation.balance import (
    CURVATURE_SIGMA_MM,
    NORMAL_SIGMA_MM,
    CoatShape,
    ContactBalance,
    Footing,
    StretchedCoat,
    balanced,
    footing_of,
    free_span,
)
from reconstruction.compensation.membrane import MaterialMap, SurfaceMetric, material_map
from reconstruction.compensation.presentation import LayerMaps, PresentedObject
from reconstruction.compensation.relief import Relief, relief_on_frame
from reconstruction.compensation.rim import on_springs
from reconstruction.compensation.sheet_layer import SheetLayer
from reconstruction.errors import FitError

# Size of the membrane's elements: the stretch is smooth, so an element spans three relief cells.
_ELEMENT_MM = 0.3
_CELLS_PER_ELEMENT = 3
_MOST_ELEMENTS = 12_000
# First pass on the coat; second on the surface midway between the faces with squeeze; third with
# updated thinning and squeeze.
_TURNS = 3
SHEET_THEORY = 0.07
"""Error of a thin sheet's heights over h^2 / R, compared with solid elements."""
EDGE_THEORY, _EDGE_POWER = 0.25, 1.5
"""RMS error of points near edges over h, as a power of h times the range of curvature. Empirical,
from balls, ellipsoids, rods, nut, stud and stairs under sheets of 0.15 and 0.25 mm
(docs/compensation.md)."""
# Relative error of the force for sheets to 0.3 mm, from the one-dimensional solver:
# tests/compensation.
_FORCE_METHOD = 0.03
_FLAT = 1 / np.sqrt(12.0)


@dataclass(frozen=True, eq=False, repr=False)
class CompensatedSheet(PresentedObject):
    """The object and the contact; all (row, col) on the relief's cells.

    Attributes
    ----------
    relief : the measured coat
    thinning : local thickness over that of the undeformed sheet
    sigma_thinning : its standard uncertainty
    normal : (row, col, xyz) unit normal of the coat, upwards
    footing : cells in certain contact
    layer : sheet and load used in the compensation
    """

    relief: Relief
    thinning: FloatArray
    sigma_thinning: FloatArray
    normal: FloatArray
    balance: ContactBalance
    footing: Footing
    layer: SheetLayer

    @property
    def contact(self) -> BoolArray:
        """Cells in which the object carries the sheet, (row, col)."""
        return self.balance.contact

    @property
    def sure(self) -> BoolArray:
        """Cells in contact with certainty, without blurred ones, (row, col)."""
        return self.footing.sure

    @property
    def edge_sigma_mm(self) -> FloatArray:
        """Standard uncertainty of each point along the normal because of near edges, (row, col).

        Near an edge neither the thin-sheet model nor the parallel surface is exact.
        """
        bent = self.layer.thickness_mm * self.footing.uneven_per_mm
        return np.asarray(EDGE_THEORY * self.layer.thickness_mm * bent**_EDGE_POWER)

    @property
    def pressure_kpa(self) -> FloatArray:
        """Pressure of the object on the clear face, (row, col)."""
        return self.balance.pressure_kpa

    @property
    def blur_mm(self) -> float:
        """Width by which the contact's edge is blurred."""
        return CURVATURE_SIGMA_MM

    @property
    def area_mm2(self) -> float:
        """Area of the contact projected along z."""
        return float(self.balance.upright_mm2[self.contact].sum())

    @property
    def layer_moves_mm(self) -> list[FloatArray]:
        """Return possible common shifts of a part's points along their normals, each (row, col).

        For a sheet that sticks, its thinning may also vary from a part's middle to its edge by as
        much.
        """
        layer = self.layer
        of_stretch = layer.thickness_mm * self.sigma_thinning
        moves = [self.thinning * layer.sigma_thickness_mm, of_stretch]
        if layer.sticks:
            inwards = np.asarray(ndimage.distance_transform_edt(self.contact))
            moves.append(of_stretch * (2 * inwards / max(float(inwards.max()), 1.0) - 1))
        return moves

    @property
    def layer_maps(self) -> LayerMaps:
        """Local thickness of the sheet, mm, and its standard uncertainty."""
        thickness, sigma = self.layer.thickness_mm * self.thinning, self.sigma_thickness_mm
        return {
            "thickness_mm": (thickness, "mm", "local thickness"),
            "sigma_thickness_mm": (sigma, "mm", "standard uncertainty of the local thickness"),
        }

    def theory_mm(self, radius_mm: float) -> float:
        """Return the thin-sheet model's error of a radius: docs/sheet.md."""
        return SHEET_THEORY * self.layer.thickness_mm**2 / radius_mm

    @property
    def object_mm(self) -> FloatArray:
        """Points of the clear face, (row, col, xyz); of the object in contact.

        The contact pressure compresses the sheet, so that the object is higher by `squeeze_mm`.
        """
        behind = self.layer.thickness_mm * self.thinning - self.squeeze_mm
        return np.asarray(self.relief.points_mm - behind[..., None] * self.normal)

    @property
    def squeeze_mm(self) -> FloatArray:
        """Indentation of the clear face by the contact pressure, (row, col)."""
        per_made_kpa = np.where(self.contact, self.pressure_kpa, 0.0) / self.thinning
        return np.asarray(self.layer.squeeze_mm_per_kpa * per_made_kpa)

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
        """Standard uncertainty of the force: modulus, thickness, air, noise, and the method.

        Tension, and its share of the force, is proportional to E h.
        """
        layer, balance = self.layer, self.balance
        area_mm2 = self.area_mm2
        of_air = 1e-3 * area_mm2
        of_tension = self.force_n - of_air * layer.back_pressure_kpa
        share = np.hypot(
            layer.sigma_young_modulus_kpa / layer.young_modulus_kpa,
            layer.sigma_thickness_mm / layer.thickness_mm,
        )
        # Noise is correlated over an area of about 4 pi s^2.
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
        """Return the modulus at which the object carries a known force, and its uncertainty.

        The force less the air pressure over the contact and its blurred edge is the tension's
        share, which is proportional to E h.

        Raises
        ------
        FitError : the tension's share is not positive, or the sheet sticks, so that its tension is
            unknown
        """
        layer = self.layer
        pressed_mm2 = float(self.balance.upright_mm2[self._grown()].sum())
        of_air = 1e-3 * pressed_mm2 * layer.back_pressure_kpa
        tension_n, known_tension_n = self.force_n - of_air, force_n - of_air
        if layer.sticks or min(tension_n, known_tension_n) <= 0:
            raise FitError("modulus: the tension's share of the force is not known")
        modulus = layer.young_modulus_kpa * known_tension_n / tension_n
        of_force = np.linalg.norm(
            (
                sigma_n,
                _FORCE_METHOD * force_n,
                of_air * layer.sigma_back_pressure_kpa / max(layer.back_pressure_kpa, 1e-9),
            )
        )
        of_thickness = layer.sigma_thickness_mm / layer.thickness_mm
        return modulus, modulus * float(np.hypot(of_force / known_tension_n, of_thickness))

    @property
    def sigma_thickness_mm(self) -> FloatArray:
        """Standard uncertainty of the local thickness, (row, col)."""
        return np.hypot(
            self.thinning * self.layer.sigma_thickness_mm,
            self.layer.thickness_mm * self.sigma_thinning,
        )

    def free_span(self) -> BoolArray:
        """Return the cells of the free span, without those near contact, rim or gaps."""
        return free_span(self.relief, self.contact)

    def modulus_of_free_span_kpa(self) -> tuple[float, float] | None:
        """Return the modulus at which the free span carries the air pressure, and its scatter.

        There p_air = N : b, and N is proportional to E h. None without air or without a free span.
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
    """Compute contact, pressure and object under a sheet.

    Parameters
    ----------
    points_mm : (n, xyz) measured points of the coat, world
    sigma_z_mm : (n,)

    Raises
    ------
    FitError : too few points were measured, or the sheet has no equilibrium on the relief
    """
    frame = layer.frame
    element = max(
        _ELEMENT_MM, float(np.sqrt(frame.length_x_mm * frame.length_y_mm / _MOST_ELEMENTS))
    )
    elements = tuple(round(length / element) for length in (frame.length_x_mm, frame.length_y_mm))
    cells = (elements[0] * _CELLS_PER_ELEMENT, elements[1] * _CELLS_PER_ELEMENT)
    relief = relief_on_frame(points_mm, sigma_z_mm, frame, cells)
    fine, wide = (
        CoatShape.of(relief, relief.smoothed(sigma))
        for sigma in (NORMAL_SIGMA_MM, CURVATURE_SIGMA_MM)
    )
    thinning = np.full(relief.measured.shape, layer.pre_stretch**-2)
    carried_kpa = np.zeros_like(thinning)
    spread_out: MaterialMap | None = None
    for _ in range(_TURNS):
        metric = fine.between(layer.thickness_mm / 2 * thinning)[0]
        squeeze = 3 * carried_kpa / layer.young_modulus_kpa
        surface = on_springs(_on_elements(relief, metric, squeeze), relief, frame, layer.rim_yield)
        spread_out = material_map(surface, layer.pre_stretch, near=spread_out)
        stretched = _stretched(relief, layer, spread_out)
        thinning = stretched.thinning
        balance = balanced(relief, layer, wide, stretched)
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
        footing=footing_of(relief, layer, stretched, balance),
        layer=layer,
    )


def _stretched(relief: Relief, layer: SheetLayer, spread_out: MaterialMap) -> StretchedCoat:
    """Return thinning and tension of a map on the relief's cells."""
    unit_kpa_mm = 1e3 * layer.tension_unit_n_mm
    tension = [_on_cells(spread_out.tension[..., part], relief) for part in range(3)]
    return StretchedCoat(
        _on_cells(spread_out.thinning, relief), unit_kpa_mm * np.stack(tension, axis=-1)
    )


def _open_of_rim(
    surface: SurfaceMetric, relief: Relief, layer: SheetLayer, spread_out: MaterialMap | None
) -> FloatArray:
    """Return the thinning's standard uncertainty from the rim's compliance, (row, col)."""
    if spread_out is None or not layer.sigma_rim_compliance_mm2_per_n:
        return np.zeros(relief.measured.shape)
    softer = on_springs(surface, relief, layer.frame, layer.rim_yield + layer.sigma_rim_yield)
    moved = material_map(softer, layer.pre_stretch, near=spread_out)
    return np.abs(_on_cells(moved.thinning - spread_out.thinning, relief))


def _with_sticking(
    layer: SheetLayer, thinning: FloatArray, of_rim: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the thinning and its uncertainty from pre-stretch, rim and sticking."""
    # Stretches multiply: the mounted sheet's share of the thinning is s^-2.
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
    x, y = (np.linspace(*limits) for limits in ends)
    xx, xy, yy = (mean(metric[..., part]) for part in range(3))
    return SurfaceMetric(x, y, xx, xy, yy, mean(squeeze), held)


def _on_cells(values: FloatArray, relief: Relief) -> FloatArray:
    """Interpolate values of the elements' middles at the cells' middles."""
    rows, cols = relief.measured.shape
    at = [(np.arange(count) + 0.5) / _CELLS_PER_ELEMENT - 0.5 for count in (rows, cols)]
    grid = np.meshgrid(*at, indexing="ij")
    return np.asarray(ndimage.map_coordinates(values, grid, order=1, mode="nearest"))
