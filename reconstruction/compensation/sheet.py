"""Compute the rigid object under a thin sheet from the measured coat only.

Lengths are in mm, pressures in kPa. In the world frame the coat is above the object. The
computation is on the coat's grid, with the points r and the unit normal n of the coat:

- The map of the sheet on its surface (`membrane`) gives the local thickness h lambda and the line
  tension N. h is the undeformed thickness, lambda the thinning. Both are computed for the surface
  midway between the faces, r - (h lambda / 2) n.
- Along the normal, tension, air pressure and contact pressure are in equilibrium:
  p_contact = p_air - N : b, where b is the curvature, positive in a valley. (To first order in
  h / R this is the pressure on the clear face: squeezing reduces the tension by the ratio of the
  faces' areas.) A cell is in contact if p_contact exceeds 50 % of the air pressure (`balance` has
  further conditions). On the free span p_contact is zero within its uncertainty.
- In contact the object's surface is parallel to the coat, at the local thickness below it:
  r - h lambda n.

This is the model of a frictionless sheet. A sheet that sticks does not slide after first contact.
Its stretch at first contact is between zero and that of a frictionless sheet. Its lambda is
therefore the middle of that range, with a uniform distribution over the range. Tension and force
are those of a frictionless sheet.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.compensation.balance import (
    CURVATURE_SIGMA_MM,
    NORMAL_SIGMA_MM,
    CoatShape,
    CoatShapes,
    ContactBalance,
    Footing,
    StretchedCoat,
    balanced,
    finest_pressure,
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
# Passes of the computation: each uses the thinning and the contact pressure of the previous one.
_TURNS = 3
SHEET_THEORY = 0.07
"""Ratio of the thin-sheet model's error of a height, mm, to h^2 / R, by comparison with solid
elements."""
# Factor and exponent of the RMS error of points where the curvature varies: the error over h is the
# factor times (h times the range of the curvature) to the power of the exponent. Then the relative
# standard uncertainties of the squeeze, and of the local thickness between edges on all sides. All
# are empirical, from balls, ellipsoids, rods and stairs under sheets of 0.1 to 0.3 mm.
_EDGE_THEORY, _EDGE_POWER = 0.25, 1.5
_SQUEEZE_THEORY, _ENCLOSED_THEORY = 0.07, 0.008
# Relative error of the force for sheets of up to 0.3 mm, by comparison with the one-dimensional
# solver: tests/compensation.
_FORCE_METHOD = 0.03
_FLAT = 1 / np.sqrt(12.0)
# Without air the standard uncertainty of its pressure is 0, too: no division by 0.
_LEAST_AIR_KPA = 1e-9


@dataclass(frozen=True, eq=False, repr=False)
class CompensatedSheet(PresentedObject):
    """Object and contact computed from the coat of a sheet; arrays on the relief's cells.

    Attributes
    ----------
    relief : the measured coat
    thinning : (row, col) ratio of local to undeformed thickness of the sheet
    sigma_thinning : (row, col) standard uncertainty of `thinning`
    normal : (row, col, xyz) unit normal of the coat, upwards
    balance : contact pressure and the cells in contact
    footing : contact at the finest scale, and the cells that are certainly in contact
    layer : values of sheet and load used in the computation
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
        """Cells in which the object is in contact with the sheet, (row, col) bool."""
        return self.balance.contact

    @property
    def sure(self) -> BoolArray:
        """Cells certainly in contact, (row, col) bool: the contact without its blurred edge."""
        return self.footing.sure

    @property
    def theory_sigma_mm(self) -> FloatArray:
        """Standard uncertainty, mm, of each object point along the normal by the model's errors.

        They are those next to an uneven curvature, of the squeeze, and of the local thickness of a
        face between edges on all sides.
        """
        layer, local_mm = self.layer, self.layer.thickness_mm * self.thinning
        bent = layer.thickness_mm * self.footing.uneven_per_mm
        of_bend = _EDGE_THEORY * layer.thickness_mm * bent**_EDGE_POWER
        of_face = np.where(self.footing.enclosed, _ENCLOSED_THEORY * local_mm, 0.0)
        errors = [of_bend, _SQUEEZE_THEORY * self.squeeze_mm, of_face]
        return np.asarray(np.linalg.norm(errors, axis=0))

    @property
    def pressure_kpa(self) -> FloatArray:
        """Pressure of the object on the clear face, (row, col)."""
        return self.balance.pressure_kpa

    @property
    def blur_mm(self) -> float:
        """Width, mm, by which the edge of the contact is blurred."""
        return CURVATURE_SIGMA_MM

    @property
    def area_mm2(self) -> float:
        """Area of the contact projected along z, mm^2."""
        return float(self.balance.upright_mm2[self.contact].sum())

    @property
    def layer_moves_mm(self) -> list[FloatArray]:
        """Shifts of the object's points along the normals, mm, by uncertain values of the layer.

        Each entry is (row, col), one standard uncertainty, in the same sense at all points of a
        part. The entries are for the sheet's thickness, its thinning, and its squeeze by the
        contact pressure, of which modulus and air pressure are uncertain. For a sheet that sticks,
        a further entry varies over a part: from the negative second entry at the edge to the
        positive one in the middle.
        """
        layer = self.layer
        of_stretch = layer.thickness_mm * self.sigma_thinning
        share = np.hypot(
            layer.sigma_young_modulus_kpa / layer.young_modulus_kpa,
            layer.sigma_back_pressure_kpa / max(layer.back_pressure_kpa, _LEAST_AIR_KPA),
        )
        of_squeeze = -share * self.squeeze_mm
        moves = [self.thinning * layer.sigma_thickness_mm, of_stretch, of_squeeze]
        if layer.sticks:
            inwards = np.asarray(ndimage.distance_transform_edt(self.contact))
            moves.append(of_stretch * (2 * inwards / max(float(inwards.max()), 1.0) - 1))
        return moves

    @property
    def layer_maps(self) -> LayerMaps:
        """Maps of the local thickness of the sheet, mm, and of its standard uncertainty, mm."""
        thickness, sigma = self.layer.thickness_mm * self.thinning, self.sigma_thickness_mm
        return {
            "thickness_mm": (thickness, "mm", "local thickness"),
            "sigma_thickness_mm": (sigma, "mm", "standard uncertainty of the local thickness"),
        }

    def theory_mm(self, radius_mm: float) -> float:
        """Return the thin-sheet model's standard uncertainty, mm, of a radius (docs/sheet.md)."""
        return SHEET_THEORY * self.layer.thickness_mm**2 / radius_mm

    @property
    def object_mm(self) -> FloatArray:
        """Points of the clear face, world (row, col, xyz), mm; in contact these are on the object.

        They are a local thickness below the coat, less `squeeze_mm`, by which the contact pressure
        compresses the sheet.
        """
        behind = self.layer.thickness_mm * self.thinning - self.squeeze_mm
        return np.asarray(self.relief.points_mm - behind[..., None] * self.normal)

    @property
    def squeeze_mm(self) -> FloatArray:
        """Indentation of the clear face by the contact pressure, mm, (row, col)."""
        per_made_kpa = self.footing.pressure_kpa / self.thinning
        return np.asarray(self.layer.squeeze_mm_per_kpa * per_made_kpa)

    @property
    def force_n(self) -> float:
        """Force of the object on the sheet along z, N.

        It is the integral of the contact pressure over the contact and its blurred edge.
        """
        balance = self.balance
        return float((balance.pressure_kpa * balance.upright_mm2)[self._grown()].sum() * 1e-3)

    def _grown(self) -> BoolArray:
        """Return the contact together with its blurred edge, (row, col) bool."""
        reach = int(np.ceil(2 * CURVATURE_SIGMA_MM / min(self.relief.pitch_mm)))
        grown = ndimage.binary_dilation(self.contact, iterations=reach)
        return np.asarray(grown & self.relief.inside)

    @property
    def force_sigma_n(self) -> float:
        """Standard uncertainty of the force, N: from modulus, thickness, air pressure and noise.

        The error of the method is included. The tension, and with it the share of the force that
        the tension carries, is proportional to E h, Young's modulus times thickness.
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
        """Return the modulus for which the computed force is a known one, and its uncertainty; kPa.

        The force minus the air pressure over the contact and its blurred edge is the share that the
        tension carries. This share is proportional to E h, Young's modulus times thickness.

        Parameters
        ----------
        force_n, sigma_n : known force along z, and its standard uncertainty

        Raises
        ------
        FitError : the share of the tension is not positive, or the sheet sticks, so that its
            tension is unknown
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
                1e-3 * pressed_mm2 * layer.sigma_back_pressure_kpa,
            )
        )
        of_thickness = layer.sigma_thickness_mm / layer.thickness_mm
        return modulus, modulus * float(np.hypot(of_force / known_tension_n, of_thickness))

    @property
    def sigma_thickness_mm(self) -> FloatArray:
        """Standard uncertainty of the local thickness, mm, (row, col)."""
        return np.hypot(
            self.thinning * self.layer.sigma_thickness_mm,
            self.layer.thickness_mm * self.sigma_thinning,
        )

    def free_span(self) -> BoolArray:
        """Return the cells of the free span, (row, col) bool, not near contact, rim or gaps."""
        return free_span(self.relief, self.contact)

    def modulus_of_free_span_kpa(self) -> tuple[float, float] | None:
        """Return the modulus for which the free span carries the air pressure, and its scatter.

        Both are in kPa. On the free span p_air = N : b, and N is proportional to E h. The modulus
        is from the median over the cells, the scatter is the robust standard deviation. None if the
        air pressure is 0, the free span has fewer than 50 cells, or the median is not positive.
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
    """Compute contact, contact pressure and object under a sheet from points of its coat.

    Parameters
    ----------
    points_mm : (n, xyz) measured points of the coat, world
    sigma_z_mm : (n,) standard uncertainty of the z coordinate of each point

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
    shapes = CoatShapes(relief)
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
        finest = finest_pressure(relief, layer, shapes, stretched, balance)
        carried_kpa = finest.in_contact_kpa(balance.contact)
    thinning, sigma_thinning = _with_sticking(
        layer, thinning, _open_of_rim(surface, relief, layer, spread_out)
    )
    return CompensatedSheet(
        relief=relief,
        thinning=thinning,
        sigma_thinning=sigma_thinning,
        normal=fine.normal,
        balance=balance,
        footing=footing_of(relief, layer, stretched, balance, finest),
        layer=layer,
    )


