"""Number the fringes of one image row by Gray code; `_chain` does so by a chain of periods.

A word is the sequence of bits that a pixel reads from the Gray frames; it numbers a cell. A cell is
one period of the projector image between the ends of Gray stripes. Symbols: x coordinate, px, a
whole number at the centre of a projector pixel. c = x / period + 1 / (2 period) is the cell
coordinate, a whole number where a Gray stripe ends, at the border of two projector pixels. K is the
whole part of c.
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
# Within 1/16 of a period about the middle of a half cell, all words must agree with the phase.
MIDDLE_TURNS = np.float32(1.0 / 16.0)
LOWER, HALF, UPPER, ONE = np.float32(0.25), np.float32(0.5), np.float32(0.75), np.float32(1.0)
# A bit further than this many sigmas from its threshold is certain (error probability 6e-16).
NEAR_SIGMAS = 8.0
ROOT = math.sqrt(2.0)
PLAIN, COMPLEMENTARY, SHIFTED = 0, 1, 2
ZERO, BIT, TWO = np.uint32(0), np.uint32(1), np.uint32(2)
SHIFTS = (np.uint32(16), np.uint32(8), np.uint32(4), np.uint32(2))
NONE, STEP = np.int32(0), np.int32(1)
NOTHING, INFINITE = np.float32(0.0), np.float32(np.inf)
# Coordinate of the left edge of the first projector pixel.
FIRST = np.float32(-0.5)
TINY = 1e-12
# Distance from a border, in periods, within which the phase decides between two PLAIN words.
BORDER_TURNS = np.float32(1.0 / 8.0)
MOST_LOG = 700.0


class Word(NamedTuple):
    """Gray words of one image row along one axis, and their thresholds; every field is (col,)."""

    gray: Any  # uint32, first frame in the highest bit
    nearest: Any  # smallest distance of a level from its threshold, DN
    mean: Any  # threshold, DN
    margin: Any  # a level within this distance of the threshold is not certain, DN


class FringeRow(NamedTuple):
    """Fringe phase of one image row along one axis; every field is (col,) float32."""

    phase: Any  # rad
    sigma: Any  # rad, including all uncertainty of the phase
    modulation: Any  # DN


class Numbered(NamedTuple):
    """Coordinates of one image row along one axis; every field is (col,) float32."""

    coordinate: Any  # px
    sigma: Any  # px
    error: Any  # probability of a wrong order


class Code(NamedTuple):
    """Description of the Gray code along one projector axis.

    kind is PLAIN (one word per period), COMPLEMENTARY (one word per half period) or SHIFTED (two
    words, displaced by half a period). period_high_px has so few digits that its product with an
    order is exact in single precision; period_low_px is the rest of the period.
    """

    kind: int
    period_px: float
    period_high_px: np.float32
    period_low_px: np.float32
    half_px_turns: np.float32  # half a projector pixel, in periods
    words: np.int32  # number of different first words
    bits: int  # number of Gray frames, for all words
    safety_bits: np.uint32  # SHIFTED: number of bits of the second word
    length_px: int
    gray_of: Any  # (2^bits) uint32, Gray word of the bits as read; empty: they are a Gray word
    is_word: bool  # True if there is no phase: the word gives the coordinate, one period wide
    first_inverse: int  # stack index of the first inverse frame; -1: none, the threshold is `mean`


@inlined
def reflected(word: Any, code: Code) -> Any:
    """Return the reflected Gray word for a word as it was read, in the encoding of `code`."""
    read = np.uint32(word)
    return code.gray_of[read] if code.gray_of.size else read


@nested
def reflect_row(code: Code, word: Any, gray: Any) -> None:
    """Write the reflected Gray words, (col,), for words as they were read."""
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
    """Return the position within the cell, in periods, and 1 if the cell is that of the next order.

    The phase starts half a projector pixel after the start of the cell. The end of a period of the
    phase is therefore already in the next cell.
    """
    cell = phase * PER_TURN + code.half_px_turns
    over = STEP if cell >= ONE else NONE
    return cell - np.float32(over), over


@inlined
def _off_middle(cell: Any) -> Any:
    """Return the distance, in periods, of a position from the middle of its half of the cell."""
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
    """Return the order K, and True if the words contradict the phase or each other."""
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
    """Write the words of one row as read, and the smallest distance of a bit from its threshold.

    The distance is in DN. Without inverse frames the threshold is `read.mean`. With inverse frames
    it is the level of the inverse frame, and the distance is half the difference of the two.
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
    """Move coordinates from the first pixel of each word to its middle, and write their sigma.

    For a code without fringes, with words of p pixels. The stripe of word w starts at w p - 1/2,
    because x is whole at the centre of a pixel. Sigma is p / sqrt(12), the standard deviation of
    the uniform distribution. The end of the projector image may cut off the last word.
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
    """Write order and coordinate, px, from word and phase of every pixel of one row.

    The error probability is 1 where the words contradict the phase or each other, else 0.
    """
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
    """Return the distance of a bit from its threshold, DN; `bit` 0 is the last one of the word."""
    stack, place = frames.stack, code.bits - 1 - bit
    level = np.float32(stack[frames.first + place, frames.row, col])
    if code.first_inverse < 0:
        return abs(level - mean)
    return HALF * abs(level - np.float32(stack[code.first_inverse + place, frames.row, col]))


@nested
def weigh_near_bits(
    code: Code, frames: RowFrames, gray_sigmas: Any, read: Word, phase: Any, order: Any, error: Any
) -> None:
    """Add to `error` the probability that a misread bit has changed the order, for one row.

    Only bits within `read.margin` of their threshold can be misread. A bit counts if the order
    depends on it. If such a bit is within `gray_sigmas` of its threshold, `error` becomes 1.
    """
    word, nearest, mean, margin = read
    # At the border of two words either word is wrong by half a word only, which sigma includes.
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
            # `settle_borders` handles neighbouring orders at the border of two PLAIN words.
            if off == STEP and is_settled and min(cell, ONE - cell) < BORDER_TURNS:
                continue
            if off > allowed:
                sigmas = NEAR_SIGMAS * distance / margin[col]
                total += _tail(sigmas) if sigmas >= gray_sigmas else 1.0
        error[col] = min(error[col] + total, 1.0)


@inlined
def _bit_between(low: Any, code: Code) -> int:
    """Return the bit that differs between the Gray words of `low` and `low` + 1; last bit: 0."""
    # Reflected code: the place of the lowest 0 of the lower word.
    bit = 0
    while bit < code.bits - 1 and (low >> bit) & 1:
        bit += 1
    return bit


@inlined
def _misread(far: Any, near: Any, contrast: Any, noise: Any) -> Any:
    """Return the log likelihood ratio of the word as read to the neighbouring word.

    Near the border of two words only the bit that flips at this border may have a level between
    white and black. Two bits are candidates: `near` flips at the border nearest to the pixel if the
    word was read correctly, `far` if it was misread. The other of the two then has its full
    contrast. The ratio is one of profile likelihoods: the level of the flipping bit is only assumed
    to be between white and black.

    far, near : distances of the two bits from their threshold, DN
    contrast, noise : full distance of a bit from its threshold, and its sigma, DN
    """
    off_far, off_near = min(far, contrast) - contrast, min(near, contrast) - contrast
    return (far * far + off_near * off_near - off_far * off_far) / (2.0 * noise * noise)


@nested
def settle_borders(
    code: Code, frames: RowFrames, read: Word, fringe: FringeRow, order: Any, answer: Numbered
) -> None:
    """Decide by the phase on which side of the border of two words of kind PLAIN a pixel is.

    At the border one bit flips and the phase wraps, with independent noise. A stripe edge that the
    projector's response or blur displaced is misread even without noise. The levels of the two bits
    that flip at the two ends of the word determine at which end the pixel is. The error probability
    is that of confusing the two ends. If neither bit has a level between white and black, the
    probability that noise moved the phase over the border is added.
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
    """Add to `error` the probability that noise moved the phase over the end of a PLAIN word."""
    for col in range(error.size):
        cell, _ = _cell(phase[col], code)
        to_border_rad = TURN * min(cell, ONE - cell)
        if to_border_rad < NEAR_SIGMAS * sigma[col]:
            error[col] = min(error[col] + _tail(to_border_rad / sigma[col]), 1.0)


@nested
def settle_row(
    length_px: int, max_order_error: Any, answer: Numbered, usable: Any, reason: Any
) -> None:
    """Write the reasons of pixels with an uncertain order or a coordinate outside the projector.

    A reason with a smaller code than the new one is kept. For a pixel without a phase, the reason
    is unchanged and `error` becomes 0.
    """
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
    """Copy the values of one row to `out`; masked pixels become 0."""
    for col in range(reason.size):
        out[col] = values[col] if reason[col] == VALID else NOTHING
