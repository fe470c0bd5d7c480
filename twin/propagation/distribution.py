"""The distribution of a measurand over trials, as JCGM 101:2008 reports it.

Mean and standard uncertainty (7.6), coverage intervals, probabilistically symmetric (7.7) and
shortest (5.3.4), and whether the number of trials supports the digits (7.9).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor, log10

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import FloatArray

COVERAGE = 0.95
_RESAMPLES = 1000
_BLOCKS, _LEAST_FOR_BLOCKS = 20, 10_000
_STATISTICS = ("mean", "standard uncertainty", "low end", "high end")


@dataclass(frozen=True)
class Interval:
    """A coverage interval, in the measurand's unit."""

    low: float
    high: float

    @property
    def width(self) -> float:
        """Distance of the ends."""
        return self.high - self.low


@dataclass(frozen=True)
class Stability:
    """Whether more trials would change a result (JCGM 101, 7.9).

    Attributes
    ----------
    digits : significant decimal digits of the standard uncertainty that the trials support, 0 to 2
    errors : twice the standard deviation of mean, standard uncertainty and both ends of the
        symmetric interval, which must not exceed the tolerance; without interval the first two
    tolerance : of one digit, or of as many as are supported (7.9.2)
    trials_for_one_digit : how many one digit would take, about
    """

    digits: int
    errors: tuple[float, ...]
    tolerance: float
    trials_for_one_digit: int

    @property
    def weakest(self) -> str:
        """What of the result is known worst."""
        return _STATISTICS[int(np.argmax(self.errors))]


@dataclass(frozen=True, eq=False)
class Distribution:
    """A measurand over the trials.

    Attributes
    ----------
    values : (n,) float, in the order of the trials
    mean, standard_uncertainty : the latter is the sample standard deviation
    symmetric, shortest : coverage intervals; None where the trials are too few for the coverage
    coverage : probability of the intervals
    stability : None where the values do not differ
    """

    values: FloatArray
    mean: float
    standard_uncertainty: float
    symmetric: Interval | None
    shortest: Interval | None
    coverage: float
    stability: Stability | None


def distribution_of(values: ArrayLike, coverage: float = COVERAGE) -> Distribution:
    """Return the distribution of at least two values, (n,).

    Raises
    ------
    ValueError : fewer than two values, or a coverage that is not between 0 and 1
    """
    found = np.asarray(values, np.float64)
    if found.ndim != 1 or found.size < 2 or not 0.0 < coverage < 1.0:
        raise ValueError("a distribution needs two values or more, and a coverage between 0 and 1")
    return Distribution(
        values=found,
        mean=float(found.mean()),
        standard_uncertainty=float(found.std(ddof=1)),
        symmetric=symmetric_interval(found, coverage),
        shortest=shortest_interval(found, coverage),
        coverage=coverage,
        stability=stability_of(found, coverage),
    )


def symmetric_interval(values: FloatArray, coverage: float = COVERAGE) -> Interval | None:
    """Return the probabilistically symmetric coverage interval (JCGM 101, 7.7.2).

    None where trials are too few to leave two of them outside: below 40 for 95 %.
    """
    if not _enough(values, coverage):
        return None
    inside, ordered = _inside(values, coverage), np.sort(values)
    first = _first(values, coverage)
    return Interval(float(ordered[first - 1]), float(ordered[first + inside - 1]))


def shortest_interval(values: FloatArray, coverage: float = COVERAGE) -> Interval | None:
    """Return the shortest coverage interval (JCGM 101, 7.7.4); None where trials are too few."""
    if not _enough(values, coverage):
        return None
    inside, ordered = _inside(values, coverage), np.sort(values)
    at = int(np.argmin(ordered[inside:] - ordered[: values.size - inside]))
    return Interval(float(ordered[at]), float(ordered[at + inside]))


def _inside(values: FloatArray, coverage: float) -> int:
    """Return q of JCGM 101, 7.7.1: p M, or its nearest integer."""
    # 0.95 * 100 is 95 but for its last bit.
    return floor(round(coverage * values.size, 9) + 0.5)


def _first(values: FloatArray, coverage: float) -> int:
    """Return r of JCGM 101, 7.7.2: half of what is left out, rounded up."""
    return -(-(values.size - _inside(values, coverage)) // 2)


def _enough(values: FloatArray, coverage: float) -> bool:
    return round(values.size * (1.0 - coverage), 9) >= 2.0


def tolerance_of(standard_uncertainty: float, digits: int) -> float:
    """Return half a unit in the last of so many significant digits (JCGM 101, 7.9.2)."""
    power = floor(log10(standard_uncertainty)) - (digits - 1)
    if round(standard_uncertainty / 10.0**power) >= 10**digits:  # 0.0996 is 0.10 in one digit
        power += 1
    return 0.5 * 10.0**power


def stability_of(values: FloatArray, coverage: float = COVERAGE) -> Stability | None:
    """Tell which digits the trials support; None where the values do not differ.

    As in JCGM 101, 7.9.4, twice the standard deviations of mean, standard uncertainty and interval
    ends must not exceed the tolerance. The guide takes them from blocks of trials; so does this
    where there are 10^4 or more. Of a measurement that takes seconds there are hundreds in all:
    then they come from resampling these with replacement (bootstrap).
    """
    spread = float(values.std(ddof=1))
    if not spread > 1e-12 * float(np.abs(values).max()):
        return None
    errors = _errors(values, coverage)
    supported = [n for n in (1, 2) if max(errors) <= tolerance_of(spread, n)]
    digits = max(supported, default=0)
    wanted = tolerance_of(spread, 1)
    more = ceil(values.size * (max(errors) / wanted) ** 2)
    return Stability(digits, errors, tolerance_of(spread, max(digits, 1)), more)


def _errors(values: FloatArray, coverage: float) -> tuple[float, ...]:
    """Twice the standard deviations of the statistics of all values."""
    if values.size >= _LEAST_FOR_BLOCKS:
        drawn = values[: values.size // _BLOCKS * _BLOCKS].reshape(_BLOCKS, -1)
        share = 1.0 / np.sqrt(_BLOCKS)  # 7.9.4 g: of the mean over the blocks
    else:
        rng, share = np.random.default_rng(0), 1.0
        drawn = values[rng.integers(0, values.size, (_RESAMPLES, values.size))]
    return tuple(2.0 * share * float(one.std(ddof=1)) for one in _statistics(drawn, coverage))


def _statistics(drawn: FloatArray, coverage: float) -> Sequence[FloatArray]:
    """Mean, standard deviation and ends of the symmetric interval of rows (resample, trial)."""
    found = [drawn.mean(axis=1), drawn.std(axis=1, ddof=1)]
    if _enough(drawn[0], coverage):
        first, inside = _first(drawn[0], coverage), _inside(drawn[0], coverage)
        ordered = np.sort(drawn, axis=1)
        found += [ordered[:, first - 1], ordered[:, first + inside - 1]]
    return found
