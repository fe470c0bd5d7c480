"""Estimate the shares of relief and noise in the lift of the filter, block by block; see `_filter`.

Symbols: c is the share of the coarse part that is relief, f that of the fine part. With the lines
of `Blocks.values`: sigma^2 = own variance * values[2] + values[3] + excess gain * values[4]. The
bias values[5] is included in values[3]. Each loop has few arrays: with more arrays the compiler
does not vectorise the loop.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import Any, NamedTuple

import numpy as np

from reconstruction.compiling import compiled, inlined, merged, nested
from reconstruction.decoding._lift import (
    COARSE,
    LIFT,
    ONE,
    TINY,
    TWO,
    USABLE,
    VARIANCE,
    ZERO,
    Smoothing,
)
from reconstruction.decoding._rows import add, fill, larger, smaller

# Mean squares are averages over 5 x 5 blocks of 4 x 4 pixels; AROUND blocks on either side.
BLOCK, AROUND = 4, 2
REACH = BLOCK * (AROUND + 1)
# The mean square of a part counts as relief above a multiple of its expected noise: for the coarse
# part COARSE_FLOOR, 2.4 sigmas of a mean square of noise. For the fine part the multiple is
# 1 + FINE_EXTRA; it is lower where the coarse part is relief, because fine relief is likely there.
COARSE_FLOOR, FINE_EXTRA, RELIEF_EXTRA = np.float32(1.8), np.float32(0.2), np.float32(0.3)
SHARE_STEPS, ROUNDING = np.float32(255.0), np.float32(0.5)


class Blocks(NamedTuple):
    """Buffers for sums over blocks of pixels, and for values computed from the sums.

    The four sums are those of the squared coarse part, the squared fine part, the variances, px^2
    each, and the number of usable pixels.
    """

    lines: Any  # (sum, col), sums over the rows of one block row
    sums: Any  # (sum, block row, block col)
    around: Any  # (sum, block col), sums over 5 x 5 blocks for one block row
    shares: Any  # (2, block col), shares c and f of coarse and fine part that are relief
    values: Any  # (value, block col), factors of lift and of coarse part, four terms of sigma^2
    spread: Any  # (value, col), `values` for every pixel
    written: Any  # (3, col): variance, sigma, and a scratch line for packing


def make_blocks(rows: int, cols: int) -> Blocks:
    return Blocks(
        np.zeros((4, cols), np.float32),
        np.zeros((4, rows // BLOCK, cols // BLOCK), np.float32),
        np.zeros((4, cols // BLOCK), np.float32),
        np.zeros((2, cols // BLOCK), np.float32),
        np.zeros((6, cols // BLOCK), np.float32),
        np.zeros((6, cols), np.float32),
        np.zeros((3, cols), np.float32),
    )


@merged
def sum_blocks(images: Any, half: int, lines: Any, sums: Any) -> None:
    """Write the four sums of `Blocks` over every block of a patch."""
    rows = images.shape[1]
    for block in range(sums.shape[1]):
        for part in range(4):
            fill(lines[part], ZERO)
        for row in range(BLOCK * block, BLOCK * block + BLOCK):
            if 2 * half <= row < rows - 2 * half:
                _add_squares(images[LIFT, row], images[COARSE, row], lines[0], lines[1])
                add(images[VARIANCE, row], lines[2])
                add(images[USABLE, row], lines[3])
        for part in range(4):
            line, out = lines[part], sums[part, block]
            for col in range(out.size):
                at = BLOCK * col
                out[col] = (line[at] + line[at + 1]) + (line[at + 2] + line[at + 3])


@nested
def _add_squares(lift: Any, coarse: Any, large: Any, small: Any) -> None:
    for col in range(lift.size):
        fine = lift[col] - coarse[col]
        large[col] += coarse[col] * coarse[col]
        small[col] += fine * fine


@compiled
def _sum_five(a: Any, b: Any, c: Any, d: Any, e: Any, out: Any) -> None:
    for col in range(out.size):
        out[col] = c[col] + ((a[col] + e[col]) + (b[col] + d[col]))


@nested
def _sum_around(block: int, blocks: Blocks) -> None:
    """Write the four sums over the 5 x 5 blocks around each block of one block row."""
    for part in range(4):
        s, line, out = blocks.sums[part], blocks.lines[part], blocks.around[part]
        size, end = out.size, out.size - AROUND
        down = line[:size]
        _sum_five(s[block - 2], s[block - 1], s[block], s[block + 1], s[block + 2], down)
        _sum_five(
            down[: end - 2], down[1 : end - 1], down[2:end], down[3 : end + 1], down[4 : end + 2],
            out[AROUND:end],
        )  # fmt: skip


@inlined
def _excess(expected: Any, measured: Any) -> Any:
    """Return the share of a mean square that exceeds the expected noise, at least 0."""
    return larger(ONE - expected / larger(measured, TINY), ZERO)


@compiled
def find_shares(large: Any, small: Any, noise: Any, ratios: Any, c: Any, f: Any) -> None:
    """Write the shares c and f of the coarse and of the fine part that are relief.

    large, small : sums of the squared coarse and fine part
    noise : sum of the variances of single pixels
    ratios : `Smoothing.noise`
    """
    of_coarse, of_fine = ratios[1, 1], ratios[2, 2]
    for col in range(c.size):
        coarse = _excess(COARSE_FLOOR * of_coarse * noise[col], large[col])
        extra = smaller(FINE_EXTRA, RELIEF_EXTRA * (ONE - coarse))
        c[col], f[col] = coarse, _excess((ONE + extra) * of_fine * noise[col], small[col])


@compiled
def predict_bias(large: Any, small: Any, c: Any, f: Any, count: Any, out: Any) -> None:
    """Write the mean square, px^2, of the relief that is not restored."""
    for col in range(out.size):
        coarse_loss, fine_loss = ONE - c[col], ONE - f[col]
        bias = (
            coarse_loss * coarse_loss * c[col] * large[col]
            + fine_loss * fine_loss * f[col] * small[col]
        )
        out[col] = bias / larger(count[col], ONE)


@compiled
def weigh_own(c: Any, f: Any, centre: Any, out: Any) -> None:
    """Write the squared weight of a pixel's own unfiltered value in its filtered value."""
    g0, c0, f0 = centre[0], centre[1], centre[2]
    for col in range(out.size):
        middle = g0 - c[col] * c0 - f[col] * f0
        out[col] = middle * middle


