"""Means, spreads and budgets over trials, as the paper and JCGM 100 define them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from twin.paper.trials import Trial

COVERAGE_FACTOR = 2.0
# Probabilistically symmetric coverage interval of 95 % (JCGM 101, 7.7), in percent.
_LOW, _HIGH = 2.5, 97.5


@dataclass(frozen=True)
class Spread:
    """One figure over repeated trials.

    Attributes
    ----------
    mean, sd : sd is the sample standard deviation, None for a single trial
    n : trials that gave the figure
    low, high : 2.5th and 97.5th percentile
    """

    mean: float
    sd: float | None
    n: int
    low: float
    high: float

    @property
    def u_rep(self) -> float | None:
        """Standard uncertainty of the mean: s / sqrt(n), the paper's u_rep."""
        return None if self.sd is None else self.sd / float(np.sqrt(self.n))


@dataclass(frozen=True)
class Budget:
    """The paper's uncertainty budget of a fitted radius, mm."""

    u_rep: float
    u_ref: float
    u_cal: float

    @property
    def combined(self) -> float:
        """Combined standard uncertainty."""
        return float(np.sqrt(self.u_rep**2 + self.u_ref**2 + self.u_cal**2))

    @property
    def expanded(self) -> float:
        """Expanded uncertainty U, k = 2."""
        return COVERAGE_FACTOR * self.combined


def values_of(trials: Iterable[Trial], name: str) -> np.ndarray:
    """Return a figure of every trial that has it, (n,) float."""
    values = [trial.figures[name] for trial in trials if trial.figures.get(name) is not None]
    return np.array(values, np.float64)


def spread_of(values: Sequence[float] | np.ndarray) -> Spread | None:
    """Return mean and spread; None without a value."""
    sample = np.asarray(values, np.float64)
    if not sample.size:
        return None
    sd = float(sample.std(ddof=1)) if sample.size > 1 else None
    low, high = np.percentile(sample, (_LOW, _HIGH))
    return Spread(float(sample.mean()), sd, int(sample.size), float(low), float(high))


def root_mean_square(values: np.ndarray) -> float:
    """Return the root mean square of at least one value."""
    return float(np.sqrt(np.mean(values**2)))
