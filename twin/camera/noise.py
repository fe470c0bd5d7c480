"""Compiled kernel that records one frame with noise, row by row.

Every pixel of every frame has its own random numbers, computed from its indices. Threefry 4x32-20
(Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3") gives blocks of four random
32-bit words from a key and the counter (i, row, frame, kind). In a row of n columns, block i has
two words for column i and two for column n/2 + i. Therefore rows and frames can be recorded in any
order and by any number of threads. The two words of kind 0 give two independent normal numbers (Box
and Muller 1958), for shot and read noise. The words of kind 1 are used for small counts.

For means of at least `FROM_NORMAL` electrons, a Poisson number is computed from a normal number by
the Cornish-Fisher expansion of the Poisson quantile to the third cumulant order. The variance is
reduced by the 1/12 that rounding to whole electrons adds (Sheppard). The total variation distance
from the Poisson distribution is 1.6e-5 for means of at least 100, and 5e-7 from 1000 on: a test
needs billions of numbers of one pixel to detect it. For smaller means a Poisson number is drawn by
inversion with the 32 bits of a word. It is the sum of two Poisson numbers: a tabulated number for
the mean rounded down to 1/8 electron, and a number for the remaining mean.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

import math
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import pdtr

from reconstruction.arrays import FloatImage
from reconstruction.compiling import NESTED, OPTIONS, Function, compile_and_keep, digest_of_sources

#: Smallest mean, in electrons, for which normal numbers are used.
FROM_NORMAL = 100

_SOURCE_DIGEST = digest_of_sources(Path(__file__).parent, ("noise.py",))
# Sizes of the tables of small counts; the probability of a count beyond the last is below 2^-32.
_STEPS_PER_ELECTRON, _COUNTS, _BUCKET_BITS = 8, 192, 8
# Number of blocks of random words that are computed together for small counts.
_CHUNK = 64

_F = np.float32
_FROM_NORMAL, _STEPS = _F(FROM_NORMAL), _F(_STEPS_PER_ELECTRON)
_ZERO, _HALF, _ONE, _TWO, _72 = _F(0), _F(0.5), _F(1), _F(2), _F(72)
_6TH, _12TH, _LN_2 = _F(1 / 6), _F(1 / 12), _F(math.log(2.0))
_PER_WORD = _F(2.0**-32)
_EIGHTH_TURN_PER_WORD = _F(math.pi / 4.0 * 2.0**-31)
# Threefry 4x32: parity of the key, and the rotations of its eight rounds in bits.
_PARITY = np.uint32(0x1BD11BDA)
_TURNS = (10, 26, 11, 21, 13, 27, 23, 5, 6, 20, 17, 11, 25, 10, 18, 20)

Key = tuple[np.uint32, np.uint32, np.uint32, np.uint32]


class Sensor(NamedTuple):
    """Parameters of one camera for the compiled kernel.

    Attributes
    ----------
    per_radiance : electrons in one exposure per radiance, mW / (mm^2 sr)
    dark_e : mean dark electrons in one exposure
    """

    per_radiance: np.float32
    dark_e: np.float32
    full_well_e: np.float32
    read_noise_e: np.float32
    gain_dn_per_e: np.float32
    black_level_dn: np.float32
    largest_dn: np.float32


class SmallCounts(NamedTuple):
    """Tables of the Poisson distribution for means of 0 to `FROM_NORMAL` electrons, step 1/8.

    Attributes
    ----------
    ends : (mean, count) uint64
        A random 32-bit word below this value gives at most this count.
    first : (mean, bucket) uint8
        Count for the smallest word of a bucket; the highest 8 bits of a word are its bucket.
    """

    ends: NDArray[np.uint64]
    first: NDArray[np.uint8]


def _compiled(function: Function) -> Function:
    return compile_and_keep(function, OPTIONS, _SOURCE_DIGEST)


def _nested(function: Function) -> Function:
    return compile_and_keep(function, OPTIONS | NESTED, _SOURCE_DIGEST)


def _inlined(function: Function) -> Function:
    return compile_and_keep(function, OPTIONS | {"forceinline": True}, _SOURCE_DIGEST)


@cache
def small_counts() -> SmallCounts:
    """Return the tables by which random words give Poisson counts of small mean."""
    mean = np.arange(FROM_NORMAL * _STEPS_PER_ELECTRON + 1)[:, None] / _STEPS_PER_ELECTRON
    ends = np.rint(pdtr(np.arange(_COUNTS), mean) * 2.0**32).astype(np.uint64)
    ends[:, -1] = 1 << 32
    least = np.arange(1 << _BUCKET_BITS, dtype=np.uint64) << np.uint64(32 - _BUCKET_BITS)
    first = np.array([np.searchsorted(row, least, side="right") for row in ends])
    return SmallCounts(ends, first.astype(np.uint8))


def record_frame(
    radiance: FloatImage,
    response: FloatImage,
    offset_e: FloatImage,
    sensor: Sensor,
    place: tuple[Key, int],
    recorded: NDArray[np.uint16],
) -> None:
    """Record one frame: photons and dark current, full well, read noise, gain, converter.

    Parameters
    ----------
    radiance : (row, col) float32, mW / (mm^2 sr)
    response : (row, col) float32; relative response of the pixels
    offset_e : (row, col) float32; dark offset of the pixels, e-
    place : key and number of the frame, which determine its random numbers
    recorded : (row, col) uint16, DN; output, overwritten
    """
    (key, frame), pattern = place, (response, offset_e)
    # A copy: the kernel would be compiled again for arrays that are not contiguous.
    plain = np.ascontiguousarray(radiance, np.float32)
    lines = _lines(plain.shape[1])
    _record(plain, pattern, sensor, small_counts(), key, np.uint32(frame), lines, recorded)


class _RowScratch(NamedTuple):
    """Work arrays for one row of pixels, because compiled code allocates no arrays."""

    words: NDArray[np.uint32]
    few_words: NDArray[np.uint32]
    mean: FloatImage
    counts: FloatImage
    read: FloatImage


def _lines(cols: int) -> _RowScratch:
    mean, counts, read = (np.zeros(cols, np.float32) for _ in range(3))
    words, few_words = (np.zeros((2, n), np.uint32) for n in (cols + cols % 2, 2 * _CHUNK))
    return _RowScratch(words, few_words, mean, counts, read)


@_inlined
def _turned(word: Any, bits: int) -> Any:
    return np.uint32(np.uint32(word << np.uint32(bits)) | np.uint32(word >> np.uint32(32 - bits)))


@_inlined
def _mixed(word: Any, turns: Any) -> Any:
    """Return four words after four rounds of Threefry 4x32 with the rotations `turns`, in bits."""
    a, b, c, d = word
    for n in range(2):
        a, c = np.uint32(a + b), np.uint32(c + d)
        b, d = np.uint32(_turned(b, turns[4 * n]) ^ a), np.uint32(_turned(d, turns[4 * n + 1]) ^ c)
        a, c = np.uint32(a + d), np.uint32(c + b)
        d, b = (
            np.uint32(_turned(d, turns[4 * n + 2]) ^ a),
            np.uint32(_turned(b, turns[4 * n + 3]) ^ c),
        )
    return a, b, c, d


@_inlined
def _keyed(word: Any, key: Any, number: Any) -> Any:
    """Return four words after adding a key of four words, and `number` to the last word."""
    last = np.uint32(word[3] + key[3] + number)
    return (
        np.uint32(word[0] + key[0]),
        np.uint32(word[1] + key[1]),
        np.uint32(word[2] + key[2]),
        last,
    )


@_inlined
def threefry(counter: Any, key: Any) -> Any:
    """Return four random 32-bit words from a counter and a key of four words each (20 rounds)."""
    a, b, c, d = key
    e = np.uint32(_PARITY ^ a ^ b ^ c ^ d)
    word = _keyed(counter, (a, b, c, d), np.uint32(0))
    word = _keyed(_mixed(word, _TURNS[:8]), (b, c, d, e), np.uint32(1))
    word = _keyed(_mixed(word, _TURNS[8:]), (c, d, e, a), np.uint32(2))
    word = _keyed(_mixed(word, _TURNS[:8]), (d, e, a, b), np.uint32(3))
    word = _keyed(_mixed(word, _TURNS[8:]), (e, a, b, c), np.uint32(4))
    return _keyed(_mixed(word, _TURNS[:8]), (a, b, c, d), np.uint32(5))


@_inlined
def _log(x: Any) -> Any:
    """Return the natural logarithm of a positive normal float32, to 2 units in the last place.

    x = m 2^e with m in [sqrt(1/2), sqrt(2)); the polynomial of log(m) is that of Cephes' logf.
    """
    bits = np.float32(x).view(np.int32)
    # 0x3F3504F3 are the bits of sqrt(1/2).
    exponent = np.int32(np.int32(bits - np.int32(0x3F3504F3)) >> np.int32(23))
    m = np.int32(bits - np.int32(exponent << np.int32(23))).view(np.float32) - _ONE
    p = _F(7.0376836292e-2) * m - _F(1.1514610310e-1)
    p = p * m + _F(1.1676998740e-1)
    p = p * m - _F(1.2420140846e-1)
    p = p * m + _F(1.4249322787e-1)
    p = p * m - _F(1.6668057665e-1)
    p = p * m + _F(2.0000714765e-1)
    p = p * m - _F(2.4999993993e-1)
    p = p * m + _F(3.3333331174e-1)
    square = m * m
    return m + (p * m * square - _HALF * square) + _LN_2 * np.float32(exponent)


@_inlined
def normal_pair(word_0: Any, word_1: Any) -> Any:
    """Return two independent standard normal numbers from two words (Box and Muller 1958).

    The first word gives the radius, the second the angle: its two highest bits select one of four
    quarter turns, its other bits an angle within +- 1/8 turn.
    """
    radius = np.sqrt(-_TWO * _log((np.float32(word_0) + _HALF) * _PER_WORD))
    within = np.float32(np.uint32(word_1 << np.uint32(2)).view(np.int32)) * _EIGHTH_TURN_PER_WORD
    quarter = np.uint32(word_1 >> np.uint32(30))
    square = within * within
    # Polynomials of Cephes' sinf and cosf.
    sine = _F(-1.9515295891e-4) * square + _F(8.3321608736e-3)
    sine = within + within * square * (sine * square - _F(1.6666654611e-1))
    cosine = _F(2.443315711809948e-5) * square - _F(1.388731625493765e-3)
    cosine = (cosine * square + _F(4.166664568298827e-2)) * square * square
    cosine = cosine - _HALF * square + _ONE
    turned = (quarter & np.uint32(1)) == np.uint32(1)
    along, across = (sine, cosine) if turned else (cosine, sine)
    along = -along if turned else along
    sign = _ONE if quarter < np.uint32(2) else -_ONE
    return sign * radius * along, sign * radius * across


@_inlined
def count_of_normal(mean: Any, normal: Any) -> Any:
    """Return the Poisson number of a large mean at the quantile of a standard normal number."""
    spread = np.sqrt(max(mean, _ONE) - _12TH)
    square = normal * normal
    skew = (square - _ONE) * _6TH
    return np.rint(mean + spread * normal + skew + normal * (_ONE - square) / (_72 * spread))


@_inlined
def _small_count(mean: Any, word_0: Any, word_1: Any, tables: Any) -> Any:
    """Return a Poisson number of a mean below `FROM_NORMAL` from two words, by inversion."""
    # Indices without sign: no test whether they count from the end of the array.
    step, word = np.uint64(mean * _STEPS), np.uint64(word_0)
    count = np.uint64(tables.first[step, word_0 >> np.uint32(32 - _BUCKET_BITS)])
    # The first comparison is an addition: the processor often mispredicts a branch here.
    count += np.uint64(word >= tables.ends[step, count])
    while word >= tables.ends[step, count]:
        count += np.uint64(1)
    rest = float(mean) - float(step) * (1.0 / _STEPS_PER_ELECTRON)
    share = (float(word_1) + 0.5) * 2.0**-32
    if share >= 1.0 - rest:  # and therefore perhaps above exp(-rest)
        count += _count_of_rest(rest, share)
    return np.float32(count)


@_inlined
def _count_of_rest(mean: Any, share: Any) -> Any:
    """Return the Poisson number of a mean of at most 1/8 at which the distribution has `share`."""
    term = exp_of_small(-mean)
    below, count = term, 0
    while share > below:
        count += 1
        term *= mean / count
        below += term
    return np.uint64(count)


@_inlined
def exp_of_small(x: Any) -> Any:
    """Return exp(x) for |x| <= 1/8, to rounding: 12 terms of its series, faster than `np.exp`."""
    value = 1.0 + x * (1.0 / 12.0)
    for n in range(11, 0, -1):
        value = 1.0 + x * value * (1.0 / n)
    return value


@_nested
def _fill(words: Any, half: Any, key: Any, place: Any, first: Any) -> None:
    """Fill the words (2, 2 half) of blocks from `first` on; block i is for columns i, half + i.

    There are two words for each column.
    """
    row, frame, kind = place
    for i in range(half):
        block = threefry((np.uint32(first + i), row, frame, kind), key)
        words[0, i], words[1, i], words[0, half + i], words[1, half + i] = block


@_nested
def _expect(radiance: Any, response: Any, sensor: Any, mean: Any) -> Any:
    """Fill `mean` of one row with expected electrons; return the number of small means."""
    small = 0
    for col in range(mean.size):
        light_e = radiance[col] * sensor.per_radiance
        mean[col] = max(light_e * response[col] + sensor.dark_e, _ZERO)
        small += mean[col] < _FROM_NORMAL
    return small


@_nested
def _draw_large(mean: Any, words: Any, counts: Any, read: Any) -> None:
    """Fill `counts` and `read` of one row with Poisson numbers of `mean` and normal numbers."""
    for col in range(mean.size):
        shot, read[col] = normal_pair(words[0, col], words[1, col])
        counts[col] = count_of_normal(mean[col], shot)


@_nested
def _draw_small(mean: Any, tables: Any, key: Any, place: Any, words: Any, counts: Any) -> None:
    """Replace the counts of small means in one row.

    Parameters
    ----------
    words : (2, 2 n), work array for n blocks that are computed together
    """
    half, chunk = (mean.size + 1) // 2, words.shape[1] // 2
    for low in range(0, half, chunk):
        count, high = min(chunk, half - low), half + low
        if _smalls(mean[low : low + count]) + _smalls(mean[high : high + count]):
            _fill(words, chunk, key, place, low)
            _draw_each(mean, tables, words, counts, (low, 0, count))
            _draw_each(mean, tables, words, counts, (high, chunk, min(count, mean.size - high)))


@_nested
def _smalls(mean: Any) -> Any:
    small = 0
    for col in range(mean.size):
        small += mean[col] < _FROM_NORMAL
    return small


@_inlined
def _draw_each(mean: Any, tables: Any, words: Any, counts: Any, part: Any) -> None:
    first_col, first_word, count = part
    for i in range(count):
        col, word = first_col + i, first_word + i
        if mean[col] < _FROM_NORMAL:
            counts[col] = _small_count(mean[col], words[0, word], words[1, word], tables)


@_nested
def _convert(counts: Any, read: Any, offset_e: Any, sensor: Any, recorded: Any) -> None:
    """Fill `recorded` of one row with the digital numbers of electrons."""
    for col in range(counts.size):
        well_e = min(counts[col], sensor.full_well_e)
        signal_e = read[col] * sensor.read_noise_e + well_e + offset_e[col]
        dn = np.rint(signal_e * sensor.gain_dn_per_e + sensor.black_level_dn)
        recorded[col] = np.uint16(min(max(dn, _ZERO), sensor.largest_dn))


@_compiled
def _record(
    radiance: Any,
    pattern: Any,
    sensor: Any,
    tables: Any,
    key: Any,
    frame: Any,
    lines: _RowScratch,
    recorded: Any,
) -> None:
    response, offset_e = pattern
    words, few_words, mean, counts, read = lines
    for row in range(radiance.shape[0]):
        place = np.uint32(row), frame
        small = _expect(radiance[row], response[row], sensor, mean)
        _fill(words, (mean.size + 1) // 2, key, (*place, np.uint32(0)), 0)
        _draw_large(mean, words, counts, read)
        if small:
            _draw_small(mean, tables, key, (*place, np.uint32(1)), few_words, counts)
        _convert(counts, read, offset_e[row], sensor, recorded[row])
