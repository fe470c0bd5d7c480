"""Several fringe periods that number one another, without words.

Several fringe periods give one absolute coordinate by a chain of levels, coarse to fine. With the
phase phi_j of fringe set j and its period p_j, the phase of level i is sum_j c_ij phi_j, its period
P_i = 1 / sum_j c_ij / p_j. Each level numbers the periods of the next one:
k = round(P_(i-1) Phi_(i-1) / P_i - Phi_i), phases in turns. Zuo et al., Opt. Lasers Eng. 85, 84
(2016): hierarchical and heterodyne (there "multi-wavelength") temporal phase unwrapping.

Micro phase shifting: N steps of one period and a single image of each of several near ones, so that
mean and modulation are the same in all of them; the order is the one at which the single images
agree. Gupta and Nayar, Proc. CVPR 2012, 813.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from reconstruction.errors import InputError

HIERARCHICAL, HETERODYNE, MICRO = "hierarchical", "heterodyne", "micro"
MULTI_FREQUENCY = (HIERARCHICAL, HETERODYNE, MICRO)
# Beats of one, two or three near periods; the first set is the one that is measured with.
BEATS = {2: ((1, -1), (1, 0)), 3: ((1, -2, 1), (1, -1, 0), (1, 0, 0))}
# Of the modulation: what two fringes differ by in the single images of micro phase shifting, root
# of the sum of squares. Where it is less, no camera tells them apart.
LEAST_DISTANCE = 0.02
_NODES_PER_PERIOD = 16


@dataclass(frozen=True)
class Chain:
    """Levels from the coarsest, which is unambiguous, to fringe set 0.

    Parameters
    ----------
    weights : (level, set), whole numbers c_ij
    periods_px : (level,), falling
    """

    weights: tuple[tuple[int, ...], ...]
    periods_px: tuple[float, ...]


def make_chain(code: str, periods_px: tuple[float, ...]) -> Chain:
    """Return the chain of a multi-frequency code; the measuring period comes first.

    Raises
    ------
    InputError : periods that make no chain
    """
    weights = _hierarchy(periods_px) if code == HIERARCHICAL else _beats(periods_px)
    inverses = [sum(c / p for c, p in zip(row, periods_px, strict=True)) for row in weights]
    if any(value <= 0.0 for value in inverses) or inverses != sorted(inverses):
        raise InputError(
            f"patterns periods {periods_px} px have no falling beat periods; heterodyne needs"
            " p0 < p1 (< p2) and 1/p0 - 2/p1 + 1/p2 > 0, change further_periods_px"
        )
    return Chain(weights, tuple(1.0 / value for value in inverses))


def _hierarchy(periods_px: tuple[float, ...]) -> tuple[tuple[int, ...], ...]:
    order = sorted(range(len(periods_px)), key=lambda j: -periods_px[j])
    if order[-1] != 0 or len(set(periods_px)) != len(periods_px):
        raise InputError(
            f"patterns periods {periods_px} px: hierarchical needs period_px below all of"
            " further_periods_px, and no period twice"
        )
    return tuple(tuple(int(j == k) for k in range(len(periods_px))) for j in order)


def _beats(periods_px: tuple[float, ...]) -> tuple[tuple[int, ...], ...]:
    if len(periods_px) not in BEATS:
        raise InputError(
            f"patterns heterodyne has {len(periods_px)} periods; give one or two further_periods_px"
        )
    return BEATS[len(periods_px)]


@lru_cache
def least_distance(periods_px: tuple[float, ...], length_px: int) -> float:
    """Return by what the single images of the most similar two fringes differ, of the modulation.

    At any phase that both have; root of the sum of squares over the images.
    """
    fringes = np.arange(math.ceil(length_px / periods_px[0]))
    least = np.inf
    for phase in np.arange(_NODES_PER_PERIOD) / _NODES_PER_PERIOD:
        x_px = periods_px[0] * (phase + fringes[:, None])
        shown = np.cos(2.0 * np.pi * x_px / np.array(periods_px[1:]))
        apart = np.square(shown[:, None] - shown).sum(axis=-1)
        least = min(least, float(apart[np.triu_indices(len(fringes), 1)].min(initial=np.inf)))
    return math.sqrt(least)
