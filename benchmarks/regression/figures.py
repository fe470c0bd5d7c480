"""A guarded figure, its target, the mean of its runs, and the case that measures it."""

import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

Kind = Literal["accuracy", "speed", "absolute"]

Values = dict[str, list[float]]
"""Values of every figure of a case, one per seed."""


@dataclass(frozen=True)
class Target:
    """Range that the project promises for a figure, in its unit; both ends are inside."""

    low: float = -math.inf
    high: float = math.inf

    def __str__(self) -> str:
        if self.low == self.high:
            return f"{self.low:g}"
        if math.isinf(self.low):
            return f"at most {self.high:g}"
        if math.isinf(self.high):
            return f"at least {self.low:g}"
        return f"{self.low:g} to {self.high:g}"


@dataclass(frozen=True)
class GuardedFigure:
    """One named figure.

    Attributes
    ----------
    name : ends with its unit; a ratio or a count has none
    label : quantity, statistic and unit
    headline : is also a row of the README's table
    kind : compared with its baseline, "accuracy" fails outside the combined uncertainty, "speed"
        (a ratio within one run, or memory) if worse by `factor`, "absolute" (seconds, points per
        hour) never
    target : judged in addition to the baseline; None: no target
    floor, floor_rel : type-B standard uncertainty of a comparison, in the figure's unit and
        relative to the baseline; the larger counts
    field : "key" or "key / key" of the JSON object that a benchmark command prints
    """

    name: str
    label: str
    kind: Kind = "accuracy"
    target: Target | None = None
    floor: float = 0.0
    floor_rel: float = 0.0
    factor: float = 1.5
    higher_is_better: bool = False
    headline: bool = False
    field: str = ""

    def floor_of(self, baseline: float) -> float:
        """Return the type-B standard uncertainty of a comparison with the baseline."""
        return max(self.floor, self.floor_rel * abs(baseline))


@dataclass(frozen=True)
class MeanOfRuns:
    """Mean of n runs and its type-A standard uncertainty, 0 for a single run."""

    value: float
    standard_uncertainty: float = 0.0
    n: int = 1

    @classmethod
    def of(cls, values: Sequence[float]) -> "MeanOfRuns":
        """Return the mean of the values and its standard uncertainty, s / sqrt(n).

        Raises
        ------
        ValueError
            There is no value, or a value is not finite.
        """
        if not values or not all(map(math.isfinite, values)):
            raise ValueError(f"finite values needed, found {list(values)}")
        n = len(values)
        spread = statistics.stdev(values) if n > 1 else 0.0
        return cls(statistics.fmean(values), spread / math.sqrt(n), n)


@dataclass(frozen=True)
class BenchmarkCase:
    """Figures that are measured together; `--only` takes the name.

    Attributes
    ----------
    conditions : image size and repetitions, or the command that measures
    measure : returns values of every figure
    quick : runs with `--quick` too
    """

    name: str
    conditions: str
    figures: tuple[GuardedFigure, ...]
    measure: Callable[[], Values]
    quick: bool = True


def repeated(count: int, once: Callable[[int], dict[str, float]]) -> Values:
    """Measure with seeds 1 to `count`, print each seed, and collect the values by name."""
    values: Values = {}
    for seed in range(1, count + 1):
        print(f"  seed {seed} of {count}", flush=True)
        for name, value in once(seed).items():
            values.setdefault(name, []).append(value)
    return values
