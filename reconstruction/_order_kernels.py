"""Number the fringes of one image row: Gray word and phase give the projector coordinate.

Symbols: K fringe order; the word is the half-period index when complementary, else the period.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import Any, NamedTuple

import numpy as np

from reconstruction._jit import compiled, inlined
from reconstruction.mask import Reason

ORDER_UNCERTAIN = int(Reason.ORDER_UNCERTAIN)
OUTSIDE_PROJECTOR = int(Reason.OUTSIDE_PROJECTOR)
PER_TURN = 0.5 / np.pi
# In the middle of a half-period (within 1/16 of a period) the word must agree with the phase.
MIDDLE_TURNS = 1.0 / 16.0


class Code(NamedTuple):
    """What was projected; pairs are (column, row)."""

    period_px: float
    steps: int
    complementary: bool
    words: tuple[int, int]
    bits: tuple[int, int]
    length_px: tuple[int, int]


@inlined
def _order(word: Any, phi_turns: float, complementary: bool) -> Any:
    """Return K: half-period rule away from the edge of the word that was read."""
    if not complementary:
        return word
    if phi_turns < 0.25:
        return (word + 1) >> 1
    return word >> 1 if phi_turns < 0.75 else ((word + 1) >> 1) - 1


@inlined
def _binary(gray: Any) -> Any:
    gray ^= gray >> 16
    gray ^= gray >> 8
    gray ^= gray >> 4
    gray ^= gray >> 2
    return gray ^ (gray >> 1)


@inlined
def _is_certain(gray: Any, weak: Any, phi_turns: float, code: Code, axis: int) -> bool:
    """Tell whether no doubtful bit and no contradiction can change the order."""
    word = _binary(gray)
    if word >= code.words[axis]:
        return False
    if code.complementary:
        expected = 0 if phi_turns < 0.5 else 1
        distance = abs(phi_turns - 0.25 - 0.5 * expected)
        if distance < MIDDLE_TURNS and (word & 1) != expected:
            return False
    order = _order(word, phi_turns, code.complementary)
    for bit in range(code.bits[axis] if weak else 0):
        other = _binary(gray ^ (1 << bit))
        if (weak >> bit) & 1 and _order(other, phi_turns, code.complementary) != order:
            return False
    return True


@compiled
def number_row(
    axis: int, code: Code, word: Any, weak: Any, phase_rad: Any, order: Any, coordinate_px: Any,
    reason: Any,
) -> None:  # fmt: skip
    """Set order and coordinate of pixels that are still valid, or the reason why not."""
    last = code.length_px[axis] - 0.5
    for col in range(reason.size):
        if reason[col] != 0 and reason[col] < ORDER_UNCERTAIN:
            continue
        gray, turns = np.int64(word[col]), phase_rad[col] * PER_TURN
        if not _is_certain(gray, np.int64(weak[col]), turns, code, axis):
            reason[col] = ORDER_UNCERTAIN
            continue
        order[col] = _order(_binary(gray), turns, code.complementary)
        coordinate = code.period_px * (order[col] + turns)
        coordinate_px[col] = coordinate
        inside = -0.5 <= coordinate <= last
        if not inside and (reason[col] == 0 or reason[col] > OUTSIDE_PROJECTOR):
            reason[col] = OUTSIDE_PROJECTOR
