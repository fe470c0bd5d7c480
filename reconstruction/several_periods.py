"""Several fringe periods that give one absolute coordinate by a chain of levels, coarse to fine.

With the phase phi_j of fringe set j and its period p_j, the phase of level i is sum_j c_ij phi_j,
its period P_i = 1 / sum_j c_ij / p_j. Each level numbers the periods of the next one:
k = round(P_(i-1) Phi_(i-1) / P_i - Phi_i), phases in turns. Zuo et al., Opt. Lasers Eng. 85, 84
(2016): hierarchical and heterodyne (there "multi-wavelength") temporal phase unwrapping.
"""

from dataclasses import dataclass

from reconstruction.errors import InputError


@dataclass(frozen=True)
class Chain:
    """Levels from the coarsest, which is unambiguous, to fringe set 0.

    Parameters
    ----------
    weights : (level, set), whole numbers c_ij
    periods_px : (level,), decreasing
    """

    weights: tuple[tuple[int, ...], ...]
    periods_px: tuple[float, ...]


def make_chain(weights: tuple[tuple[int, ...], ...], periods_px: tuple[float, ...]) -> Chain:
    """Return the chain of some periods; the measuring period comes first.

    Raises
    ------
    InputError : the periods form no chain
    """
    inverses = [sum(c / p for c, p in zip(row, periods_px, strict=True)) for row in weights]
    if any(value <= 0.0 for value in inverses) or inverses != sorted(inverses):
        raise InputError(
            f"patterns periods {periods_px} px have no decreasing beat periods; heterodyne needs"
            " p0 < p1 (< p2) and 1/p0 - 2/p1 + 1/p2 > 0, change further_periods_px"
        )
    return Chain(weights, tuple(1.0 / value for value in inverses))


def require_range(chain: Chain, periods_px: tuple[float, ...], length_px: int) -> None:
    """Raise InputError unless the coarsest level spans `length_px`."""
    # A beat period computed from whole pixels may miss a whole number by rounding.
    if chain.periods_px[0] < length_px * (1.0 - 1e-9):
        raise InputError(
            f"patterns periods {periods_px} px are unambiguous over {chain.periods_px[0]:.6g} px,"
            f" the image has {length_px}; change further_periods_px"
        )
