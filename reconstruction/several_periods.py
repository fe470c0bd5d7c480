"""Temporal phase unwrapping with several fringe periods, by levels from coarse to fine.

Fringe set j has the phase phi_j and the period p_j. Level i has the phase
Phi_i = sum_j (c_ij phi_j) and the period P_i = 1 / sum_j (c_ij / p_j). The phase of level i - 1
gives the period index k of level i: k = round(P_(i-1) Phi_(i-1) / P_i - Phi_i), all phases in
turns. Source: Zuo et al., Opt. Lasers Eng. 85, 84 (2016), hierarchical and heterodyne (there
"multi-wavelength") temporal phase unwrapping.
"""

from dataclasses import dataclass

from reconstruction.errors import InputError


@dataclass(frozen=True)
class Chain:
    """Levels of temporal phase unwrapping, from the coarsest, unambiguous level to fringe set 0.

    Parameters
    ----------
    weights : (level, fringe set), whole numbers c_ij: level i has the phase sum_j (c_ij phi_j),
        with phi_j the phase of fringe set j
    periods_px : (level,), the period P_i of each level, projector px, decreasing
    """

    weights: tuple[tuple[int, ...], ...]
    periods_px: tuple[float, ...]


def make_chain(weights: tuple[tuple[int, ...], ...], periods_px: tuple[float, ...]) -> Chain:
    """Return the chain of levels with the given weights and fringe periods.

    Parameters
    ----------
    weights : (level, fringe set), whole numbers c_ij
    periods_px : (fringe set,), px, the measuring period first

    Raises
    ------
    InputError : the periods of the levels are not positive and decreasing
    """
    inverses = [sum(c / p for c, p in zip(row, periods_px, strict=True)) for row in weights]
    if any(value <= 0.0 for value in inverses) or inverses != sorted(inverses):
        raise InputError(
            f"patterns periods {periods_px} px have no decreasing beat periods; heterodyne needs"
            " p0 < p1 (< p2) and 1/p0 - 2/p1 + 1/p2 > 0, change further_periods_px"
        )
    return Chain(weights, tuple(1.0 / value for value in inverses))


def require_range(chain: Chain, periods_px: tuple[float, ...], length_px: int) -> None:
    """Raise InputError unless the period of the coarsest level is at least `length_px`."""
    # A beat period computed from whole pixels may miss a whole number by rounding.
    if chain.periods_px[0] < length_px * (1.0 - 1e-9):
        raise InputError(
            f"patterns periods {periods_px} px are unambiguous over {chain.periods_px[0]:.6g} px,"
            f" the image has {length_px}; change further_periods_px"
        )
