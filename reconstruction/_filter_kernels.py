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

# Mean squares are taken over 17 x 17 pixels, the outer ones half.
REACH = 8
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
    per_count: Any  # 1 / usable pixels of the box
    value: Any
    spare: Any
    lift: Any
    coarse: Any
    squares: Any  # (coarse, fine, noise)


class Patch(NamedTuple):
    """A part of the image, and where in the planes it and the rest of the image lie."""

    top: int  # image row of plane row 0
    left: int
    rows: int
    cols: int
    margin: int  # around the patch, on all sides
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
        np.zeros(shape, np.float32), np.zeros((3, rows, cols), np.float32),
    )  # fmt: skip


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
    """Write the coarse part of the lift, and the squares of both parts."""
    lift, coarse, spare = planes.lift, planes.coarse, planes.spare
    gap, end, half = window.gap, window.gap + window.width, window.half
    for row in range(half, lift.shape[0] - half):
        _average_along(lift[row], weights, window, spare[row, gap:end])
    for row in range(2 * half, lift.shape[0] - 2 * half):
        _average_across(spare, row, weights, half, coarse[row])
        squares = planes.squares
        _square(lift[row], coarse[row], planes.per_support[row], squares[0, row], squares[1, row])


@compiled
def _square(lift: Any, coarse: Any, per_support: Any, large: Any, small: Any) -> None:
    for col in range(lift.size):
        kept = coarse[col] * per_support[col]
        fine = lift[col] - kept
        coarse[col], large[col], small[col] = kept, kept * kept, fine * fine


@compiled
def _box_down(plane: Any) -> None:
    """Sum 16 rows from each row on, in the same order whatever the band."""
    for step in (1, 4):
        for row in range(plane.shape[0] - 3 * step):
            _add_three(plane[row + step], plane[row + 2 * step], plane[row + 3 * step], plane[row])


@compiled
def _add_three(a: Any, b: Any, c: Any, total: Any) -> None:
    for col in range(total.size):
        total[col] = (total[col] + a[col]) + (b[col] + c[col])


@compiled
def _sum_four(a: Any, b: Any, c: Any, d: Any, out: Any) -> None:
    for col in range(out.size):
        out[col] = (a[col] + b[col]) + (c[col] + d[col])


@compiled
def _box_along(line: Any, below: Any, spare: Any, out: Any) -> None:
    """Sum 17 rows and 17 columns, the outer ones half, from sums of 16 rows."""
    size, (one, other) = out.size, (spare[0], spare[1])
    _sum(line[: size + 16], below[: size + 16], one)
    _sum_four(one[: size + 13], one[1 : size + 14], one[2 : size + 15], one[3:], other[: size + 13])
    _sum_four(
        other[: size + 1],
        other[4 : size + 5],
        other[8 : size + 9],
        other[12 : size + 13],
        one[: size + 1],
    )
    _sum(one[:size], one[1 : size + 1], out)


@compiled
def _add(a: Any, total: Any) -> None:
    for col in range(total.size):
        total[col] += a[col]


@compiled
def _settle(
    smoothing: Smoothing, x: Any, usable: Any, gain: Any, lift: Any, coarse: Any, squares: Any,
    variance: Any, out: Any, sigma: Any, share: Any,
) -> None:  # fmt: skip
    """Give back what is relief; write coordinate, sigma and the share of bias in its square."""
    m, centre = smoothing.noise, smoothing.centre
    g, gc, gf, cc, cf, ff = m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2], m[2, 2]
    g0, c0, f0 = centre[0], centre[1], centre[2]
    for col in range(out.size):
        noise, own, large, small = squares[2, col], variance[col], squares[0, col], squares[1, col]
        c = _excess(COARSE_FLOOR * cc * noise, large)
        extra = _smaller(FINE_EXTRA, RELIEF_EXTRA * (ONE - c))
        f = _excess((ONE + extra) * ff * noise, small)
        kept, fine = coarse[col], lift[col] - coarse[col]
        out[col] = usable[col] * (x[col] + (ONE - c) * kept + (ONE - f) * fine)
        bias = (ONE - c) * (ONE - c) * c * large + (ONE - f) * (ONE - f) * f * small
        middle = g0 - c * c0 - f * f0
        left = g - TWO * (c * gc + f * gf) + c * c * cc + TWO * c * f * cf + f * f * ff
        less = _larger(gain[col] - g, ZERO) * (ONE - _larger(c, f))
        spread = middle * middle * (own - noise) + (left + less) * noise + bias
        sigma[col] = usable[col] * np.sqrt(_larger(spread, ZERO))
        share[col] = np.uint8(np.int32(SHARE_STEPS * (bias / _larger(spread, TINY)) + ROUNDING))


@inlined
def _excess(expected: Any, found: Any) -> Any:
    """Return the share by which `found` exceeds what is expected of noise."""
    return _larger(ONE - expected / _larger(found, TINY), ZERO)


