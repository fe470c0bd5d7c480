"""Quaternary Gray code: half-period words as digits of base 4, shown by four grey levels.

Half as many frames as with bits. Neighbouring words differ in one digit, by one level. The four
mean levels are measured from all pixels, so that the response of the projector need not be linear.
The probability of another digit follows from the distances of the level from both mean levels, in
standard deviations of the noise. It counts if the other digit changes the fringe order and agrees
with the phase.
"""

import numpy as np
from scipy.special import expit

from reconstruction.arrays import FloatArray, FloatImage, IntArray
from reconstruction.codes import CODES, AxisFringes, CodeWord, Ordered, PatternCode, Wrapped

BASE = 4
NOMINAL = np.arange(BASE) / (BASE - 1)
_BINS = 96
_RANGE = (-0.2, 1.2)
# Least number of samples, and least distance of two mean levels, for measured thresholds.
_LEAST_SAMPLES, _LEAST_DISTANCE = 1000, 0.04
# Largest distance of the first and the last mean level from black and white.
_MOST_OFF = 0.2
# Distance of a word's middle from the coordinate, periods: a quarter, more at blurred edges.
_CONTRADICTION = 0.42
# Logarithm of the odds, below which the probability of another digit is neglected.
_MOST_FURTHER = 20.0


class QuaternaryGrayCode(PatternCode):
    """Pattern code with one word per half period, h = floor(2 x / period), in base 4."""

    name = "quaternary_gray"
    title = "quaternary Gray code"
    summary = "four grey levels: one word per half period in half as many frames as bits"

    def words(self, fringes: AxisFringes) -> tuple[CodeWord, ...]:
        """Return the half-period index as the only code word."""

        def half_periods(x_px: IntArray) -> IntArray:
            return np.floor(2 * x_px / fringes.period_px).astype(np.int64)

        count, digits = int(half_periods(np.array([fringes.length_px - 1]))[0]) + 1, 1
        while BASE**digits < count:
            digits += 1
        return (CodeWord(digits, half_periods, lambda words: gray_digits(words, digits) / 3.0),)

    def unwrap(self, wrapped: Wrapped) -> Ordered:
        """Return coordinates and the probability of a wrong order."""
        means = measured_levels(wrapped.levels[:, wrapped.usable])
        digits = np.searchsorted(0.5 * (means[1:] + means[:-1]), wrapped.levels)
        order, off = _order(digits, wrapped.turns[0])
        error = _order_error(digits, order, means, wrapped)
        coordinate_px = wrapped.coordinate_px(np.where(off < _CONTRADICTION, order, np.nan))
        return Ordered(coordinate_px, error, np.zeros(order.shape, np.uint16))


def _order_error(
    digits: IntArray, order: FloatArray, means: FloatArray, wrapped: Wrapped
) -> FloatArray:
    """Return the probability that a neighbour of a digit is correct, and the order another one."""
    error = np.zeros(order.shape)
    for number, level in enumerate(wrapped.levels):
        variance = np.square(wrapped.level_sigmas[number])
        distance = np.square(level - means[digits[number]])
        for change in (-1, 1):
            changed = np.clip(digits[number] + change, 0, BASE - 1)
            further = 0.5 * (np.square(level - means[changed]) - distance) / variance
            near = (changed != digits[number]) & (further < _MOST_FURTHER)
            some = digits[:, near]
            some[number] = changed[near]
            other, off = _order(some, wrapped.turns[0][near])
            error[near] += (other != order[near]) * (off < _CONTRADICTION) * expit(-further[near])
    return np.minimum(error, 1.0)


def gray_digits(words: IntArray, digits: int) -> IntArray:
    """Return the digits (digit, n) of the reflected Gray code of base 4, the coarsest first."""
    places = np.arange(digits)[::-1, None]
    quotients = words // BASE**places
    digit, is_reflected = quotients % BASE, (quotients // BASE) % 2 == 1
    return np.asarray(np.where(is_reflected, BASE - 1 - digit, digit))


def words_of(digits: IntArray) -> IntArray:
    """Return the words (...) of the digits (digit, ...) of the reflected Gray code."""
    word = np.zeros(digits.shape[1:], np.int64)
    for digit in digits:
        word = BASE * word + np.where(word % 2 == 1, BASE - 1 - digit, digit)
    return word


def _order(digits: IntArray, turns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the fringe order, and the distance of the word's middle from the coordinate, periods.

    A word that is one half period off, at a blurred edge, gives the same order.
    """
    middle = 0.5 * (words_of(digits) + 0.5) - turns
    order = np.rint(middle)
    return order, np.abs(middle - order)


def measured_levels(levels: FloatImage) -> FloatArray:
    """Return the mean levels of the four classes with the least variance in them (Otsu 1979).

    The nominal levels are returned if there are too few pixels, or if the means are not those of
    four grey levels from black to white.

    levels : (frame, pixel), brightness from 0 for black to 1 for white
    """
    counts, edges = np.histogram(levels, _BINS, _RANGE)
    centres = 0.5 * (edges[1:] + edges[:-1])
    if counts.sum() < _LEAST_SAMPLES:
        return NOMINAL
    weight = np.concatenate([[0.0], np.cumsum(counts)])
    moment = np.concatenate([[0.0], np.cumsum(counts * centres)])
    first, last = np.triu_indices(_BINS + 1, 1)
    between = np.full((_BINS + 1, _BINS + 1), -np.inf)
    part = weight[last] - weight[first]
    between[first, last] = (moment[last] - moment[first]) ** 2 / np.maximum(part, 1.0)
    cuts = _best_cuts(between)
    bounds = np.array([0, *cuts, _BINS])
    shares = np.diff(weight[bounds])
    if not shares.all():
        return NOMINAL
    means = np.diff(moment[bounds]) / shares
    is_plausible = max(abs(means[0]), abs(means[-1] - 1.0)) < _MOST_OFF
    if not is_plausible or np.diff(means).min() < _LEAST_DISTANCE:
        return NOMINAL
    return np.asarray(means)


def _best_cuts(between: FloatArray) -> list[int]:
    """Return the bins at which the classes begin, for the largest sum of `between` over classes."""
    best, before = between[0], []
    for _ in range(BASE - 1):
        total = best[:, None] + between
        before.append(np.argmax(total, axis=0))
        best = np.max(total, axis=0)
    cuts = [_BINS]
    for links in before[::-1]:
        cuts.append(int(links[cuts[-1]]))
    return cuts[:0:-1]


CODES.register(QuaternaryGrayCode())
