"""What a figure is, and what one run says about it."""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Kind = Literal["accuracy", "speed", "absolute"]


@dataclass(frozen=True)
class Target:
    """What the project promises of a figure, in its unit; the ends belong to it."""

    low: float = -math.inf
    high: float = math.inf

    @classmethod
    def about(cls, value: float, within: float) -> "Target":
        """Promise a value within so much on either side."""
        return cls(value - within, value + within)

    def __str__(self) -> str:
        if self.low == self.high:
            return f"{self.low:g}"
        if math.isinf(self.low):
            return f"at most {self.high:g}"
        return (
            f"at least {self.low:g}" if math.isinf(self.high) else f"{self.low:g} to {self.high:g}"
        )


@dataclass(frozen=True)
class GuardedFigure:
    """One named figure.

    Attributes
    ----------
    name : ends with its unit; without one it is a ratio or a count
    what : what was measured, which statistic of it, and its unit
    headline : stands in the README's table, too
    kind : against its baseline "accuracy" fails outside the combined uncertainty, "speed" (a ratio
        inside one run, or memory) when worse by `factor`, "absolute" (seconds, points per hour)
        never
    target : what the project promises, judged besides; None: nothing
    floor, floor_rel : type-B standard uncertainty of a comparison, in the figure's unit and as a
        share of the baseline; the larger counts
    factor : a speed may be worse than its baseline by so much
    higher_is_better : for speeds
    """

    name: str
    what: str
    kind: Kind = "accuracy"
    target: Target | None = None
    floor: float = 0.0
    floor_rel: float = 0.0
    factor: float = 1.5
    higher_is_better: bool = False
    headline: bool = False

    def floor_of(self, baseline: float) -> float:
        """Return the type-B standard uncertainty of a comparison with the baseline."""
        return max(self.floor, self.floor_rel * abs(baseline))


@dataclass(frozen=True)
class MeanOfRuns:
    """Mean of n runs and its type-A standard uncertainty, 0 for a single one."""

    value: float
    standard_uncertainty: float = 0.0
    n: int = 1

    @classmethod
    def of(cls, values: Sequence[float]) -> "MeanOfRuns":
        """Return the mean of the values and its standard uncertainty, s / sqrt(n).

        Raises
        ------
        ValueError
            No value, or one that is no finite number.
        """
        if not values or not all(map(math.isfinite, values)):
            raise ValueError(f"finite values needed, found {list(values)}")
        n = len(values)
        spread = statistics.stdev(values) if n > 1 else 0.0
        return cls(statistics.fmean(values), spread / math.sqrt(n), n)


Values = dict[str, list[float]]
"""Values of every figure of a case, one per seed (or place)."""
