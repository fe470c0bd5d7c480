"""Distribution of a measurand over trials, as JCGM 101:2008 reports it.

It has mean and standard uncertainty (7.6) and two coverage intervals: the probabilistically
symmetric (7.7) and the shortest (5.3.4). It also states how many significant digits the number of
trials supports (7.9).
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
    """Coverage interval of a measurand: its lower and upper end, in the measurand's unit."""

    low: float
    high: float

    @property
    def width(self) -> float:
        """Upper end minus lower end, in the measurand's unit."""
        return self.high - self.low


@dataclass(frozen=True)
class Stability:
    """Number of significant digits of a result that the number of trials supports (JCGM 101, 7.9).

    Attributes
    ----------
    digits : significant decimal digits of the standard uncertainty that the trials support, 0 to 2
    errors : two standard deviations of mean, standard uncertainty, lower and upper end of the
        symmetric interval; without an interval only of the first two. They must not exceed the
        tolerance
    tolerance : numerical tolerance (7.9.2) for the supported digits; for one digit if none is
        supported
    trials_for_one_digit : approximate number of trials that support one digit
    """

    digits: int
    errors: tuple[float, ...]
    tolerance: float
    trials_for_one_digit: int

    @property
    def weakest(self) -> str:
        """Name of the statistic with the largest error, for example "low end"."""
        return _STATISTICS[int(np.argmax(self.errors))]


@dataclass(frozen=True, eq=False)
class Distribution:
    """Distribution of one measurand over the trials, in the measurand's unit.

    Attributes
    ----------
    values : (n,) float, value of each trial, in the order of the trials
    mean, standard_uncertainty : mean and sample standard deviation of the values
    symmetric, shortest : coverage intervals; None if there are too few trials for the coverage
    coverage : coverage probability of the intervals, 0 to 1
    stability : digits that the trials support; None if all values are equal
    """

    values: FloatArray
    mean: float
    standard_uncertainty: float
    symmetric: Interval | None
    shortest: Interval | None
    coverage: float
    stability: Stability | None


def distribution_of(values: ArrayLike, coverage: float = COVERAGE) -> Distribution:
    """Return the distribution of the values (n,) of a measurand over n >= 2 trials.

    Raises
    ------
    ValueError
        Fewer than two values, or a coverage that is not between 0 and 1.
    """
    measured = np.asarray(values, np.float64)
    if measured.ndim != 1 or measured.size < 2 or not 0.0 < coverage < 1.0:
        raise ValueError("a distribution needs two values or more, and a coverage between 0 and 1")
    return Distribution(
        values=measured,
        mean=float(measured.mean()),
        standard_uncertainty=float(measured.std(ddof=1)),
        symmetric=symmetric_interval(measured, coverage),
        shortest=shortest_interval(measured, coverage),
        coverage=coverage,
        stability=stability_of(measured, coverage),
    )


def symmetric_interval(values: FloatArray, coverage: float = COVERAGE) -> Interval | None:
    """Return the probabilistically symmetric coverage interval (JCGM 101, 7.7.2).

    None if fewer than two trials would be outside: below 40 trials for 95 %.
    """
    if not _enough(values, coverage):
        return None
    inside, ordered = _inside(values, coverage), np.sort(values)
    first = _first(values, coverage)
    return Interval(float(ordered[first - 1]), float(ordered[first + inside - 1]))


def shortest_interval(values: FloatArray, coverage: float = COVERAGE) -> Interval | None:
    """Return the shortest coverage interval (JCGM 101, 7.7.4).

    None if fewer than two trials would be outside: below 40 trials for 95 %.
    """
    if not _enough(values, coverage):
        return None
    inside, ordered = _inside(values, coverage), np.sort(values)
    at = int(np.argmin(ordered[inside:] - ordered[: values.size - inside]))
    return Interval(float(ordered[at]), float(ordered[at + inside]))


def _inside(values: FloatArray, coverage: float) -> int:
    """Return the number q of JCGM 101, 7.7.1: coverage times number of values, rounded."""
    # 0.95 * 100 differs from 95 in the last bit.
    return floor(round(coverage * values.size, 9) + 0.5)


def _first(values: FloatArray, coverage: float) -> int:
    """Return the number r of JCGM 101, 7.7.2: 50 % of the trials outside, rounded up."""
    return -(-(values.size - _inside(values, coverage)) // 2)


def _enough(values: FloatArray, coverage: float) -> bool:
    return round(values.size * (1.0 - coverage), 9) >= 2.0


def tolerance_of(standard_uncertainty: float, digits: int) -> float:
    """Return half a unit of the last of `digits` significant digits (JCGM 101, 7.9.2)."""
    power = floor(log10(standard_uncertainty)) - (digits - 1)
    if round(standard_uncertainty / 10.0**power) >= 10**digits:  # 0.0996 is 0.10 in one digit
        power += 1
    return 0.5 * 10.0**power


def stability_of(values: FloatArray, coverage: float = COVERAGE) -> Stability | None:
    """Return the number of digits that the trials support; None if all values are equal.

    Two standard deviations of mean, standard uncertainty and ends of the interval must not exceed
    the tolerance (JCGM 101, 7.9.4). From 10^4 trials on, they are computed from blocks of trials,
    as in the guide. Below, they are computed from resampled trials, drawn with replacement
    (bootstrap).
    """
    spread = float(values.std(ddof=1))
    if not spread > 1e-12 * float(np.abs(values).max()):
        return None
    errors = _errors(values, coverage)
    supported = [n for n in (1, 2) if max(errors) <= tolerance_of(spread, n)]
    digits = max(supported, default=0)
    one_digit = tolerance_of(spread, 1)
    more = ceil(values.size * (max(errors) / one_digit) ** 2)
    return Stability(digits, errors, tolerance_of(spread, max(digits, 1)), more)


def _errors(values: FloatArray, coverage: float) -> tuple[float, ...]:
    """Return two standard deviations of each statistic: mean, standard deviation, interval ends."""
    if values.size >= _LEAST_FOR_BLOCKS:
        drawn = values[: values.size // _BLOCKS * _BLOCKS].reshape(_BLOCKS, -1)
        share = 1.0 / np.sqrt(_BLOCKS)  # 7.9.4 g: standard deviation of the mean over the blocks
    else:
        rng, share = np.random.default_rng(0), 1.0
        drawn = values[rng.integers(0, values.size, (_RESAMPLES, values.size))]
    return tuple(2.0 * share * float(s.std(ddof=1)) for s in _statistics(drawn, coverage))


def _statistics(drawn: FloatArray, coverage: float) -> Sequence[FloatArray]:
    """Return mean, standard deviation and ends of the symmetric interval, each (resample,).

    The ends are left out if there are too few trials for the coverage.
    """
    statistics = [drawn.mean(axis=1), drawn.std(axis=1, ddof=1)]
    if _enough(drawn[0], coverage):
        first, inside = _first(drawn[0], coverage), _inside(drawn[0], coverage)
        ordered = np.sort(drawn, axis=1)
        statistics += [ordered[:, first - 1], ordered[:, first + inside - 1]]
    return statistics