@compiled
def _load_mask(source: Unfiltered, patch: Patch, planes: Planes) -> None:
    planes.usable[:] = ZERO
    for row in range(patch.low, patch.high):
        line = source.reason[patch.top + row]
        for col in range(patch.near, patch.far):
            planes.usable[row, col] = np.float32(line[patch.left + col] == 0)


@compiled
def _load_axis(
    axis: int, source: Unfiltered, patch: Patch, smoothing: Smoothing, planes: Planes
) -> None:
    """Write the coordinate and the variance of the single pixel."""
    planes.value[:], planes.squares[2] = NOWHERE, ZERO
    near, far = patch.near, patch.far
    for row in range(patch.low, patch.high):
        line, variance = source.coordinate_px[axis, patch.top + row], planes.squares[2, row]
        first, end = patch.left + near, patch.left + far
        _mark(line[first:end], planes.usable[row, near:far], planes.value[row, near:far])
        sigma = source.sigma[axis, patch.top + row, first:end]
        unpack_row(sigma, smoothing.sigma_unit, variance[near:far])
        _multiply(variance[near:far], variance[near:far])


@compiled
def _mark(x: Any, usable: Any, out: Any) -> None:
    for col in range(out.size):
        out[col] = x[col] if usable[col] > ZERO else NOWHERE


@compiled
def _count(planes: Planes, patch: Patch, spare: Any) -> None:
    """Write 1 / usable pixels of the box around each pixel of the patch."""
    sums, start = planes.squares[0], patch.margin - REACH
    sums[:] = planes.usable
    _box_down(sums)
    for row in range(patch.margin, patch.margin + patch.rows):
        usable, out = planes.usable[row], planes.per_count[row]
        inside = slice(patch.margin, patch.margin + patch.cols)
        above = row - REACH
        _box_along(sums[above, start:], sums[above + 1, start:], spare, out[inside])
        _invert(out[inside], usable[inside])


@compiled
def _write(
    axis: int, planes: Planes, patch: Patch, smoothing: Smoothing, variances: Any, spare: Any,
    boxes: Any, target: Smoothed,
) -> None:  # fmt: skip
    inside, start = slice(patch.margin, patch.margin + patch.cols), patch.margin - REACH
    first = patch.left + patch.margin
    for row in range(patch.margin, patch.margin + patch.rows):
        above, out = row - REACH, slice(first, first + patch.cols)
        for part in range(3):
            sums = planes.squares[part]
            _box_along(sums[above, start:], sums[above + 1, start:], spare, boxes[part])
            _multiply(boxes[part], planes.per_count[row, inside])
        _settle(
            smoothing, planes.value[row, inside], planes.usable[row, inside],
            planes.gain[row, inside], planes.lift[row, inside], planes.coarse[row, inside], boxes,
            variances[row - patch.margin], target.coordinate_px[axis, patch.top + row, out],
            boxes[3], target.bias_share[axis, patch.top + row, out],
        )  # fmt: skip
        packed = target.sigma[axis, patch.top + row, out]
        pack_row(boxes[3], smoothing.sigma_factor, boxes[4], packed)


@compiled
def _smooth_patch(
    patch: Patch, source: Unfiltered, smoothing: Smoothing, planes: Planes, target: Smoothed
) -> None:
    half, margin = smoothing.weights.size // 2, patch.margin
    window = Window(half, patch.cols + 2 * (margin - half), half)
    spare = np.zeros((2, patch.cols + 16), np.float32)
    boxes = np.zeros((5, patch.cols), np.float32)
    variances = np.zeros((patch.rows, patch.cols), np.float32)
    _load_mask(source, patch, planes)
    _weigh(planes, smoothing.weights, half, window)
    _count(planes, patch, spare)
    for axis in range(2):
        _load_axis(axis, source, patch, smoothing, planes)
        for row in range(patch.rows):
            variances[row] = planes.squares[2, row + margin, margin : margin + patch.cols]
        _lift(planes, smoothing, window)
        _part(planes, smoothing.weights, window)
        for part in range(3):
            _box_down(planes.squares[part])
        _write(axis, planes, patch, smoothing, variances, spare, boxes, target)


@compiled
def smooth_rows(
    first_row: int, end_row: int, source: Unfiltered, smoothing: Smoothing, target: Smoothed
) -> None:
    """Fill `target` for rows first_row to end_row - 1, in patches that stay in the cache."""
    rows, width = source.reason.shape
    margin, count = 2 * (smoothing.weights.size // 2) + REACH, end_row - first_row
    top = first_row - margin
    low, high = max(-top, 0), min(count + 2 * margin, rows - top)
    # One set for all patches: new memory costs more than the arithmetic.
    planes = _make_planes(count + 2 * margin, min(PATCH_COLS, width) + 2 * margin)
    for first_col in range(0, width, PATCH_COLS):
        cols, left = min(PATCH_COLS, width - first_col), first_col - margin
        near, far = max(-left, 0), min(cols + 2 * margin, width - left)
        patch = Patch(top, left, count, cols, margin, low, high, near, far)
        _smooth_patch(patch, source, smoothing, planes, target)
