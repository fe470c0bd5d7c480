"""The object under the thin sheet of a measurement, cell by cell, and how well it is known.

Only the measured coat and the layer (`SensorLayer`) are used, no truth: contact, local thickness
and object are those of `reconstruction.compensation.compensate_sheet`. Fits of the object take the
cores of the contact's parts, without the edge that the filter of the curvature blurs.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, IntArray, at_pixels
from reconstruction.compensation import (
    CompensatedSheet,
    ObjectPart,
    SheetLayer,
    SheetOpening,
    compensate_sheet,
    parts_of,
)
from reconstruction.compensation.relief import variance_and_area
from reconstruction.errors import InputError
from reconstruction.evaluate.estimates import FittedDimension
from reconstruction.triangulation import PointMap
from twin.config.models import Experiment
from twin.config.sensor_layer import SensorLayer, sensor_layer_of
from twin.mechanics.choice import may_wrap
from twin.mechanics.hardness import young_modulus

# Air over modulus and thickness that wraps a sheet round objects of a few mm, at half of the limit
# beyond which a wrapped sheet thins without bound: docs/sheet.md.
_WRAPPING_STRAIN_PER_MM = 0.03
_MUCH_LESS = 0.7


@dataclass(frozen=True, eq=False)
class ObjectUnderSheet:
    """A compensated coat with the parts of its contact; cells are numbered row after row.

    Attributes
    ----------
    sheet : coat, local thickness, contact and object on the relief's cells
    parts : connected parts of the contact that are wide enough to be fitted
    """

    sheet: CompensatedSheet
    parts: tuple[ObjectPart, ...]

    @property
    def core(self) -> BoolArray:
        """Cells (row, col) of the object that fits may use."""
        cores = [part.core for part in self.parts]
        return np.logical_or.reduce(cores) if cores else np.zeros(self.sheet.contact.shape, bool)

    @property
    def blur_mm(self) -> float:
        """How far the contact's edge is blurred."""
        return self.sheet.blur_mm

    def touches(self, xy_mm: FloatArray) -> BoolArray:
        """Return whether the object carries the sheet at places (n, xy): in the nearest cell."""
        relief, contact = self.sheet.relief, self.sheet.contact
        col, row = (
            np.rint((xy_mm[:, axis] - cells[0]) / (cells[1] - cells[0])).astype(np.intp)
            for axis, cells in ((0, relief.x_mm), (1, relief.y_mm))
        )
        inside = (row >= 0) & (row < contact.shape[0]) & (col >= 0) & (col < contact.shape[1])
        touching = np.zeros(len(xy_mm), bool)
        touching[inside] = contact[row[inside], col[inside]]
        return touching

    def noise_mm(self, estimate: FittedDimension, cells: IntArray) -> float:
        """Return the standard uncertainty of a fit by noise and texture of the coat, mm.

        The residuals' own variance and correlation area are used for those of the points.

        Parameters
        ----------
        cells : (n,) number of each fitted point's cell
        """
        relief, shape = self.sheet.relief, self.sheet.contact.shape
        rest, used = np.zeros(shape), np.zeros(shape, bool)
        rest.flat[cells], used.flat[cells] = estimate.residuals_mm, estimate.used
        variance, area_mm2 = variance_and_area(rest, used, relief.cell_area_mm2)
        spread_mm = np.full(len(cells), np.sqrt(variance))
        return estimate.noise_mm(spread_mm, area_mm2 / relief.cell_area_mm2)

    def moved(self, points_mm: FloatArray, cells: IntArray) -> Iterator[FloatArray]:
        """Yield the points (n, xyz) moved by each standard uncertainty of the layer that is not 0.

        All points of a part move together, each along its normal.
        """
        normal = self.sheet.normal.reshape(-1, 3)[cells]
        for move in self.sheet.layer_moves_mm:
            away = move.flat[cells]
            if away.any():
                yield points_mm - away[:, None] * normal


