"""Number the fringes of one image row by a chain of fringe periods, coarse to fine.

See `Chain`. Symbols: t_j phase of fringe set j in turns, dt_j its error, s_j its sigma. Level i has
the phase T_i = sum_j c_ij t_j with the weights c_ij, and the period P_i. With R = P_(i-1) / P_i the
step to level i has the error e = sum_j (R c_(i-1)j - c_ij) dt_j. For a hierarchical chain this
gives s_e^2 = s_h^2 + R^2 s_l^2, from the sigmas of the higher and the lower frequency (Zuo et al.,
Opt. Lasers Eng. 85, 84 (2016)). The fringe number is correct unless |e| > 1/2. Let d be the
distance of R T_(i-1) - T_i from the nearest whole number. The two neighbouring numbers, at the
distances 1 - d and 1 + d, are less likely by the ratio of the normal densities.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

import math
from typing import Any, NamedTuple

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.compiling import compiled, inlined
from reconstruction.decoding._order import TINY, TURN, Numbered


class Unwrapping(NamedTuple):
    """Levels of temporal phase unwrapping along one projector axis, see `Chain`.

    `weights` (level, set) are whole numbers c_ij: level i has the phase sum_j (c_ij t_j), with t_j
    the phase of fringe set j. `level_periods_px` (level,) and `set_periods_px` (set,) are periods,
    projector px. `length_px` is the length of the projector image.
    """

    weights: FloatArray
    level_periods_px: FloatArray
    set_periods_px: FloatArray
    length_px: int


@inlined
def _turns(unwrapping: Unwrapping, level: int, phases: Any, col: int) -> float:
    total = 0.0
    for j in range(phases.shape[0]):
        total += unwrapping.weights[level, j] * phases[j, col]
    return total / TURN


@inlined
def _step_sigma(unwrapping: Unwrapping, level: int, ratio: float, sigmas: Any, col: int) -> float:
    """Return the sigma, turns, of the error of the step from the coarser level to `level`.

    ratio : period of the coarser level over that of `level`
    sigmas : (set, col), rad
    """
    total = 0.0
    for j in range(sigmas.shape[0]):
        weight = ratio * unwrapping.weights[level - 1, j] - unwrapping.weights[level, j]
        total += (weight * sigmas[j, col]) ** 2
    return max(math.sqrt(total) / TURN, TINY)


@inlined
def _wrong_neighbour(off: float, sigma: float) -> float:
    """Return the probability that not the nearest whole number is correct but a neighbour of it.

    off, sigma : distance from the nearest whole number, and its standard deviation; both in turns
    """
    below, above = (1.0 - 2.0 * off) / (2.0 * sigma**2), (1.0 + 2.0 * off) / (2.0 * sigma**2)
    wrong = math.exp(-below) + math.exp(-above)
    return wrong / (1.0 + wrong)


@inlined
def _coarsest(unwrapping: Unwrapping, phases: Any, sigmas: Any, col: int) -> Any:
    """Return the coordinate by the coarsest level, px, and the probability that it is wrong.

    The coarsest period is centred on the projector image. The coordinate is wrong if noise moved
    it over an end of this period.
    """
    period = unwrapping.level_periods_px[0]
    low = 0.5 * (unwrapping.length_px - 1.0 - period)
    x = period * _turns(unwrapping, 0, phases, col) - low
    x -= period * math.floor(x / period)
    total = 0.0
    for j in range(sigmas.shape[0]):
        total += (unwrapping.weights[0, j] * sigmas[j, col]) ** 2
    sigma = max(period * math.sqrt(total) / TURN, TINY)
    return x + low, 0.5 * math.erfc(min(x, period - x) / (math.sqrt(2.0) * sigma))


@inlined
def _fused(unwrapping: Unwrapping, x: float, phases: Any, sigmas: Any, col: int) -> Any:
    """Return the coordinate as the mean of all sets weighted by 1 / sigma^2, and its sigma; px.

    x : coordinate by the chain, px, which determines the fringe number of each set
    """
    total, weights = 0.0, 0.0
    for j in range(phases.shape[0]):
        period, turns = unwrapping.set_periods_px[j], phases[j, col] / TURN
        own = period * (np.rint(x / period - turns) + turns)
        weight = 1.0 / max(period * sigmas[j, col] / TURN, TINY) ** 2
        total, weights = total + weight * own, weights + weight
    return total / weights, 1.0 / math.sqrt(weights)


@compiled
def unwrap_row(
    unwrapping: Unwrapping, phases: Any, sigmas: Any, doubts: Any, usable: Any, answer: Numbered
) -> None:
    """Write the fused coordinate, its sigma and the probability of a wrong fringe number.

    All three are 0 for a pixel without a phase.

    phases, sigmas : (set, col), rad
    doubts : like sigmas, but including the uncertainty of the projector's response; used for the
        probability only
    usable : (col,), > 0 for a pixel with a phase
    """
    coordinate, sigma_px, error = answer
    for col in range(error.size):
        coordinate[col], sigma_px[col], error[col] = 0.0, 0.0, 0.0
        if not usable[col] > 0.0:
            continue
        x, wrong = _coarsest(unwrapping, phases, doubts, col)
        for level in range(1, unwrapping.weights.shape[0]):
            period = unwrapping.level_periods_px[level]
            turns = _turns(unwrapping, level, phases, col)
            number = np.rint(x / period - turns)
            off = abs(x / period - turns - number)
            ratio = unwrapping.level_periods_px[level - 1] / period
            wrong += _wrong_neighbour(off, _step_sigma(unwrapping, level, ratio, doubts, col))
            x = period * (number + turns)
        coordinate[col], sigma_px[col] = _fused(unwrapping, x, phases, sigmas, col)
        error[col] = min(wrong, 1.0)
