"""Linear normal problems, which have a closed-form posterior."""

from collections.abc import Callable
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray
from twin.config.problem import SensorProblem

NORMAL = {"low": -6.0, "high": 6.0, "prior": "normal", "mean": 0.0, "sd": 1.0}


class Exact:
    """Emulator of a figure with standard deviation `sd` everywhere; takes values, not shares."""

    def __init__(self, figure: Callable[[FloatArray], FloatArray], sd: float = 0.0) -> None:
        self.figure, self.sd = figure, sd

    def predict(self, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        values = self.mean(places)
        return values, np.full_like(values, self.sd)

    def mean(self, places: FloatArray) -> FloatArray:
        return self.figure(12.0 * places - 6.0)


def linear_problem(rows: dict[str, Any], fields: int = 2, **more: Any) -> SensorProblem:
    whole = {name: {"experiment": "one", "metric": name} | row for name, row in rows.items()}
    return SensorProblem.model_validate(
        {
            "name": "linear",
            "experiments": {"one": {"base": "none"}},
            "free": {f"x{i}": NORMAL | {"path": f"p{i}"} for i in range(fields)},
            "rows": whole,
        }
        | more
    )


def linear_emulators(matrix: FloatArray, names: list[str]) -> dict[str, Any]:
    return {n: Exact(lambda v, g=g: v @ g) for n, g in zip(names, matrix, strict=True)}
