"""Model measurements with known uncertainty, importable by worker processes."""

from dataclasses import dataclass

import numpy as np

from reconstruction.errors import InputError
from twin.study.measuring import NOMINAL_CONDITIONS, CaseResult

NOISE, RIG = 0.03, 0.02


@dataclass
class Linear:
    """value = 4 + 2 x - 3 y; the camera's noise and a drawn rig add normal deviations."""

    keep: tuple[str, ...] = ()

    def __call__(self, experiment, conditions=NOMINAL_CONDITIONS):
        place = experiment.specimen
        value = 4.0 + 2.0 * place.x_mm - 3.0 * place.y_mm
        if experiment.camera.noise:
            value += NOISE * np.random.default_rng([7, conditions.trial]).normal()
        figures = {"value_mm": value, "force_n": 1.0 + place.x_mm, "warnings": []}
        if conditions.board:
            figures["true_rig_value_mm"] = value
            rng = np.random.default_rng([8, conditions.seed, conditions.trial])
            figures["value_mm"] += RIG * rng.normal()
        return CaseResult(figures)

    def reads(self):
        return ((("specimen", "x_mm"),),)


class Refusing(Linear):
    """Cannot be measured where x is beyond a limit."""

    def __call__(self, experiment, conditions=NOMINAL_CONDITIONS):
        if experiment.specimen.x_mm > 0.1:
            raise InputError("specimen: beyond the elastomer")
        return super().__call__(experiment, conditions)


class Blank(Linear):
    """A measurement without points: the figure has no value."""

    def __call__(self, experiment, conditions=NOMINAL_CONDITIONS):
        figures = super().__call__(experiment, conditions).figures
        return CaseResult(figures | {"value_mm": None, "points": 0})