@dataclass(frozen=True, eq=False)
class SheetCompensation:
    """Input of the compensation of a measured coat; the object is computed once, at first use.

    Attributes
    ----------
    layer : assumed elastomer and load; None: those of the experiment
    """

    experiment: Experiment
    points: PointMap
    layer: SensorLayer | None = None

    @property
    def compensated(self) -> ObjectUnderSheet | None:
        """The object; None if absent, `why` gives the reason."""
        return None if isinstance(self._outcome, str) else self._outcome

    @property
    def why(self) -> str:
        """Why no object was found; empty where one was."""
        return self._outcome if isinstance(self._outcome, str) else ""

    @cached_property
    def _outcome(self) -> ObjectUnderSheet | str:
        try:
            sheet = compensated_sheet(self.points, self.layer or sensor_layer_of(self.experiment))
        except InputError as error:
            return str(error)
        return ObjectUnderSheet(sheet, tuple(parts_of(sheet)))


def sheet_compensation(
    experiment: Experiment, points: PointMap, layer: SensorLayer | None = None
) -> SheetCompensation | None:
    """Return the input of the compensation for a thin sheet that was measured by fringes.

    None if the method has no press or no fringes, or if the elastomer is no thin sheet.
    """
    method = experiment.method
    if not (method.fringes and method.presses and may_wrap(experiment.elastomer)):
        return None
    return SheetCompensation(experiment, points, layer)


def more_contact(under: ObjectUnderSheet | None) -> str:
    """Return advice on how a thin sheet touches more of an object."""
    if under is None:
        return "press deeper"
    layer = under.sheet.layer
    air_kpa = _WRAPPING_STRAIN_PER_MM * layer.young_modulus_kpa * layer.thickness_mm
    deeper, sticking = "press deeper", "let it stick (elastomer.tack_j_m2)"
    ways = [deeper] if layer.sticks else [deeper, sticking]
    if layer.back_pressure_kpa < _MUCH_LESS * air_kpa:
        ways.insert(0, f"wrap the sheet by air (press.back_pressure_kpa = {air_kpa:.2g})")
    return " or ".join(filter(None, (", ".join(ways[:-1]), ways[-1])))


def compensated_sheet(points: PointMap, layer: SensorLayer) -> CompensatedSheet:
    """Return the object under a thin sheet from the measured points of its coat.

    Raises
    ------
    InputError : no valid point, or points that show no object
    """
    valid = points.valid
    if not valid.any():
        raise InputError("compensate: found no valid point; look at the mask's reasons")
    points_mm = at_pixels(points.points_world_mm, valid).astype(np.float64)
    sigma_mm = at_pixels(points.sigma_z_mm, valid).astype(np.float64)
    return compensate_sheet(points_mm, sigma_mm, sheet_layer(layer))


def sheet_layer(layer: SensorLayer) -> SheetLayer:
    """Return the layer as the thin sheet's equations take it."""
    elastomer, sigma = layer.elastomer, layer.sigma
    modulus = young_modulus(elastomer)
    return SheetLayer(
        frame=SheetOpening(
            elastomer.length_x_mm, elastomer.length_y_mm, elastomer.outline == "round"
        ),
        thickness_mm=elastomer.thickness_mm,
        young_modulus_kpa=modulus.best_kpa,
        pre_stretch=elastomer.pre_stretch,
        rim_compliance_mm2_per_n=elastomer.rim_compliance_mm2_per_n,
        back_pressure_kpa=layer.press.back_pressure_kpa,
        sticks=elastomer.sticks,
        sigma_thickness_mm=sigma.thickness_mm,
        sigma_young_modulus_kpa=sigma_of_modulus(layer),
        sigma_pre_stretch=sigma.pre_stretch,
        sigma_rim_compliance_mm2_per_n=sigma.rim_compliance_mm2_per_n,
        sigma_back_pressure_kpa=sigma.back_pressure_kpa,
    )


def sigma_of_modulus(layer: SensorLayer) -> float:
    """Return the modulus' standard uncertainty: given, or that of all its range as likely."""
    if layer.sigma.young_modulus_kpa is not None:
        return layer.sigma.young_modulus_kpa
    modulus = young_modulus(layer.elastomer)
    return float((modulus.high_kpa - modulus.low_kpa) / np.sqrt(12.0))
