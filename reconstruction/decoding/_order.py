"""Number the fringes of one image row by Gray words; by a chain of fringe periods: `_chain`.

Symbols: K fringe order of the cell coordinate c = x / period + 1 / (2 period), which is whole where
a Gray stripe ends, at the border of a projector pixel; x is whole at its centre.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

import math
from typing import Any, NamedTuple

import numpy as np

from reconstruction.arrays import Reason
from reconstruction.compiling import inlined, nested
from reconstruction.decoding._rows import smaller
from reconstruction.decoding._sum import RowFrames

ORDER_UNCERTAIN = np.uint8(Reason.ORDER_UNCERTAIN)
OUTSIDE_PROJECTOR = np.uint8(Reason.OUTSIDE_PROJECTOR)
VALID = np.uint8(Reason.VALID)
PER_TURN = np.float32(0.5 / np.pi)
TURN = 2.0 * np.pi
# Far from the edges of all words (within 1/16 of a period) they must agree with the phase.
MIDDLE_TURNS = np.float32(1.0 / 16.0)
LOWER, HALF, UPPER, ONE = np.float32(0.25), np.float32(0.5), np.float32(0.75), np.float32(1.0)
# Sigmas from the threshold beyond which a bit is certain: 6e-16.
NEAR_SIGMAS = 8.0
ROOT = math.sqrt(2.0)
PLAIN, COMPLEMENTARY, SHIFTED = 0, 1, 2
ZERO, BIT, TWO = np.uint32(0), np.uint32(1), np.uint32(2)
SHIFTS = (np.uint32(16), np.uint32(8), np.uint32(4), np.uint32(2))
NONE, STEP = np.int32(0), np.int32(1)
NOTHING, INFINITE = np.float32(0.0), np.float32(np.inf)
# Left edge of the first projector pixel.
FIRST = np.float32(-0.5)
TINY = 1e-12
# Distance from a border, in periods, within which the phase decides between two plain words.
BORDER_TURNS = np.float32(1.0 / 8.0)
MOST_LOG = 700.0


class Word(NamedTuple):
    """The Gray word of one row along one axis, lines of (col)."""

    gray: Any  # uint32, first frame in the highest bit
    nearest: Any  # smallest distance of a level from its threshold, DN
    mean: Any
    margin: Any  # nearer levels are not certain, DN


class FringeRow(NamedTuple):
    """Result of the fringes for one row along one axis, lines of (col) float32."""

    phase: Any  # rad
    sigma: Any  # rad, including all uncertainty of the phase
    modulation: Any  # DN


class Numbered(NamedTuple):
    """Coordinates of one row along one axis, lines of (col) float32."""

    coordinate: Any  # px
    sigma: Any  # px
    error: Any  # probability of a wrong order


class Code(NamedTuple):
    """The projected code along one axis.

    period_high_px has so few digits that its product with an order is exact in single precision;
    period_low_px is the rest.
    """

    kind: int
    period_px: float
    period_high_px: np.float32
    period_low_px: np.float32
    half_px_turns: np.float32
    words: np.int32
    bits: int
    safety_bits: np.uint32
    length_px: int
    gray_of: Any  # (2^bits) uint32, Gray word of the bits as read; empty: they are a Gray word
    is_word: bool  # there is no phase: the word is the coordinate, a period wide
    first_inverse: int  # of the stack, most significant bit first; -1: none, bits against the mean


@inlined
def reflected(word: Any, code: Code) -> Any:
    """Return the Gray word of bits as they were read."""
    read = np.uint32(word)
    return code.gray_of[read] if code.gray_of.size else read


@nested
def reflect_row(code: Code, word: Any, gray: Any) -> None:
    """Write the Gray words of bits as they were read."""
    for col in range(word.size):
        gray[col] = reflected(word[col], code)


@inlined
def _binary(gray: Any) -> Any:
    # Typed shifts: with Python's integers every step would be 64 bits wide.
    word = np.uint32(gray)
    word ^= word >> SHIFTS[0]
    word ^= word >> SHIFTS[1]
    word ^= word >> SHIFTS[2]
    word ^= word >> SHIFTS[3]
    return word ^ (word >> BIT)


@inlined
def _cell(phase: Any, code: Code) -> Any:
    """Return the position within the cell, in periods, and 1 if that cell is the next one."""
    cell = phase * PER_TURN + code.half_px_turns
    over = STEP if cell >= ONE else NONE
    return cell - np.float32(over), over


@inlined
def _off_middle(cell: Any) -> Any:
    """Return the distance from the middle of this half of the cell, where words must agree."""
    return abs(cell - (UPPER if cell >= HALF else LOWER))


@inlined
def _number_plain(gray: Any, cell: Any, code: Code) -> Any:
    word = np.int32(_binary(gray))
    return word, word >= code.words


@inlined
def _number_complementary(gray: Any, cell: Any, code: Code) -> Any:
    word = np.int32(_binary(gray))
    late, second_half = STEP if cell >= UPPER else NONE, STEP if cell >= HALF else NONE
    order = ((word + (STEP if cell < LOWER else late)) >> STEP) - late
    is_torn = (_off_middle(cell) < MIDDLE_TURNS) & ((word & STEP) != second_half)
    return order, (word >= code.words) | is_torn


@inlined
def _number_shifted(gray: Any, cell: Any, code: Code) -> Any:
    first = np.int32(_binary(gray >> code.safety_bits))
    second = np.int32(_binary(gray & ((BIT << code.safety_bits) - BIT)))
    late, second_half = STEP if cell >= UPPER else NONE, STEP if cell >= HALF else NONE
    order = first if (cell >= LOWER) & (cell < UPPER) else second - late
    step = second - first
    is_split = (_off_middle(cell) < MIDDLE_TURNS) & (step != second_half)
    return order, (first >= code.words) | (step < NONE) | (step > STEP) | is_split


@inlined
def _number(gray: Any, cell: Any, code: Code) -> Any:
    """Return K and whether the words contradict the phase or each other."""
    if code.kind == COMPLEMENTARY:
        return _number_complementary(gray, cell, code)
    if code.kind == SHIFTED:
        return _number_shifted(gray, cell, code)
    return _number_plain(gray, cell, code)


@nested
def _read_two_bits(
    a: Any, b: Any, threshold_a: Any, threshold_b: Any, factor: Any, word: Any, nearest: Any
) -> None:
    for col in range(word.size):
        least = nearest[col]  # read before the first write, see `_add_six`
        high = factor * (np.float32(a[col]) - np.float32(threshold_a[col]))
        low = factor * (np.float32(b[col]) - np.float32(threshold_b[col]))
        bright = (TWO if high > NOTHING else ZERO) | (BIT if low > NOTHING else ZERO)
        word[col] = (word[col] << TWO) | bright
        nearest[col] = smaller(smaller(abs(high), abs(low)), least)


@nested
def _read_bit(frame: Any, threshold: Any, factor: Any, word: Any, nearest: Any) -> None:
    for col in range(word.size):
        least = nearest[col]
        over = factor * (np.float32(frame[col]) - np.float32(threshold[col]))
        word[col] = (word[col] << BIT) | (BIT if over > NOTHING else ZERO)
        nearest[col] = smaller(abs(over), least)


@nested
def read_word_row(frames: RowFrames, code: Code, read: Word) -> None:
    """Write the bits as read, and the smallest distance of a bit from its threshold, DN.

    The threshold is the mean; of pairs of frames it is the inverse frame, at half the difference.
    """
    stack, first, row = frames
    word, nearest, mean, inverse = read.gray, read.nearest, read.mean, code.first_inverse
    for col in range(word.size):
        word[col], nearest[col] = ZERO, INFINITE
    for bit in range(0, code.bits - 1, 2):
        a, b = stack[first + bit, row], stack[first + bit + 1, row]
        if inverse < 0:
            _read_two_bits(a, b, mean, mean, ONE, word, nearest)
        else:
            c, d = stack[inverse + bit, row], stack[inverse + bit + 1, row]
            _read_two_bits(a, b, c, d, HALF, word, nearest)
    if code.bits % 2:
        last = code.bits - 1
        if inverse < 0:
            _read_bit(stack[first + last, row], mean, ONE, word, nearest)
        else:
            _read_bit(stack[first + last, row], stack[inverse + last, row], HALF, word, nearest)


@nested
def place_words(code: Code, answer: Numbered) -> None:
    """Move coordinates from the first pixel of each word to its middle; sigma: uniform.

    The edge of a stripe is at w p - 1/2, because x is whole at the centre of a pixel.
    p / sqrt(12) is the standard deviation of the uniform distribution. The last
    word may be cut off by the end of the image.
    """
    end = np.float32(code.length_px - 0.5)
    middle = np.float32(0.5 * (code.period_px - 1.0))
    spread = np.float32(code.period_px / math.sqrt(12.0))
    coordinate, sigma = answer.coordinate, answer.sigma
    for col in range(sigma.size):
        first = coordinate[col]
        cut = HALF * (first - HALF + end)
        coordinate[col] = cut if (first + middle > end) & (cut < end) else first + middle
        sigma[col] = spread


@nested
def number_row(code: Code, word: Any, phase: Any, order: Any, answer: Numbered) -> None:
    """Write order and coordinate as read, and error probability 1 where words contradict."""
    coordinate, error = answer.coordinate, answer.error
    # The code is chosen outside the loops: otherwise they do not become vector code.
    if code.kind == COMPLEMENTARY:
        for col in range(word.size):
            cell, over = _cell(phase[col], code)
            number, is_wrong = _number_complementary(word[col], cell, code)
            order[col], error[col] = number - over, ONE if is_wrong else NOTHING
    elif code.kind == SHIFTED:
        for col in range(word.size):
            cell, over = _cell(phase[col], code)
            number, is_wrong = _number_shifted(word[col], cell, code)
            order[col], error[col] = number - over, ONE if is_wrong else NOTHING
    else:
        for col in range(word.size):
            cell, over = _cell(phase[col], code)
            number, is_wrong = _number_plain(word[col], cell, code)
            order[col], error[col] = number - over, ONE if is_wrong else NOTHING
    high, low, per_rad = code.period_high_px, code.period_low_px, np.float32(code.period_px / TURN)
    for col in range(word.size):
        number = np.float32(order[col])
        coordinate[col] = high * number + (low * number + per_rad * phase[col])


@inlined
def _tail(sigmas: float) -> float:
    return 0.5 * math.erfc(sigmas / ROOT)


@inlined
def _distance(code: Code, frames: RowFrames, bit: int, col: int, mean: Any) -> Any:
    """Return how far a bit, counted from the last, is from its threshold, DN."""
    stack, place = frames.stack, code.bits - 1 - bit
    level = np.float32(stack[frames.first + place, frames.row, col])
    if code.first_inverse < 0:
        return abs(level - mean)
    return HALF * abs(level - np.float32(stack[code.first_inverse + place, frames.row, col]))


@nested
def weigh_near_bits(
    code: Code, frames: RowFrames, gray_sigmas: Any, read: Word, phase: Any, order: Any, error: Any
) -> None:
    """Add the probability that a bit near its threshold was misread, if the order depends on it.

    If such a bit is within `gray_sigmas` of its threshold the order is uncertain.
    """
    word, nearest, mean, margin = read
    # At the border of two words both are half a word off, which sigma includes.
    allowed = STEP if code.is_word else NONE
    is_settled = (code.kind == PLAIN) & (code.gray_of.size == 0) & (not code.is_word)
    for col in range(word.size):
        if not nearest[col] < margin[col] or error[col] == ONE:
            continue
        cell, over = _cell(phase[col], code)
        total = 0.0
        for bit in range(code.bits):
            distance = _distance(code, frames, bit, col, mean[col])
            if not distance < margin[col]:  # in this form a NaN is not near
                continue
            flipped = reflected(word[col] ^ (BIT << np.uint32(bit)), code)
            neighbour, _ = _number(flipped, cell, code)
            off = abs(neighbour - over - order[col])
            # Neighbours at the border of plain words are settled by `settle_borders`.
            if off == STEP and is_settled and min(cell, ONE - cell) < BORDER_TURNS:
                continue
            if off > allowed:
                sigmas = NEAR_SIGMAS * distance / margin[col]
                total += _tail(sigmas) if sigmas >= gray_sigmas else 1.0
        error[col] = min(error[col] + total, 1.0)


@inlined
def _bit_between(low: Any, code: Code) -> int:
    """Return the bit, from the last, that flips between the Gray words of `low` and the next."""
    # Reflected code: the place of the lowest 0 of the lower word.
    bit = 0
    while bit < code.bits - 1 and (low >> bit) & 1:
        bit += 1
    return bit


@inlined
def _misread(far: Any, near: Any, contrast: Any, noise: Any) -> Any:
    """Return the log likelihood ratio of the word as read and its neighbour.

    A pixel near the border of two plain words has one bit between its levels: that of this border.
    If the word was read correctly it is the near bit. If the second bit was misread it is the far
    bit, and the near bit has its full contrast. Profile likelihood: the level is only assumed to be
    between the levels of the edge.

    far, near : distances of the two bits from their threshold, DN
    """
    off_far, off_near = min(far, contrast) - contrast, min(near, contrast) - contrast
    return (far * far + off_near * off_near - off_far * off_far) / (2.0 * noise * noise)


@nested
def settle_borders(
    code: Code, frames: RowFrames, read: Word, fringe: FringeRow, order: Any, answer: Numbered
) -> None:
    """Decide by the phase on which side of the border of two plain words a pixel is.

    There the bit that flips and the phase that wraps have independent noise, and an edge that the
    projector's response or blur displaced is misread even without noise. The levels of the two bits
    next to the word determine which border it is. The error probability is that of confusing them
    and, if neither bit is between its levels, that of noise moving the phase over the border.
    """
    mean, margin = read.mean, read.margin
    step_px = np.float32(code.period_px)
    for col in range(order.size):
        cell, over = _cell(fringe.phase[col], code)
        turns = min(cell, ONE - cell)
        if turns >= BORDER_TURNS or answer.error[col] == ONE:
            continue
        word = order[col] + over
        toward = STEP if cell < HALF else -STEP
        beyond, before = word + toward, word - toward
        # In this form a NaN counts as saturated.
        contrast = max(fringe.modulation[col], TINY)
        noise = max(margin[col] / NEAR_SIGMAS, TINY)
        far, near = contrast, contrast
        if (beyond >= 0) & (beyond < code.words):
            far = _distance(code, frames, _bit_between(min(word, beyond), code), col, mean[col])
        if (before >= 0) & (before < code.words):
            near = _distance(code, frames, _bit_between(min(word, before), code), col, mean[col])
        likelier = _misread(far, near, contrast, noise)
        if likelier < 0.0:
            order[col] += toward
            answer.coordinate[col] += step_px * np.float32(toward)
        wrong = 1.0 / (1.0 + math.exp(min(abs(likelier), MOST_LOG)))
        if (far > HALF * contrast) & (near > HALF * contrast):
            wrong += _tail(TURN * turns / max(fringe.sigma[col], TINY))
        answer.error[col] = min(wrong, 1.0)


@nested
def weigh_wrap(code: Code, phase: Any, sigma: Any, error: Any) -> None:
    """Add the probability that noise moved the phase over the end of a plain Gray word."""
    for col in range(error.size):
        cell, _ = _cell(phase[col], code)
        to_border_rad = TURN * min(cell, ONE - cell)
        if to_border_rad < NEAR_SIGMAS * sigma[col]:
            error[col] = min(error[col] + _tail(to_border_rad / sigma[col]), 1.0)


@nested
def settle_row(
    length_px: int, max_order_error: Any, answer: Numbered, usable: Any, reason: Any
) -> None:
    """Mark uncertain orders and coordinates outside the projector; no phase, no probability."""
    coordinate, error = answer.coordinate, answer.error
    last, most = np.float32(length_px - 0.5), np.float32(max_order_error)
    for col in range(reason.size):
        code = reason[col]
        has_phase = usable[col] > 0.0
        is_inside = (coordinate[col] >= FIRST) & (coordinate[col] <= last)
        is_doubtful = (error[col] > most) | (error[col] >= ONE)
        new_code = VALID if is_inside else OUTSIDE_PROJECTOR
        new_code = ORDER_UNCERTAIN if is_doubtful else new_code
        is_lower = has_phase & (new_code != VALID) & ((code == VALID) | (code > new_code))
        reason[col] = new_code if is_lower else code
        error[col] *= usable[col]


@nested
def write_valid(values: Any, reason: Any, out: Any) -> None:
    """Copy a row; masked pixels become 0."""
    for col in range(reason.size):
        out[col] = values[col] if reason[col] == VALID else NOTHING
