"""Loads by which a thin sheet touches enough of the object to measure it, computed by presses.

Without air pressure or tack a thin sheet touches little more than the tip of an object, and the
dimensions of the object cannot be measured. Each remedy changes one number of the experiment, so
that the object is measured from the true coat of a press. No images are rendered, and the cells are
coarse: a press takes about a second.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import Reason
from reconstruction.errors import InputError
from reconstruction.triangulation import PointMap
from twin.config import Experiment, vary
from twin.mechanics import PressedElastomer
from twin.mechanics.hardness import young_modulus
from twin.optics.stack import Truth
from twin.pipeline.press import press_smooth
from twin.results.object_score import MeasuredQuantity, ObjectScore, score_object
from twin.results.under_sheet import sheet_compensation, wrapping_pressure_kpa

# Coarse presses: the contact differs by a few per cent from that on the finest cells.
_CELL_MM, _PITCH_MM = 0.3, 0.05
# Values that are tried, in units of the typical air pressure or of the present load, ascending.
_SHARES_OF_AIR, _TYPICAL_SHARE = (0.125, 0.25, 0.5, 1.0, 1.5), 1.0
_TIMES_THE_LOAD, _TYPICAL_TIMES = (1.5, 2.0, 3.0, 4.0, 6.0), 3.0
# Assumed: from weakly to strongly adhesive silicone, J/m2.
_TACKS_J_M2, _TYPICAL_TACK = (0.01, 0.02, 0.05, 0.1, 0.2), 0.2
# Standard deviation of the coat's heights that the evaluation assumes.
_SIGMA_MM = 5e-4


@dataclass(frozen=True)
class ContactRemedy:
    """One changed number of an experiment, with which the object is measured.

    Attributes
    ----------
    key : dotted path of the number
    value : its value
    coverage : share of the visible object that has a point in contact
    quantities : lengths of the object, as measured from the true coat
    """

    key: str
    value: float
    coverage: float
    quantities: tuple[MeasuredQuantity, ...]

    @property
    def toml(self) -> str:
        """Line of TOML for the table that the comment names, with the share that is touched."""
        table, _, name = self.key.rpartition(".")
        touched = f"touches {self.coverage:.0%} of the object"
        lengths = [
            f"{item.measurand.name} {item.value:.3f} mm"
            for item in self.quantities[:2]
            if item.value is not None
        ]
        return f"{name} = {self.value:g}  # in [{table}]: {', '.join([touched, *lengths])}"


@dataclass(frozen=True)
class _Number:
    """A number of the experiment that increases the contact: values to be tried, ascending."""

    key: str
    values: tuple[float, ...]
    typical: float


def contact_remedies(
    experiment: Experiment, progress: Callable[[float], None] = lambda _: None
) -> list[ContactRemedy]:
    """Return the smallest air pressure, load and tack with which the object is measured.

    Each remedy is sufficient by itself. A number is left out if none of its tried values is.

    Parameters
    ----------
    progress : called with the finished share, 0 to 1
    """
    coarse, remedies = _coarse(experiment), []
    numbers = list(_numbers(experiment))
    for done, number in enumerate(numbers, start=1):
        remedies.append(_smallest(coarse, number))
        progress(done / len(numbers))
    return [remedy for remedy in remedies if remedy is not None]


def first_remedy(experiment: Experiment) -> ContactRemedy | None:
    """Return the first of a typical air pressure, load and tack that is sufficient, or None.

    One to three presses, where `contact_remedies` computes about ten.
    """
    coarse = _coarse(experiment)
    for number in _numbers(experiment):
        with suppress(InputError):  # no equilibrium: the next number is tried
            typical = number.typical in number.values
            remedy = _remedy(coarse, number.key, number.typical) if typical else None
            if remedy is not None:
                return remedy
    return None


def _coarse(experiment: Experiment) -> Experiment:
    return vary(experiment, {"press.cell_mm": _CELL_MM, "press.relief_pitch_mm": _PITCH_MM})


def _numbers(experiment: Experiment) -> Iterator[_Number]:
    press, elastomer = experiment.press, experiment.elastomer
    air_kpa = wrapping_pressure_kpa(young_modulus(elastomer).best_kpa, elastomer.thickness_mm)
    airs = tuple(share * air_kpa for share in _SHARES_OF_AIR)
    pressure_kpa, tack_j_m2 = press.back_pressure_kpa, elastomer.tack_j_m2
    yield _number("press.back_pressure_kpa", pressure_kpa, airs, _TYPICAL_SHARE * air_kpa)
    key = "force_n" if press.control == "force" else "depth_mm"
    load = float(getattr(press, key))
    loads = tuple(load * times for times in _TIMES_THE_LOAD)
    yield _number(f"press.{key}", load, loads, _TYPICAL_TIMES * load)
    yield _number("elastomer.tack_j_m2", tack_j_m2, _TACKS_J_M2, _TYPICAL_TACK)


def _number(key: str, present: float, values: Sequence[float], typical: float) -> _Number:
    """Return the values above the present one, and the typical one, to two digits."""
    rounded = tuple(value for value in map(_two_digits, values) if value > present)
    return _Number(key, rounded, _two_digits(typical))


def _two_digits(value: float) -> float:
    return float(f"{value:.2g}")


def _smallest(experiment: Experiment, number: _Number) -> ContactRemedy | None:
    """Return the remedy with the smallest sufficient value of a number, by bisection.

    It assumes that every larger value with an equilibrium is sufficient, too.
    """
    low, high, smallest = 0, len(number.values), None
    while low < high:
        middle = (low + high) // 2
        try:
            remedy = _remedy(experiment, number.key, number.values[middle])
        except InputError:  # no equilibrium: the load is too large
            high = middle
            continue
        smallest = remedy or smallest
        low, high = (low, middle) if remedy else (middle + 1, high)
    return smallest


def _remedy(experiment: Experiment, key: str, value: float) -> ContactRemedy | None:
    """Return the remedy with a value if the object is then measured, else None."""
    changed = vary(experiment, {key: value})
    score = score_of_coat(changed, press_smooth(changed))
    if score.observed is None or not is_measured(score, experiment.score.good_within_um):
        return None
    lengths = tuple(item for item in score.quantities if item.measurand.unit == "mm")
    return ContactRemedy(key, value, score.observed.coverage or 0.0, lengths)


def is_measured(score: ObjectScore, good_within_um: float) -> bool:
    """Return True if every length of the object is within its tolerance, U included.

    Without a tolerance, deviation and U are limited to `good_within_um`. An object without lengths
    is measured if the sheet touches it.
    """
    lengths = [item for item in score.quantities if item.measurand.unit == "mm"]
    if not lengths:
        return score.figures.get("object_rms_um") is not None
    return all(_is_within(item, good_within_um) for item in lengths)


def _is_within(measured: MeasuredQuantity, good_within_um: float) -> bool:
    if measured.error is None:
        return False
    if measured.margin is not None:
        return measured.margin >= 0.0
    return max(abs(measured.error), measured.uncertainty.expanded) <= good_within_um


def score_of_coat(experiment: Experiment, pressed: PressedElastomer) -> ObjectScore:
    """Return the score of the object, computed from the true coat of a press."""
    x, y = np.meshgrid(pressed.face_x_mm, pressed.face_y_mm)
    points = np.stack((x, y, pressed.face_z_mm), axis=-1)[::-1].astype(np.float32)
    shape = points.shape[:2]
    sigma = np.full((*shape, 3), _SIGMA_MM, np.float32)
    above = np.diag([1.0, -1.0, -1.0, 1.0])
    coat = PointMap(points, sigma, np.full(shape, Reason.VALID, np.uint8), above)
    flat, every = np.zeros(shape, np.float32), np.ones(shape, bool)
    truth = Truth(points, np.zeros_like(points), flat, flat, flat, every, every)
    compensation = sheet_compensation(experiment, coat)
    measured = (points, every, sigma[..., 2])
    return score_object(experiment, measured, truth, pressed, compensation)
