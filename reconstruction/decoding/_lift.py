"""Compute the change of the projector coordinate by a Gaussian: the lift, and its coarse part.

Symbols: x coordinate, G the Gaussian, lift l = G x - x, coarse part c = G l; see `_filter`.

G is applied along rows, then along columns, as second differences x(-k) - 2 x + x(+k) of pixel
pairs. A pair is used only if both its pixels are measured, so that a plane is unchanged also next
to holes and image borders. A pair with a second difference above half a period has a wrong fringe
order or is on another body, and is excluded.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import Any, NamedTuple

import numpy as np

from reconstruction.arrays import FloatImage
from reconstruction.compiling import compiled, inlined, merged, nested
from reconstruction.decoding._rows import add, copy_row, fill, larger, multiply

ZERO, ONE, TWO, TINY = np.float32(0.0), np.float32(1.0), np.float32(2.0), np.float32(1e-30)


class Smoothing(NamedTuple):
    """Kernel of G along one direction, and quantities that depend on the kernel, see `_filter`.

    Three kernels give G x, c and f from x. noise (3, 3) is the sum over the plane of the product of
    each two kernels. Its element (0, 0) is the variance, after G, of white noise of variance 1.
    centre (3,) has the middle weight of each kernel. limit_px is half a period.
    """

    weights: FloatImage
    noise: FloatImage  # (3, 3)
    centre: FloatImage  # (3,)
    limit_px: np.float32
    sigma_unit: np.float32  # factor for `unpack_row` of sigmas
    sigma_factor: np.float32  # factor for `pack_row` of sigmas


# Indices of `Planes.images`. USABLE: 1 for pixels with a coordinate, else 0. ALONG_ROWS,
# ALONG_COLS: 1 / sum of weights. GAIN: variance after G of noise of variance 1. PER_SUPPORT:
# 1 / (G usable). VALUE: coordinate. VARIANCE: noise of the single pixel.
USABLE, ALONG_ROWS, ALONG_COLS, GAIN, PER_SUPPORT = 0, 1, 2, 3, 4
VALUE, VARIANCE, SPARE, LIFT, COARSE = 5, 6, 7, 8, 9
IMAGES = 10


class Planes(NamedTuple):
    """Images of a patch and its margin.

    All images are in one array, because compiled code copies a tuple of arrays at every access.
    """

    images: Any  # (image, row, col) float32
    alike: Any  # (row,), number of directly preceding rows with an identical mask


class Window(NamedTuple):
    """Range of columns of the planes that is filtered, and size of the kernel.

    gap is the number of columns before the range, width the number of columns in it. half is the
    number of taps on each side of the kernel's centre.
    """

    gap: int
    width: int
    half: int


def make_planes(rows: int, cols: int) -> Planes:
    return Planes(np.zeros((IMAGES, rows, cols), np.float32), np.zeros(rows, np.int64))


@nested
def _add_weight(a: Any, b: Any, weight: Any, total: Any) -> None:
    for col in range(total.size):
        total[col] += weight * (a[col] * b[col])


@nested
def _add_noise(a: Any, b: Any, u: Any, v: Any, weight: Any, total: Any) -> None:
    for col in range(total.size):
        total[col] += weight * (a[col] * b[col]) * (u[col] + v[col])


@nested
def _add_pair(a: Any, b: Any, weight: Any, total: Any) -> None:
    for col in range(total.size):
        total[col] += weight * (a[col] + b[col])


@inlined
def _bend(a: Any, b: Any, middle: Any, limit: Any) -> Any:
    bend = (a + b) - TWO * middle
    return bend if abs(bend) < limit else ZERO


@nested
def _add_bend(a: Any, b: Any, middle: Any, weight: Any, limit: Any, total: Any) -> None:
    for col in range(total.size):
        total[col] += weight * _bend(a[col], b[col], middle[col], limit)


@nested
def _sum_four_bends(lines: Any, weights: Any, limit: Any, factor: Any, out: Any) -> None:
    a, b, c, d, middle, e, f, g, h = lines
    p, q, r, s = weights[0], weights[1], weights[2], weights[3]
    for col in range(out.size):
        x = middle[col]
        outer = p * _bend(a[col], h[col], x, limit) + q * _bend(b[col], g[col], x, limit)
        inner = r * _bend(c[col], f[col], x, limit) + s * _bend(d[col], e[col], x, limit)
        out[col] = factor[col] * (outer + inner)


@nested
def _sum_nine(lines: Any, weights: Any, out: Any) -> None:
    a, b, c, d, middle, e, f, g, h = lines
    p, q, r, s, t = weights[0], weights[1], weights[2], weights[3], weights[4]
    for col in range(out.size):
        outer = p * (a[col] + h[col]) + q * (b[col] + g[col])
        inner = r * (c[col] + f[col]) + s * (d[col] + e[col])
        out[col] = t * middle[col] + (outer + inner)


@inlined
def _nine_along(line: Any, gap: int, end: int) -> Any:
    """Return nine views of a row, columns gap to end - 1, shifted by -4 to 4 pixels."""
    return (
        line[gap - 4 : end - 4], line[gap - 3 : end - 3], line[gap - 2 : end - 2],
        line[gap - 1 : end - 1], line[gap:end], line[gap + 1 : end + 1],
        line[gap + 2 : end + 2], line[gap + 3 : end + 3], line[gap + 4 : end + 4],
    )  # fmt: skip


@inlined
def _nine_across(plane: Any, row: int) -> Any:
    """Return the nine rows from four above a row to four below it."""
    return (
        plane[row - 4], plane[row - 3], plane[row - 2], plane[row - 1], plane[row],
        plane[row + 1], plane[row + 2], plane[row + 3], plane[row + 4],
    )  # fmt: skip


@nested
def _bend_along(
    line: Any, weights: Any, window: Window, limit: Any, factor: Any, out: Any
) -> None:  # fmt: skip
    """Write the change of each pixel of a row by the weighted pairs along the row."""
    gap, end, half = window.gap, window.gap + window.width, window.half
    middle = line[gap:end]
    if half == 4:
        _sum_four_bends(_nine_along(line, gap, end), weights, limit, factor, out)
        return
    fill(out, ZERO)
    for k in range(1, half + 1):
        before, after = line[gap - k : end - k], line[gap + k : end + k]
        _add_bend(before, after, middle, weights[half + k], limit, out)
    multiply(out, factor)


@nested
def _bend_across(
    plane: Any, row: int, weights: Any, half: int, limit: Any, factor: Any, out: Any
) -> None:  # fmt: skip
    if half == 4:
        _sum_four_bends(_nine_across(plane, row), weights, limit, factor, out)
        return
    fill(out, ZERO)
    for k in range(1, half + 1):
        _add_bend(plane[row - k], plane[row + k], plane[row], weights[half + k], limit, out)
    multiply(out, factor)


@compiled
def _invert(line: Any, usable: Any) -> None:
    for col in range(line.size):
        line[col] = usable[col] / larger(line[col], TINY)


@compiled
def _scale(line: Any, factor: Any, out: Any) -> None:
    for col in range(line.size):
        out[col] = line[col] * factor


@nested
def _average_along(line: Any, weights: Any, window: Window, out: Any) -> None:
    """Write the weighted sum along a row with the kernel; pixels without a value count as 0."""
    gap, end, half = window.gap, window.gap + window.width, window.half
    if half == 4:
        _sum_nine(_nine_along(line, gap, end), weights, out)
        return
    _scale(line[gap:end], weights[half], out)
    for k in range(1, half + 1):
        _add_pair(line[gap - k : end - k], line[gap + k : end + k], weights[half + k], out)


@nested
def _average_across(plane: Any, row: int, weights: Any, half: int, out: Any) -> None:
    if half == 4:
        _sum_nine(_nine_across(plane, row), weights, out)
        return
    _scale(plane[row], weights[half], out)
    for k in range(1, half + 1):
        _add_pair(plane[row - k], plane[row + k], weights[half + k], out)


@nested
def _is_equal(a: Any, b: Any) -> bool:
    differing = 0
    for col in range(a.size):
        differing += a[col] != b[col]
    return differing == 0


@merged
def _weigh_along(row: int, images: Any, weights: Any, window: Window) -> None:
    gap, end, half = window.gap, window.gap + window.width, window.half
    line = images[USABLE, row]
    total, remaining = images[ALONG_ROWS, row, gap:end], images[SPARE, row, gap:end]
    fill(total, weights[half])
    fill(remaining, weights[half] * weights[half])
    for k in range(1, half + 1):
        u, v, weight = line[gap - k : end - k], line[gap + k : end + k], weights[half + k]
        _add_weight(u, v, TWO * weight, total)
        _add_weight(u, v, TWO * weight * weight, remaining)
    _invert(total, line[gap:end])
    multiply(remaining, total)
    multiply(remaining, total)
    _average_along(line, weights, window, images[COARSE, row, gap:end])


@merged
def _weigh_across(row: int, images: Any, weights: Any, half: int) -> None:
    usable, noise, line = images[USABLE], images[SPARE], images[USABLE, row]
    total, remaining, support = images[ALONG_COLS, row], images[GAIN, row], images[PER_SUPPORT, row]
    fill(total, weights[half])
    _scale(noise[row], weights[half] * weights[half], remaining)
    for k in range(1, half + 1):
        u, v, weight = usable[row - k], usable[row + k], weights[half + k]
        _add_weight(u, v, TWO * weight, total)
        _add_noise(u, v, noise[row - k], noise[row + k], weight * weight, remaining)
    _invert(total, line)
    multiply(remaining, total)
    multiply(remaining, total)
    _average_across(images[COARSE], row, weights, half, support)
    _invert(support, line)


@merged
def weigh(images: Any, alike: Any, weights: Any, half: int, window: Window) -> None:
    """Write the images that depend on the mask only: sums of weights, noise gain, support.

    A row with the same mask as the preceding row is copied from it, as in most cases.
    """
    rows = images.shape[1]
    alike[0] = 0
    for row in range(rows):
        if row > 0 and _is_equal(images[USABLE, row], images[USABLE, row - 1]):
            alike[row] = alike[row - 1] + 1
            for k in (ALONG_ROWS, SPARE, COARSE):
                copy_row(images[k, row - 1], images[k, row])
        else:
            alike[row] = 0
            _weigh_along(row, images, weights, window)
    for row in range(half, rows - half):
        if alike[row + half] > 2 * half:
            for k in (ALONG_COLS, GAIN, PER_SUPPORT):
                copy_row(images[k, row - 1], images[k, row])
        else:
            _weigh_across(row, images, weights, half)


@merged
def write_lift(images: Any, smoothing: Smoothing, window: Window) -> None:
    """Write the lift l = G x - x, px, of all pixels to image LIFT."""
    weights, limit, rows = smoothing.weights, smoothing.limit_px, images.shape[1]
    gap, end, half = window.gap, window.gap + window.width, window.half
    for row in range(rows):
        line, out = images[VALUE, row], images[LIFT, row, gap:end]
        _bend_along(line, weights, window, limit, images[ALONG_ROWS, row, gap:end], out)
        _sum(line[gap:end], out, images[SPARE, row, gap:end])
    for row in range(half, rows - half):
        out = images[COARSE, row]
        _bend_across(images[SPARE], row, weights, half, limit, images[ALONG_COLS, row], out)
        add(out, images[LIFT, row])


@compiled
def _sum(a: Any, b: Any, out: Any) -> None:
    for col in range(out.size):
        out[col] = a[col] + b[col]


@merged
def write_coarse(images: Any, weights: Any, window: Window) -> None:
    """Write the coarse part c = G l of the lift, px, to image COARSE."""
    gap, end, half, rows = window.gap, window.gap + window.width, window.half, images.shape[1]
    for row in range(half, rows - half):
        _average_along(images[LIFT, row], weights, window, images[SPARE, row, gap:end])
    for row in range(2 * half, rows - 2 * half):
        out = images[COARSE, row]
        _average_across(images[SPARE], row, weights, half, out)
        multiply(out, images[PER_SUPPORT, row])
