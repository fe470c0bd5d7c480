"""The Gaussian on the projector coordinate of one axis: what it takes from relief is given back.

Symbols: x coordinate, G the Gaussian, lift l = G x - x, coarse part c = G l, fine part f = l - c,
s sigma of the single pixel, E local mean square, w share of a part that is relief.
Result x + (1 - w_c) c + (1 - w_f) f; see `smoothing`.

G acts along rows, then along columns, as second differences x(-k) - 2 x + x(+k) of pixel pairs: a
pair counts only where both its pixels are measured, so that a plane stays as it is next to holes
and image borders too. A pair that is off by more than half a period is a wrong fringe order, or
another body, and says nothing.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import Any, NamedTuple

import numpy as np

from reconstruction._half_kernels import pack_row, unpack_row
from reconstruction._jit import compiled, inlined
from reconstruction.arrays import FloatImage

# Mean squares are taken over 5 x 5 blocks of 4 x 4 pixels, whatever the patch.
BLOCK, AROUND = 4, 2
REACH = BLOCK * (AROUND + 1)
PATCH_COLS = 256
# A part counts as relief beyond so many times the noise expected of it, 2.4 sigmas of a mean square
# of noise; fine relief comes with coarse relief, which takes the extra off.
COARSE_FLOOR, FINE_EXTRA, RELIEF_EXTRA = np.float32(1.8), np.float32(0.2), np.float32(0.3)
ZERO, ONE, TWO, TINY = np.float32(0.0), np.float32(1.0), np.float32(2.0), np.float32(1e-30)
# The value of a pixel without one: no pair with it comes within any limit.
NOWHERE = np.float32(1e30)
SHARE_STEPS, ROUNDING = np.float32(255.0), np.float32(0.5)


class Smoothing(NamedTuple):
    """Kernel of G along one direction and what follows from it, see `smoothing`.

    noise: products of the kernels of (G, c, f) summed over the plane: (0, 0) is the variance that
    G leaves of white noise. centre: their middle weights. limit_px: half a period.
    """

    weights: FloatImage
    noise: FloatImage  # (3, 3)
    centre: FloatImage  # (3,)
    limit_px: np.float32
    sigma_unit: np.float32  # to read packed sigmas
    sigma_factor: np.float32  # to pack them


class Unfiltered(NamedTuple):
    """Maps to smooth, (axis, row, col), and what tells where they hold: reason 0."""

    coordinate_px: Any
    sigma: Any
    reason: Any


class Smoothed(NamedTuple):
    """The result, (axis, row, col): coordinate, packed sigma, share of its square that is bias."""

    coordinate_px: Any
    sigma: Any
    bias_share: Any


class Planes(NamedTuple):
    """Images of a patch and its surroundings, (row, col)."""

    usable: Any
    along_rows: Any  # 1 / sum of weights
    along_cols: Any
    gain: Any  # variance that G leaves of the noise of a single pixel
    per_support: Any  # 1 / (G usable)
    value: Any
    variance: Any
    spare: Any
    lift: Any
    coarse: Any


class Blocks(NamedTuple):
    """Sums over blocks; the last index is coarse, fine, noise, count or as `_weigh_parts` says."""

    lines: Any  # (sum, col), over the rows of one block row
    sums: Any  # (sum, block row, block col)
    spread: Any  # (value, col), what holds for all pixels of a block


class Patch(NamedTuple):
    """A part of the image, and where in the planes it and the rest of the image lie."""

    top: int  # image row of plane row 0
    left: int
    rows: int
    cols: int
    above: int  # plane row and column where the patch begins
    start: int
    low: int  # plane rows low to high - 1 and columns near to far - 1 are image
    high: int
    near: int
    far: int


class Window(NamedTuple):
    """Which columns of the planes are filtered: those before it, width, and half the kernel."""

    gap: int
    width: int
    half: int


@compiled
def _make_planes(rows: int, cols: int) -> Planes:
    shape = (rows, cols)
    return Planes(
        np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.zeros(shape, np.float32),
        np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.zeros(shape, np.float32),
        np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.zeros(shape, np.float32),
        np.zeros(shape, np.float32),
    )  # fmt: skip


@compiled
def _make_blocks(rows: int, cols: int) -> Blocks:
    return Blocks(
        np.zeros((4, cols), np.float32),
        np.zeros((4, rows // BLOCK, cols // BLOCK), np.float32),
        np.zeros((6, cols), np.float32),
    )


@inlined
def _larger(a: Any, b: Any) -> Any:
    return a if a > b else b


@inlined
def _smaller(a: Any, b: Any) -> Any:
    return a if a < b else b


@compiled
def _fill(line: Any, value: Any) -> None:
    for col in range(line.size):
        line[col] = value


@compiled
def _add_weight(a: Any, b: Any, weight: Any, total: Any) -> None:
    for col in range(total.size):
        total[col] += weight * (a[col] * b[col])


@compiled
def _add_noise(a: Any, b: Any, u: Any, v: Any, weight: Any, total: Any) -> None:
    for col in range(total.size):
        total[col] += weight * (a[col] * b[col]) * (u[col] + v[col])


@compiled
def _add_pair(a: Any, b: Any, weight: Any, total: Any) -> None:
    for col in range(total.size):
        total[col] += weight * (a[col] + b[col])


@inlined
def _bend(a: Any, b: Any, middle: Any, limit: Any) -> Any:
    bend = (a + b) - TWO * middle
    return bend if abs(bend) < limit else ZERO


@compiled
def _add_bend(a: Any, b: Any, middle: Any, weight: Any, limit: Any, total: Any) -> None:
    for col in range(total.size):
        total[col] += weight * _bend(a[col], b[col], middle[col], limit)


@compiled
def _sum_four_bends(
    a: Any, b: Any, c: Any, d: Any, middle: Any, e: Any, f: Any, g: Any, h: Any, weights: Any,
    limit: Any, factor: Any, out: Any,
) -> None:  # fmt: skip
    p, q, r, s = weights[0], weights[1], weights[2], weights[3]
    for col in range(out.size):
        x = middle[col]
        outer = p * _bend(a[col], h[col], x, limit) + q * _bend(b[col], g[col], x, limit)
        inner = r * _bend(c[col], f[col], x, limit) + s * _bend(d[col], e[col], x, limit)
        out[col] = factor[col] * (outer + inner)


@compiled
def _sum_nine(
    a: Any, b: Any, c: Any, d: Any, middle: Any, e: Any, f: Any, g: Any, h: Any, weights: Any,
    out: Any,
) -> None:  # fmt: skip
    p, q, r, s, t = weights[0], weights[1], weights[2], weights[3], weights[4]
    for col in range(out.size):
        outer = p * (a[col] + h[col]) + q * (b[col] + g[col])
        inner = r * (c[col] + f[col]) + s * (d[col] + e[col])
        out[col] = t * middle[col] + (outer + inner)


@compiled
def _bend_along(
    line: Any, weights: Any, window: Window, limit: Any, factor: Any, out: Any
) -> None:  # fmt: skip
    """Write what the pairs along a row add to its middle."""
    gap, end, half = window.gap, window.gap + window.width, window.half
    middle = line[gap:end]
    if half == 4:
        _sum_four_bends(
            line[gap - 4 : end - 4], line[gap - 3 : end - 3], line[gap - 2 : end - 2],
            line[gap - 1 : end - 1], middle, line[gap + 1 : end + 1], line[gap + 2 : end + 2],
            line[gap + 3 : end + 3], line[gap + 4 : end + 4], weights, limit, factor, out,
        )  # fmt: skip
        return
    _fill(out, ZERO)
    for k in range(1, half + 1):
        before, after = line[gap - k : end - k], line[gap + k : end + k]
        _add_bend(before, after, middle, weights[half + k], limit, out)
    _multiply(out, factor)


@compiled
def _bend_across(
    plane: Any, row: int, weights: Any, half: int, limit: Any, factor: Any, out: Any
) -> None:  # fmt: skip
    if half == 4:
        _sum_four_bends(
            plane[row - 4], plane[row - 3], plane[row - 2], plane[row - 1], plane[row],
            plane[row + 1], plane[row + 2], plane[row + 3], plane[row + 4], weights, limit,
            factor, out,
        )  # fmt: skip
        return
    _fill(out, ZERO)
    for k in range(1, half + 1):
        _add_bend(plane[row - k], plane[row + k], plane[row], weights[half + k], limit, out)
    _multiply(out, factor)


@compiled
def _invert(line: Any, usable: Any) -> None:
    for col in range(line.size):
        line[col] = usable[col] / _larger(line[col], TINY)


@compiled
def _scale(line: Any, factor: Any, out: Any) -> None:
    for col in range(line.size):
        out[col] = line[col] * factor


@compiled
def _multiply(line: Any, factor: Any) -> None:
    for col in range(line.size):
        line[col] *= factor[col]


@compiled
def _average_along(line: Any, weights: Any, window: Window, out: Any) -> None:
    """Weigh a row with the plain kernel; pixels that hold no value are 0."""
    gap, end, half = window.gap, window.gap + window.width, window.half
    if half == 4:
        _sum_nine(
            line[gap - 4 : end - 4], line[gap - 3 : end - 3], line[gap - 2 : end - 2],
            line[gap - 1 : end - 1], line[gap:end], line[gap + 1 : end + 1],
            line[gap + 2 : end + 2], line[gap + 3 : end + 3], line[gap + 4 : end + 4], weights, out,
        )  # fmt: skip
        return
    _scale(line[gap:end], weights[half], out)
    for k in range(1, half + 1):
        _add_pair(line[gap - k : end - k], line[gap + k : end + k], weights[half + k], out)


@compiled
def _average_across(plane: Any, row: int, weights: Any, half: int, out: Any) -> None:
    if half == 4:
        _sum_nine(
            plane[row - 4], plane[row - 3], plane[row - 2], plane[row - 1], plane[row],
            plane[row + 1], plane[row + 2], plane[row + 3], plane[row + 4], weights, out,
        )  # fmt: skip
        return
    _scale(plane[row], weights[half], out)
    for k in range(1, half + 1):
        _add_pair(plane[row - k], plane[row + k], weights[half + k], out)


@compiled
def _is_equal(a: Any, b: Any) -> bool:
    differing = 0
    for col in range(a.size):
        differing += a[col] != b[col]
    return differing == 0


@compiled
def _weigh_along(row: int, planes: Planes, weights: Any, window: Window) -> None:
    gap, end, half = window.gap, window.gap + window.width, window.half
    line = planes.usable[row]
    total, left = planes.along_rows[row, gap:end], planes.spare[row, gap:end]
    _fill(total, weights[half])
    _fill(left, weights[half] * weights[half])
    for k in range(1, half + 1):
        u, v, weight = line[gap - k : end - k], line[gap + k : end + k], weights[half + k]
        _add_weight(u, v, TWO * weight, total)
        _add_weight(u, v, TWO * weight * weight, left)
    _invert(total, line[gap:end])
    _multiply(left, total)
    _multiply(left, total)
    _average_along(line, weights, window, planes.coarse[row, gap:end])


@compiled
def _weigh_across(row: int, planes: Planes, weights: Any, half: int) -> None:
    usable, noise = planes.usable, planes.spare
    total, left, support = planes.along_cols[row], planes.gain[row], planes.per_support[row]
    _fill(total, weights[half])
    _scale(noise[row], weights[half] * weights[half], left)
    for k in range(1, half + 1):
        u, v, weight = usable[row - k], usable[row + k], weights[half + k]
        _add_weight(u, v, TWO * weight, total)
        _add_noise(u, v, noise[row - k], noise[row + k], weight * weight, left)
    _invert(total, usable[row])
    _multiply(left, total)
    _multiply(left, total)
    _average_across(planes.coarse, row, weights, half, support)
    _invert(support, usable[row])


@compiled
def _weigh(planes: Planes, weights: Any, half: int, window: Window) -> None:
    """Write what depends on the mask alone: sums of weights, noise, support.

    Most rows have the mask of the row before.
    """
    rows = planes.usable.shape[0]
    alike = np.zeros(rows, np.int64)
    _weigh_along(0, planes, weights, window)
    for row in range(1, rows):
        if _is_equal(planes.usable[row], planes.usable[row - 1]):
            alike[row] = alike[row - 1] + 1
            for plane in (planes.along_rows, planes.spare, planes.coarse):
                plane[row] = plane[row - 1]
        else:
            _weigh_along(row, planes, weights, window)
    for row in range(half, rows - half):
        if alike[row + half] > 2 * half:
            for plane in (planes.along_cols, planes.gain, planes.per_support):
                plane[row] = plane[row - 1]
        else:
            _weigh_across(row, planes, weights, half)


@compiled
def _lift(planes: Planes, smoothing: Smoothing, window: Window) -> None:
    """Write l = G x - x."""
    value, spare, lift = planes.value, planes.spare, planes.lift
    spare[:] = NOWHERE
    weights, limit, rows = smoothing.weights, smoothing.limit_px, planes.usable.shape[0]
    gap, end, half = window.gap, window.gap + window.width, window.half
    for row in range(rows):
        line, out = value[row], lift[row, gap:end]
        _bend_along(line, weights, window, limit, planes.along_rows[row, gap:end], out)
        _sum(line[gap:end], out, spare[row, gap:end])
    for row in range(half, rows - half):
        out = planes.coarse[row]
        _bend_across(spare, row, weights, half, limit, planes.along_cols[row], out)
        _add(out, lift[row])


@compiled
def _sum(a: Any, b: Any, out: Any) -> None:
    for col in range(out.size):
        out[col] = a[col] + b[col]


@compiled
def _part(planes: Planes, weights: Any, window: Window) -> None:
    """Write the coarse part of the lift."""
    lift, coarse, spare = planes.lift, planes.coarse, planes.spare
    gap, end, half = window.gap, window.gap + window.width, window.half
    for row in range(half, lift.shape[0] - half):
        _average_along(lift[row], weights, window, spare[row, gap:end])
    for row in range(2 * half, lift.shape[0] - 2 * half):
        _average_across(spare, row, weights, half, coarse[row])
        _multiply(coarse[row], planes.per_support[row])


@compiled
def _sum_blocks(planes: Planes, half: int, blocks: Blocks) -> None:
    """Write the sums over every block: squares of both parts, variances and usable pixels."""
    rows, lines, sums = planes.lift.shape[0], blocks.lines, blocks.sums
    for block in range(sums.shape[1]):
        lines[:] = ZERO
        for row in range(BLOCK * block, BLOCK * block + BLOCK):
            if 2 * half <= row < rows - 2 * half:
                _add_squares(planes.lift[row], planes.coarse[row], lines[0], lines[1])
                _add(planes.variance[row], lines[2])
                _add(planes.usable[row], lines[3])
        for part in range(4):
            line, out = lines[part], sums[part, block]
            for col in range(out.size):
                at = BLOCK * col
                out[col] = (line[at] + line[at + 1]) + (line[at + 2] + line[at + 3])


@compiled
def _add_squares(lift: Any, coarse: Any, large: Any, small: Any) -> None:
    for col in range(lift.size):
        fine = lift[col] - coarse[col]
        large[col] += coarse[col] * coarse[col]
        small[col] += fine * fine


@compiled
def _add(a: Any, total: Any) -> None:
    for col in range(total.size):
        total[col] += a[col]


@inlined
def _around(sums: Any, block: int, col: int) -> Any:
    total = ZERO
    for i in range(block - AROUND, block + AROUND + 1):
        line = sums[i]
        middle = line[col - 1] + line[col] + line[col + 1]
        total += middle + (line[col - 2] + line[col + 2])
    return total


@inlined
def _excess(expected: Any, found: Any) -> Any:
    """Return the share by which `found` exceeds what is expected of noise."""
    return _larger(ONE - expected / _larger(found, TINY), ZERO)


@compiled
def _weigh_parts(block: int, smoothing: Smoothing, blocks: Blocks) -> None:
    """Write, for the pixels of one block row, factors of lift and coarse part and terms of sigma.

    sigma^2 = own variance * spread[2] + spread[3] + excess gain * spread[4], of which spread[5] is
    bias.
    """
    m, centre, sums = smoothing.noise, smoothing.centre, blocks.sums
    g, gc, gf, cc, cf, ff = m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2], m[2, 2]
    for col in range(AROUND, sums.shape[2] - AROUND):
        per_count = ONE / _larger(_around(sums[3], block, col), ONE)
        large, small = (
            _around(sums[0], block, col) * per_count,
            _around(sums[1], block, col) * per_count,
        )
        noise = _around(sums[2], block, col) * per_count
        c = _excess(COARSE_FLOOR * cc * noise, large)
        extra = _smaller(FINE_EXTRA, RELIEF_EXTRA * (ONE - c))
        f = _excess((ONE + extra) * ff * noise, small)
        middle = centre[0] - c * centre[1] - f * centre[2]
        left = g - TWO * (c * gc + f * gf) + c * c * cc + TWO * c * f * cf + f * f * ff
        bias = (ONE - c) * (ONE - c) * c * large + (ONE - f) * (ONE - f) * f * small
        around = _larger(left - middle * middle, ZERO) * noise + bias
        edge = noise * (ONE - _larger(c, f))
        for at in range(BLOCK * col, BLOCK * col + BLOCK):
            blocks.spread[0, at], blocks.spread[1, at] = ONE - f, f - c
            blocks.spread[2, at], blocks.spread[3, at] = middle * middle, around
            blocks.spread[4, at], blocks.spread[5, at] = edge, bias


@compiled
def _settle(
    x: Any, usable: Any, gain: Any, full_gain: Any, lift: Any, coarse: Any, variance: Any,
    spread: Any, out: Any, sigma: Any, share: Any,
) -> None:  # fmt: skip
    """Give back what is relief; write coordinate, sigma and the share of bias in its square."""
    all_lift, all_coarse, own = spread[0], spread[1], spread[2]
    around, edge, bias = spread[3], spread[4], spread[5]
    for col in range(out.size):
        out[col] = usable[col] * (
            x[col] + all_lift[col] * lift[col] + all_coarse[col] * coarse[col]
        )
        less = _larger(gain[col] - full_gain, ZERO)
        total = own[col] * variance[col] + around[col] + less * edge[col]
        sigma[col] = usable[col] * np.sqrt(total)
        part = usable[col] * bias[col] / _larger(total, TINY)
        share[col] = np.uint8(np.int32(SHARE_STEPS * part + ROUNDING))


@compiled
def _mark(reason: Any, usable: Any) -> None:
    for col in range(usable.size):
        usable[col] = ONE if reason[col] == 0 else ZERO


@compiled
def _place(x: Any, usable: Any, out: Any) -> None:
    for col in range(out.size):
        out[col] = x[col] if usable[col] > ZERO else NOWHERE


@compiled
def _load_mask(source: Unfiltered, patch: Patch, planes: Planes) -> None:
    planes.usable[:] = ZERO
    first, end = patch.left + patch.near, patch.left + patch.far
    for row in range(patch.low, patch.high):
        line = source.reason[patch.top + row]
        _mark(line[first:end], planes.usable[row, patch.near : patch.far])


@compiled
def _load_axis(
    axis: int, source: Unfiltered, patch: Patch, smoothing: Smoothing, planes: Planes
) -> None:
    """Write the coordinate and the variance of the single pixel."""
    planes.value[:], planes.variance[:] = NOWHERE, ZERO
    near, far = patch.near, patch.far
    first, end = patch.left + near, patch.left + far
    for row in range(patch.low, patch.high):
        line, variance = source.coordinate_px[axis, patch.top + row], planes.variance[row, near:far]
        _place(line[first:end], planes.usable[row, near:far], planes.value[row, near:far])
        sigma = source.sigma[axis, patch.top + row, first:end]
        unpack_row(sigma, smoothing.sigma_unit, variance)
        _multiply(variance, variance)


@compiled
def _write(
    axis: int, planes: Planes, patch: Patch, smoothing: Smoothing, blocks: Blocks, target: Smoothed
) -> None:
    inside, first = slice(patch.start, patch.start + patch.cols), patch.left + patch.start
    out, sigma = slice(first, first + patch.cols), np.zeros((2, patch.cols), np.float32)
    block = -1
    for row in range(patch.above, patch.above + patch.rows):
        if row // BLOCK != block:
            block = row // BLOCK
            _weigh_parts(block, smoothing, blocks)
        at = patch.top + row
        _settle(
            planes.value[row, inside], planes.usable[row, inside], planes.gain[row, inside],
            smoothing.noise[0, 0], planes.lift[row, inside], planes.coarse[row, inside],
            planes.variance[row, inside], blocks.spread[:, inside],
            target.coordinate_px[axis, at, out], sigma[0], target.bias_share[axis, at, out],
        )  # fmt: skip
        pack_row(sigma[0], smoothing.sigma_factor, sigma[1], target.sigma[axis, at, out])


@compiled
def _smooth_patch(
    patch: Patch, source: Unfiltered, smoothing: Smoothing, planes: Planes, blocks: Blocks,
    target: Smoothed,
) -> None:  # fmt: skip
    half = smoothing.weights.size // 2
    window = Window(half, planes.usable.shape[1] - 2 * half, half)
    _load_mask(source, patch, planes)
    _weigh(planes, smoothing.weights, half, window)
    for axis in range(2):
        _load_axis(axis, source, patch, smoothing, planes)
        _lift(planes, smoothing, window)
        _part(planes, smoothing.weights, window)
        _sum_blocks(planes, half, blocks)
        _write(axis, planes, patch, smoothing, blocks, target)


@inlined
def _whole(size: int) -> int:
    return (size + BLOCK - 1) // BLOCK * BLOCK


@compiled
def smooth_rows(
    first_row: int, end_row: int, source: Unfiltered, smoothing: Smoothing, target: Smoothed
) -> None:
    """Fill `target` for rows first_row to end_row - 1, in patches that stay in the cache."""
    rows, width = source.reason.shape
    margin, count = _whole(2 * (smoothing.weights.size // 2) + REACH), end_row - first_row
    above = margin + first_row % BLOCK
    top, high = first_row - above, _whole(above + count + margin)
    # One set for all patches: new memory costs more than the arithmetic.
    planes = _make_planes(high, _whole(min(PATCH_COLS, width)) + 2 * margin)
    blocks = _make_blocks(planes.usable.shape[0], planes.usable.shape[1])
    low, high = max(-top, 0), min(high, rows - top)
    for first_col in range(0, width, PATCH_COLS):
        cols, left = min(PATCH_COLS, width - first_col), first_col - margin
        near, far = max(-left, 0), min(planes.usable.shape[1], width - left)
        patch = Patch(top, left, count, cols, above, margin, low, high, near, far)
        _smooth_patch(patch, source, smoothing, planes, blocks, target)
