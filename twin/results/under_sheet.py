"""The object under a thin sheet, reconstructed from a measured coat, and its uncertainty.

Only the measured coat and the assumed layer (`SensorLayer`) are used, not the truth. Contact,
local thickness and object are computed by `reconstruction.compensation.compensate_sheet`. Fits of
the object use only the cores of the parts of the contact, without the edges, which the filter of
the curvature blurs.
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
from reconstruction.compensation.scatter import FitNoise, noise_of_fit
from reconstruction.errors import InputError
from reconstruction.evaluate.estimates import FittedDimension
from reconstruction.triangulation import PointMap
from twin.config.models import Experiment
from twin.config.sensor_layer import SensorLayer, sensor_layer_of
from twin.mechanics.choice import may_wrap
from twin.mechanics.hardness import young_modulus

# Air pressure / (modulus x thickness) that wraps a sheet round objects of a few mm. It is 50 % of
# the limit beyond which a wrapped sheet thins without bound, see docs/sheet.md.
_WRAPPING_STRAIN_PER_MM = 0.03
_MUCH_LESS = 0.7


@dataclass(frozen=True, eq=False)
class ObjectUnderSheet:
    """The reconstructed object under a sheet, with the parts of its contact.

    Cells of the relief are numbered row by row.

    Attributes
    ----------
    sheet : coat, local thickness, contact and object, on the cells of the relief
    parts : connected parts of the contact that are wide enough to be fitted
    """

    sheet: CompensatedSheet
    parts: tuple[ObjectPart, ...]

    @property
    def core(self) -> BoolArray:
        """Mask (row, col) of the cells that fits of the object may use."""
        cores = [part.core for part in self.parts]
        return np.logical_or.reduce(cores) if cores else np.zeros(self.sheet.contact.shape, bool)

    @property
    def blur_mm(self) -> float:
        """Width over which the edge of the contact is blurred, mm."""
        return self.sheet.blur_mm

    def touches(self, xy_mm: FloatArray) -> BoolArray:
        """Return a mask (n,): True if the nearest cell of a point (n, xy), mm, is in contact."""
        relief, contact = self.sheet.relief, self.sheet.contact
        col, row = (
            np.rint((xy_mm[:, axis] - cells[0]) / (cells[1] - cells[0])).astype(np.intp)
            for axis, cells in ((0, relief.x_mm), (1, relief.y_mm))
        )
        inside = (row >= 0) & (row < contact.shape[0]) & (col >= 0) & (col < contact.shape[1])
        touching = np.zeros(len(xy_mm), bool)
        touching[inside] = contact[row[inside], col[inside]]
        return touching

    def noise_of(self, estimate: FittedDimension, cells: IntArray) -> FitNoise:
        """Return the uncertainty of a fit by noise and texture of the coat.

        Parameters
        ----------
        cells : (n,) number of the cell of each fitted point
        """
        return noise_of_fit(estimate, cells, self.sheet.contact.shape)

    def moved(self, points_mm: FloatArray, cells: IntArray) -> Iterator[FloatArray]:
        """Yield the points (n, xyz), mm, moved by each non-zero standard uncertainty of the layer.

        All points move together, each along its normal.
        """
        normal = self.sheet.normal.reshape(-1, 3)[cells]
        for move in self.sheet.layer_moves_mm:
            away = move.flat[cells]
            if away.any():
                yield points_mm - away[:, None] * normal


@dataclass(frozen=True, eq=False)
class SheetCompensation:
    """Reconstruction of the object under the sheet of a measured coat, computed at first use.

    Attributes
    ----------
    experiment : the measured experiment
    points : measured points of the coat
    layer : assumed elastomer and load; None: those of the experiment
    """

    experiment: Experiment
    points: PointMap
    layer: SensorLayer | None = None

    @property
    def compensated(self) -> ObjectUnderSheet | None:
        """The reconstructed object; None if there is none, `why` gives the reason."""
        return None if isinstance(self._outcome, str) else self._outcome

    @property
    def why(self) -> str:
        """Reason why the object could not be reconstructed; empty if it was."""
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
    """Return the reconstruction, not yet computed, of the object under a thin sheet.

    None if the method has no press or no fringes, or if the elastomer is not a thin sheet.
    """
    method = experiment.method
    if not (method.fringes and method.presses and may_wrap(experiment.elastomer)):
        return None
    return SheetCompensation(experiment, points, layer)


def wrapping_pressure_kpa(modulus_kpa: float, thickness_mm: float) -> float:
    """Return the air pressure that wraps a sheet round objects of a few mm."""
    return _WRAPPING_STRAIN_PER_MM * modulus_kpa * thickness_mm


def more_contact(under: ObjectUnderSheet | None) -> str:
    """Return advice as text: how to make a thin sheet touch more of an object."""
    if under is None:
        return "press deeper"
    layer = under.sheet.layer
    air_kpa = wrapping_pressure_kpa(layer.young_modulus_kpa, layer.thickness_mm)
    deeper, sticking = "press deeper", "let it stick (elastomer.tack_j_m2)"
    ways = [deeper] if layer.sticks else [deeper, sticking]
    if layer.back_pressure_kpa < _MUCH_LESS * air_kpa:
        ways.insert(0, f"wrap the sheet by air (press.back_pressure_kpa = {air_kpa:.2g})")
    return " or ".join(filter(None, (", ".join(ways[:-1]), ways[-1])))


def compensated_sheet(points: PointMap, layer: SensorLayer) -> CompensatedSheet:
    """Reconstruct the object under a thin sheet from the measured points of the coat.

    Raises
    ------
    InputError : there is no valid point, or the points show no object
    """
    valid = points.valid
    if not valid.any():
        raise InputError("compensate: found no valid point; look at the mask's reasons")
    points_mm = at_pixels(points.points_world_mm, valid).astype(np.float64)
    sigma_mm = at_pixels(points.sigma_z_mm, valid).astype(np.float64)
    return compensate_sheet(points_mm, sigma_mm, sheet_layer(layer))


def sheet_layer(layer: SensorLayer) -> SheetLayer:
    """Return the parameters of a layer in the form that the equations of a thin sheet need."""
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
    """Return the standard uncertainty, kPa, of Young's modulus.

    It is the given one, or else that of a uniform distribution over the range of the modulus.
    """
    if layer.sigma.young_modulus_kpa is not None:
        return layer.sigma.young_modulus_kpa
    modulus = young_modulus(layer.elastomer)
    return float((modulus.high_kpa - modulus.low_kpa) / np.sqrt(12.0))
