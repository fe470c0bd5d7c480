"""Mean, spread and uncertainty budget over trials, as defined in the paper and in JCGM 100."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from twin.paper.trials import Trial

COVERAGE_FACTOR = 2.0
# Probabilistically symmetric coverage interval of 95 % (JCGM 101, 7.7), in percent.
_LOW, _HIGH = 2.5, 97.5


@dataclass(frozen=True)
class Spread:
    """Mean and spread of one measured value over repeated trials, in the unit of the value.

    Attributes
    ----------
    mean : mean over the trials
    sd : sample standard deviation; None for a single trial
    n : number of trials that have the value
    low, high : 2.5th and 97.5th percentile
    """

    mean: float
    sd: float | None
    n: int
    low: float
    high: float

    @property
    def u_rep(self) -> float | None:
        """Standard uncertainty of the mean: s / sqrt(n), the paper's u_rep; None without `sd`."""
        return None if self.sd is None else self.sd / float(np.sqrt(self.n))


@dataclass(frozen=True)
class Budget:
    """Uncertainty budget of a fitted radius, as in the paper; standard uncertainties in mm.

    Attributes
    ----------
    u_rep : standard uncertainty due to repetition, of the mean radius
    u_ref : standard uncertainty of the reference radius
    u_cal : standard uncertainty due to calibration
    """

    u_rep: float
    u_ref: float
    u_cal: float

    @property
    def combined(self) -> float:
        """Combined standard uncertainty: root sum of squares of the contributions, mm."""
        return float(np.sqrt(self.u_rep**2 + self.u_ref**2 + self.u_cal**2))

    @property
    def expanded(self) -> float:
        """Expanded uncertainty U with coverage factor k = 2, mm."""
        return COVERAGE_FACTOR * self.combined


def values_of(trials: Iterable[Trial], name: str) -> np.ndarray:
    """Return the measured value `name` of every trial that has this value, (n,) float."""
    values = [trial.figures[name] for trial in trials if trial.figures.get(name) is not None]
    return np.array(values, np.float64)


def spread_of(values: Sequence[float] | np.ndarray) -> Spread | None:
    """Return mean and spread of a sample of values; None if the sample is empty."""
    sample = np.asarray(values, np.float64)
    if not sample.size:
        return None
    sd = float(sample.std(ddof=1)) if sample.size > 1 else None
    low, high = np.percentile(sample, (_LOW, _HIGH))
    return Spread(float(sample.mean()), sd, int(sample.size), float(low), float(high))


def root_mean_square(values: np.ndarray) -> float:
    """Return the root mean square of at least one value."""
    return float(np.sqrt(np.mean(values**2)))