def _stretched(relief: Relief, layer: SheetLayer, spread_out: MaterialMap) -> StretchedCoat:
    """Return thinning and line tension of the sheet's map, interpolated at the relief's cells."""
    unit_kpa_mm = 1e3 * layer.tension_unit_n_mm
    tension = [_on_cells(spread_out.tension[..., part], relief) for part in range(3)]
    return StretchedCoat(
        _on_cells(spread_out.thinning, relief), unit_kpa_mm * np.stack(tension, axis=-1)
    )


def _open_of_rim(
    surface: SurfaceMetric, relief: Relief, layer: SheetLayer, spread_out: MaterialMap | None
) -> FloatArray:
    """Return the thinning's standard uncertainty, (row, col), from that of the rim's compliance.

    It is the change of the thinning for a compliance larger by one standard uncertainty.
    """
    if spread_out is None or not layer.sigma_rim_compliance_mm2_per_n:
        return np.zeros(relief.measured.shape)
    softer = on_springs(surface, relief, layer.frame, layer.rim_yield + layer.sigma_rim_yield)
    moved = material_map(softer, layer.pre_stretch, near=spread_out)
    return np.abs(_on_cells(moved.thinning - spread_out.thinning, relief))


def _with_sticking(
    layer: SheetLayer, thinning: FloatArray, of_rim: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return thinning and its standard uncertainty, (row, col): from pre-stretch, rim, sticking.

    Parameters
    ----------
    thinning : that of a frictionless sheet
    of_rim : standard uncertainty of the thinning from the rim's compliance
    """
    # Stretches multiply: the factor of the mounted sheet in the thinning is s^-2.
    mounted = layer.pre_stretch**-2
    of_pre_stretch = 2 * thinning / layer.pre_stretch * layer.sigma_pre_stretch
    of_stretch = np.hypot(of_pre_stretch, of_rim)
    if not layer.sticks:
        return thinning, of_stretch
    return (mounted + thinning) / 2, np.hypot(_FLAT * (mounted - thinning), of_stretch)


def _on_elements(relief: Relief, metric: FloatArray, squeeze: FloatArray) -> SurfaceMetric:
    """Return the metric of the membrane's elements, as averages over the relief's cells.

    Parameters
    ----------
    metric : (row, col, 3) components xx, xy, yy on the relief's cells
    squeeze : (row, col) ratio of contact pressure to shear modulus, on the same cells
    """
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
    """Interpolate values at the middles of the membrane's elements to the relief's cells."""
    rows, cols = relief.measured.shape
    at = [(np.arange(count) + 0.5) / _CELLS_PER_ELEMENT - 0.5 for count in (rows, cols)]
    grid = np.meshgrid(*at, indexing="ij")
    return np.asarray(ndimage.map_coordinates(values, grid, order=1, mode="nearest"))
