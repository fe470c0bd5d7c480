"""Compute the coat over an object of known form under a slab as a function of fitted parameters.

Parameters are named by dotted paths of an experiment, such as `specimen.diameter_mm`,
`press.depth_mm` and `elastomer.thickness_mm`. The parameters `plane.*` describe the plane of the
undeformed coat in the frame of the points, and `theory.large_strain` the error of the linear model.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from pydantic import ValidationError

from reconstruction.arrays import FloatArray
from reconstruction.compensation import CoatSlopes, Relief, SlabCoat
from reconstruction.errors import FitError, InputError
from twin.config.models import Elastomer, Press
from twin.config.sensor_layer import SensorLayer
from twin.config.specimen_base import Specimen
from twin.mechanics.errors import PressError, SolverError
from twin.mechanics.hardness import young_modulus
from twin.mechanics.slab_tangent import CoatMove, SlabData, SolvedSlab, solve_slab
from twin.specimens import shape_of

TRAVEL, THICKNESS, MODULUS, AIR = (
    "press.depth_mm",
    "elastomer.thickness_mm",
    "elastomer.young_modulus_kpa",
    "press.back_pressure_kpa",
)
STRAIN = "theory.large_strain"
PLANE = ("plane.z_mm", "plane.lift_x_mm", "plane.lift_y_mm")
_OF_THE_SPECIMEN = "specimen."
_STEP_MM = 1e-4
# Step of numerical derivatives by parameters of layer and load, over the parameter.
_SMALL_SHARE = 1e-4
# Large strain reduces the coat's height u: the decrease over depth / thickness, the power of u in
# the decrease, and the share that remains after its size is fitted (docs/compensation.md).
_THEORY_SHARE, _THEORY_POWER, _THEORY_LEFT = 0.1, 4.0, 0.3


@dataclass(frozen=True)
class SlabObject:
    """Specimen of known form under a slab, and the parameters of the specimen that are fitted.

    Attributes
    ----------
    specimen : specimen with approximate size and position
    fitted_paths : paths of the fitted parameters in the specimen, such as `diameter_mm`
    layer : nominal slab and load, with their uncertainties
    theory : True if effects that the linear model neglects count as uncertainty
    """

    specimen: Specimen
    fitted_paths: tuple[str, ...]
    layer: SensorLayer
    theory: bool = True

    @property
    def elastomer(self) -> Elastomer:
        """Slab with its modulus as a field of its own, in place of a hardness."""
        return with_modulus(self.layer.elastomer, young_modulus(self.layer.elastomer).best_kpa)

    @property
    def load(self) -> Press:
        """Press to the stated travel, or to the start value of the fit if no travel is stated."""
        press = self.layer.press
        start = press.depth_mm or min(0.5, 0.5 * self.layer.elastomer.thickness_mm)
        return Press(
            control="depth",
            depth_mm=start,
            back_pressure_kpa=press.back_pressure_kpa,
        )


@dataclass(frozen=True, eq=False)
class PressedCoat:
    """Function that returns the coat of a slab for values of the fitted parameters.

    Attributes
    ----------
    slab : specimen, slab and load
    relief : gives the cells on which the coat is computed
    names : names of the parameters, in the order of their values
    solver_pitch_mm : grid spacing of the contact solution
    """

    slab: SlabObject
    relief: Relief
    names: tuple[str, ...]
    solver_pitch_mm: float

    def __call__(self, values: FloatArray) -> SlabCoat:
        """Return the coat for values (n,) of the parameters.

        Raises
        ------
        FitError : no press exists with these values
        """
        try:
            solved = self.solved(values)
        except (PressError, SolverError) as error:
            raise FitError(f"slab: no such press: {error}") from None
        lifted = solved.coat_mm.copy()
        for value, name in zip(values.tolist(), self.names, strict=True):
            if name in (*PLANE, STRAIN):
                lifted += value * self._added(solved, name)
        return SlabCoat(
            coat_mm=lifted,
            force_n=_kpa(solved) * solved.force_mm2,
            slopes=cache(lambda: self._slopes(solved, values)),
            theory_mm=(_left_out_mm(solved),) if self.slab.theory else (),
        )

    def _slopes(self, solved: SolvedSlab, values: FloatArray) -> CoatSlopes:
        moves = [self._move(solved, values, name) for name in self.names]
        force_n = _kpa(solved) * np.array([move.force_mm2 for move in moves])
        if MODULUS in self.names:
            force_n[self.names.index(MODULUS)] += 1e-3 * solved.force_mm2
        return CoatSlopes(np.stack([move.coat_mm for move in moves]), force_n)

    def solved(self, values: FloatArray) -> SolvedSlab:
        """Return the solution of the press for values (n,) of the parameters."""
        specimen, (elastomer, load) = self.specimen(values), self._data(values)
        return solve_slab(specimen, elastomer, load, self.relief.heights_mm.shape)

    def _move(self, solved: SolvedSlab, values: FloatArray, name: str) -> CoatMove:
        if name in (*PLANE, STRAIN):
            # The dependence of the field of theory on the other parameters is of second order.
            return CoatMove(self._added(solved, name), 0.0)
        if name == TRAVEL:
            return solved.moved_by_travel()
        place = self.names.index(name)
        if not name.startswith(_OF_THE_SPECIMEN):
            step = _SMALL_SHARE * max(float(values[place]), 1e-3)
            shifted = [self._data(self._stepped(values, place, by)) for by in (-step, step)]
            return solved.moved_by_layer(shifted[0], shifted[1], step)
        rows, cols = solved.touched_cells
        behind = [
            shape_of(self.specimen(self._stepped(values, place, by))).height_above_lowest(
                solved.layer.x_mm[cols], solved.layer.y_mm[rows]
            )
            for by in (-_STEP_MM, _STEP_MM)
        ]
        present = np.isfinite(behind[0]) & np.isfinite(behind[1])
        rate = np.zeros_like(behind[0])
        np.subtract(behind[0], behind[1], out=rate, where=present)
        return solved.moved_by(rate / (2 * _STEP_MM))

    def _stepped(self, values: FloatArray, place: int, by: float) -> FloatArray:
        stepped = values.copy()
        stepped[place] += by
        return stepped

    def specimen(self, values: FloatArray) -> Specimen:
        """Return the specimen for values (n,) of the parameters."""
        specimen = self.slab.specimen
        for name, value in zip(self.names, values.tolist(), strict=True):
            if name.startswith(_OF_THE_SPECIMEN):
                specimen = with_value(specimen, name.removeprefix(_OF_THE_SPECIMEN), value)
        return specimen

    def _data(self, values: FloatArray) -> SlabData:
        numbers = dict(zip(self.names, values.tolist(), strict=True))
        elastomer, load = self.slab.elastomer, self.slab.load
        if MODULUS in numbers:
            elastomer = with_modulus(elastomer, numbers[MODULUS])
        if THICKNESS in numbers:
            elastomer = elastomer.model_copy(update={"thickness_mm": numbers[THICKNESS]})
        pressed = {"depth_mm": TRAVEL, "back_pressure_kpa": AIR}
        changed = {key: numbers[name] for key, name in pressed.items() if name in numbers}
        changed["solver_pitch_mm"] = self.solver_pitch_mm
        return elastomer, load.model_copy(update=changed)

    def _added(self, solved: SolvedSlab, name: str) -> FloatArray:
        """Return the derivative of the coat's height (row, col) by a parameter of plane or theory.

        `plane.lift_*` is the rise of the plane at the rim.
        """
        if name == STRAIN:
            return _large_strain_mm(solved)
        x, y = self.relief.x_mm, self.relief.y_mm[:, None]
        across: dict[str, FloatArray] = {
            PLANE[0]: np.ones(1),
            PLANE[1]: x / float(x.max()),
            PLANE[2]: y / float(y.max()),
        }
        return np.broadcast_to(across[name], self.relief.heights_mm.shape)


def value_of(specimen: Specimen, path: str) -> float:
    """Return the number of a specimen at a dotted path, such as `diameter_mm` or `widths_mm.0`.

    Raises
    ------
    InputError : there is no number at this path
    """
    node: Any = specimen.model_dump()
    for name in path.split("."):
        try:
            node = node[int(name) if isinstance(node, list | tuple) else name]
        except (KeyError, IndexError, ValueError, TypeError):
            node = None
            break
    if isinstance(node, bool) or not isinstance(node, int | float):
        numbers = [k for k, v in specimen.model_dump().items() if isinstance(v, float)]
        raise InputError(f"fitted: found '{path}', allowed numbers of the specimen: {numbers}")
    return float(node)


def with_value(specimen: Specimen, path: str, value: float) -> Specimen:
    """Return a specimen with the number at a dotted path changed.

    Raises
    ------
    FitError : the value is not allowed for this specimen
    """
    tree = specimen.model_dump()
    *tables, last = path.split(".")
    node: Any = tree
    for name in tables:
        if isinstance(node[name], tuple):
            node[name] = list(node[name])
        node = node[name]
    node[int(last) if isinstance(node, list) else last] = value
    try:
        return type(specimen).model_validate(tree)
    except ValidationError as error:
        raise FitError(f"{path}: found {value:g}: {error.errors()[0]['msg']}") from None


def _kpa(solved: SolvedSlab) -> float:
    """Return the factor from force over modulus, mm^2, to force, N: the modulus in N/mm^2."""
    return 1e-3 * young_modulus(solved.elastomer).best_kpa


def _large_strain_mm(solved: SolvedSlab) -> FloatArray:
    """Return the standard uncertainty of the coat's height by large strain, mm, (row, col)."""
    raised = np.maximum(solved.raised_mm, 0.0)
    highest = float(raised.max())
    return np.asarray(_strain(solved) * highest * (raised / highest) ** _THEORY_POWER)


def _left_out_mm(solved: SolvedSlab) -> FloatArray:
    """Return the uncertainty of the coat's height by large strain, mm, (row, col), after the fit.

    It is the part that remains after the size of the effect was fitted as a parameter.
    """
    raised = np.maximum(solved.raised_mm, 0.0)
    return np.asarray(_THEORY_LEFT * _strain(solved) * raised * (1 - raised / float(raised.max())))


def _strain(solved: SolvedSlab) -> float:
    return _THEORY_SHARE * solved.contact.depth_mm / solved.layer.thickness_mm


def with_modulus(elastomer: Elastomer, modulus_kpa: float) -> Elastomer:
    """Return an elastomer with the given Young's modulus in place of its hardness."""
    changes = {"shore_a": None, "shore_00": None, "young_modulus_kpa": modulus_kpa}
    return elastomer.model_copy(update=changes)