@compiled
def weigh_neighbours(
    c: Any, f: Any, own: Any, noise: Any, count: Any, bias: Any, ratios: Any, out: Any
) -> None:  # fmt: skip
    """Write the variance, px^2, of the filtered value by the noise of neighbours, plus the bias."""
    g, gc, gf = ratios[0, 0], ratios[0, 1], ratios[0, 2]
    cc, cf, ff = ratios[1, 1], ratios[1, 2], ratios[2, 2]
    for col in range(out.size):
        x, y = c[col], f[col]
        remaining = g - TWO * (x * gc + y * gf) + x * x * cc + TWO * x * y * cf + y * y * ff
        variance = noise[col] / larger(count[col], ONE)
        out[col] = larger(remaining - own[col], ZERO) * variance + bias[col]


@compiled
def weigh_edge(c: Any, f: Any, noise: Any, count: Any, out: Any) -> None:
    for col in range(out.size):
        out[col] = noise[col] / larger(count[col], ONE) * (ONE - larger(c[col], f[col]))


@compiled
def _weigh_relief(c: Any, f: Any, all_lift: Any, all_coarse: Any) -> None:
    for col in range(c.size):
        all_lift[col], all_coarse[col] = ONE - f[col], f[col] - c[col]


@merged
def weigh_blocks(block: int, smoothing: Smoothing, blocks: Blocks) -> None:
    """Write the values of all blocks of one block row, and spread them to the pixels.

    See `Blocks.values` and the module docstring.
    """
    _sum_around(block, blocks)
    sums, values, ratios = blocks.around, blocks.values, smoothing.noise
    large, small, noise, count = sums[0], sums[1], sums[2], sums[3]
    c, f = blocks.shares[0], blocks.shares[1]
    find_shares(large, small, noise, ratios, c, f)
    _weigh_relief(c, f, values[0], values[1])
    weigh_own(c, f, smoothing.centre, values[2])
    predict_bias(large, small, c, f, count, values[5])
    weigh_neighbours(c, f, values[2], noise, count, values[5], ratios, values[3])
    weigh_edge(c, f, noise, count, values[4])
    _spread(values, blocks.spread)


@nested
def _spread(values: Any, out: Any) -> None:
    """Write to every pixel the values of the block that contains the pixel."""
    for part in range(values.shape[0]):
        line, pixels = values[part], out[part]
        for col in range(line.size):
            for at in range(BLOCK * col, BLOCK * col + BLOCK):
                pixels[at] = line[col]


@compiled
def restore_relief(
    x: Any, usable: Any, lift: Any, coarse: Any, all_lift: Any, all_coarse: Any, out: Any
) -> None:  # fmt: skip
    for col in range(out.size):
        change = all_lift[col] * lift[col] + all_coarse[col] * coarse[col]
        out[col] = usable[col] * (x[col] + change)


@compiled
def add_variances(
    variance: Any, gain: Any, full_gain: Any, own: Any, around: Any, edge: Any, out: Any
) -> None:  # fmt: skip
    for col in range(out.size):
        excess = larger(gain[col] - full_gain, ZERO)
        out[col] = own[col] * variance[col] + around[col] + excess * edge[col]


@compiled
def write_share(bias: Any, total: Any, usable: Any, share: Any) -> None:
    for col in range(share.size):
        part = usable[col] * bias[col] / larger(total[col], TINY)
        share[col] = np.uint8(np.int32(SHARE_STEPS * part + ROUNDING))


@compiled
def write_root(total: Any, usable: Any, sigma: Any) -> None:
    for col in range(sigma.size):
        sigma[col] = usable[col] * np.sqrt(total[col])
