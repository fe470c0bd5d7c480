"""Filter the projector coordinate by a Gaussian, and restore the relief that the Gaussian removes.

On a plane a Gaussian G reduces the noise without bias. On relief the coordinate x changes by the
lift l = G x - x. The coarse part of the lift, c = G l, contains curvature. The fine part,
f = l - c, contains texture and edges. Both parts contain noise of known variance n. Let E be the
mean square of a part over 17 x 17 pixels, and t a threshold factor. Then the share
w = max(0, 1 - t n / E) of the part is relief and is restored (a Wiener estimate):
x + (1 - w_c) c + (1 - w_f) f. If no part exceeds the noise the result is G x; on strong relief it
is x. The relief that is not restored has the mean square (1 - w)^2 w E, which is part of sigma^2.

A Gaussian on the complex phasor would lose contrast because the phase changes within the window,
and would give brighter pixels more weight than their neighbours. This filter has neither error.

Kernels run over a band of image rows, in patches that fit in the cache.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments
from typing import Any, NamedTuple

import numpy as np

from reconstruction.arrays import FloatArray, FloatImage, Reason
from reconstruction.compiling import compiled, merged, nested, run_over_rows
from reconstruction.decoding._lift import (
    COARSE,
    GAIN,
    LIFT,
    ONE,
    USABLE,
    VALUE,
    VARIANCE,
    ZERO,
    Planes,
    Smoothing,
    Window,
    make_planes,
    weigh,
    write_coarse,
    write_lift,
)
from reconstruction.decoding._relief import (
    BLOCK,
    REACH,
    Blocks,
    add_variances,
    make_blocks,
    restore_relief,
    sum_blocks,
    weigh_blocks,
    write_root,
    write_share,
)
from reconstruction.decoding._rows import BIAS, fill, multiply, pack_row, unpack_row
from reconstruction.decoding._sum import DARK, LOW_MODULATION

PATCH_COLS = 512
VALID, EDGE = np.uint8(Reason.VALID), np.uint8(Reason.EDGE)
# Value of a pixel without a coordinate, so large that every pair with this pixel is excluded.
NOWHERE = np.float32(1e30)


class Unfiltered(NamedTuple):
    """Maps to be filtered, (axis, row, col), and the mask (row, col); valid where `reason` is 0.

    coordinate_px is float32; sigma is packed to 16 bits.
    """

    coordinate_px: Any
    sigma: Any
    reason: Any


class Smoothed(NamedTuple):
    """Filtered maps, (axis, row, col), and the mask.

    sigma is packed to 16 bits. bias_share is the share of sigma squared that is bias, in steps of
    1 / 255.
    """

    coordinate_px: Any
    sigma: Any
    bias_share: Any
    reason: Any  # (row, col)


class FilterPatch(NamedTuple):
    """Patch of the image that is filtered, and its position in `Planes.images`, px.

    The planes also contain a margin of image around the patch.
    """

    top: int  # image row of plane row 0
    left: int
    rows: int
    cols: int
    above: int  # plane row and column of the patch's first pixel
    start: int
    low: int  # plane rows low to high - 1 and columns near to far - 1 are within the image
    high: int
    near: int
    far: int


def mark_edges(first_row: int, end_row: int, reason: Any, out: Any) -> None:
    """Copy rows of the mask, with `EDGE` on valid pixels next to an unlit pixel.

    An unlit pixel has the reason `DARK` or `LOW_MODULATION`.
    """
    _mark_edges(first_row, end_row, reason, np.zeros((3, reason.shape[1] + 2), np.bool_), out)


@compiled
def _mark_edges(first_row: int, end_row: int, reason: Any, unlit: Any, out: Any) -> None:
    rows, width = reason.shape
    for row in range(first_row, end_row):
        for k in range(3):
            _find_unlit(reason[min(max(row + k - 1, 0), rows - 1)], unlit[k, 1 : width + 1])
        middle = unlit[1]
        _mark_edge(
            reason[row], unlit[0, 1 : width + 1], unlit[2, 1 : width + 1], middle[:width],
            middle[2:], out[row],
        )  # fmt: skip


@nested
def _find_unlit(reason: Any, unlit: Any) -> None:
    for col in range(reason.size):
        unlit[col] = (reason[col] == DARK) | (reason[col] == LOW_MODULATION)


@nested
def _mark_edge(reason: Any, above: Any, below: Any, left: Any, right: Any, out: Any) -> None:
    for col in range(out.size):
        is_edge = (above[col] | below[col] | left[col] | right[col]) & (reason[col] == VALID)
        out[col] = EDGE if is_edge else reason[col]


@nested
def _mark(reason: Any, usable: Any) -> None:
    for col in range(usable.size):
        usable[col] = ONE if reason[col] == 0 else ZERO


@nested
def _place(x: Any, usable: Any, out: Any) -> None:
    for col in range(out.size):
        out[col] = x[col] if usable[col] > ZERO else NOWHERE


@merged
def _load_mask(reason: Any, patch: FilterPatch, images: Any) -> None:
    for row in range(images.shape[1]):
        fill(images[USABLE, row], ZERO)
    first, end = patch.left + patch.near, patch.left + patch.far
    for row in range(patch.low, patch.high):
        line = reason[patch.top + row, first:end]
        _mark(line, images[USABLE, row, patch.near : patch.far])


@merged
def _load_axis(
    coordinate_px: Any, sigmas: Any, patch: FilterPatch, sigma_unit: Any, images: Any
) -> None:
    """Write coordinate, px, and variance, px^2, of every pixel of a patch to its planes."""
    for row in range(images.shape[1]):
        fill(images[VALUE, row], NOWHERE)
        fill(images[VARIANCE, row], ZERO)
    near, far = patch.near, patch.far
    first, end = patch.left + near, patch.left + far
    for row in range(patch.low, patch.high):
        line, variance = coordinate_px[patch.top + row, first:end], images[VARIANCE, row, near:far]
        _place(line, images[USABLE, row, near:far], images[VALUE, row, near:far])
        unpack_row(sigmas[patch.top + row, first:end], sigma_unit, variance)
        multiply(variance, variance)


@merged
def _write(
    axis: int,
    images: Any,
    patch: FilterPatch,
    smoothing: Smoothing,
    blocks: Blocks,
    target: Smoothed,
) -> None:
    inside, first = slice(patch.start, patch.start + patch.cols), patch.left + patch.start
    out, spread = slice(first, first + patch.cols), blocks.spread
    lines = blocks.written
    total, sigma, spare = lines[0, : patch.cols], lines[1, : patch.cols], lines[2, : patch.cols]
    block = -1
    for row in range(patch.above, patch.above + patch.rows):
        if row // BLOCK != block:
            block = row // BLOCK
            weigh_blocks(block, smoothing, blocks)
        at = patch.top + row
        value, usable = images[VALUE, row, inside], images[USABLE, row, inside]
        lift, coarse = images[LIFT, row, inside], images[COARSE, row, inside]
        whole, part = spread[0, inside], spread[1, inside]
        restore_relief(
            value, usable, lift, coarse, whole, part, target.coordinate_px[axis, at, out]
        )
        add_variances(
            images[VARIANCE, row, inside], images[GAIN, row, inside], smoothing.noise[0, 0],
            spread[2, inside], spread[3, inside], spread[4, inside], total,
        )  # fmt: skip
        write_share(spread[5, inside], total, usable, target.bias_share[axis, at, out])
        write_root(total, usable, sigma)
        pack_row(sigma, smoothing.sigma_factor, spare, target.sigma[axis, at, out])


@compiled
def _smooth_patch(
    patch: FilterPatch, source: Unfiltered, smoothing: Smoothing, planes: Planes, blocks: Blocks,
    target: Smoothed,
) -> None:  # fmt: skip
    half, images = smoothing.weights.size // 2, planes.images
    window = Window(half, images.shape[2] - 2 * half, half)
    _load_mask(source.reason, patch, images)
    weigh(images, planes.alike, smoothing.weights, half, window)
    for axis in range(source.coordinate_px.shape[0]):
        coordinate_px, sigmas = source.coordinate_px[axis], source.sigma[axis]
        _load_axis(coordinate_px, sigmas, patch, smoothing.sigma_unit, images)
        write_lift(images, smoothing, window)
        write_coarse(images, smoothing.weights, window)
        sum_blocks(images, half, blocks.lines, blocks.sums)
        _write(axis, images, patch, smoothing, blocks, target)


def _whole(size: int) -> int:
    return (size + BLOCK - 1) // BLOCK * BLOCK


def smooth_rows(
    first_row: int, end_row: int, source: Unfiltered, smoothing: Smoothing, target: Smoothed
) -> None:
    """Filter image rows first_row to end_row - 1 in patches, and write them to `target`."""
    rows, width = source.reason.shape
    margin, count = _whole(2 * (smoothing.weights.size // 2) + REACH), end_row - first_row
    above = margin + first_row % BLOCK
    top, high = first_row - above, _whole(above + count + margin)
    # One set for all patches: allocating new memory costs more than the arithmetic.
    planes = make_planes(high, _whole(min(PATCH_COLS, width)) + 2 * margin)
    blocks = make_blocks(*planes.images.shape[1:])
    low, high = max(-top, 0), min(high, rows - top)
    for first_col in range(0, width, PATCH_COLS):
        cols, left = min(PATCH_COLS, width - first_col), first_col - margin
        near, far = max(-left, 0), min(planes.images.shape[2], width - left)
        patch = FilterPatch(top, left, count, cols, above, margin, low, high, near, far)
        _smooth_patch(patch, source, smoothing, planes, blocks, target)


# The 20 rows on either side of a band are smoothed twice; with fewer bands cores would be idle.
BAND_ROWS = 128


def smooth(
    source: Unfiltered, taps: int, sigma_px: float, limit_px: float, unit_px: float
) -> Smoothed:
    """Return the filtered coordinates, their sigmas, and the share of bias in the variance.

    The footprint of a pixel next to an unlit pixel may cross the edge of the lit area. The pixel is
    therefore excluded and masked as `EDGE`.

    Parameters
    ----------
    source : maps that were decoded pixel by pixel
    taps, sigma_px : width and standard deviation of the Gaussian
    limit_px : a pair of pixels is excluded if its mean differs by more than half of this value from
        the pixel in its middle
    unit_px : unit of the packed sigmas
    """
    target = Smoothed(
        np.zeros(source.coordinate_px.shape, np.float32),
        np.zeros(source.sigma.shape, np.uint16),
        np.zeros(source.sigma.shape, np.uint8),
        np.zeros(source.reason.shape, np.uint8),
    )
    smoothing = make_smoothing(gaussian_weights(taps, sigma_px), limit_px, unit_px)
    rows = source.reason.shape[0]
    run_over_rows(mark_edges, rows, source.reason, target.reason, band_rows=BAND_ROWS)
    lit = source._replace(reason=target.reason)
    run_over_rows(smooth_rows, rows, lit, smoothing, target, band_rows=BAND_ROWS)
    return target


def make_smoothing(weights: FloatImage, limit_px: float, unit_px: float) -> Smoothing:
    """Return the kernel and the factors of the noise that depend on it, see `Smoothing`.

    Parameters
    ----------
    weights : (tap,) kernel along one direction
    limit_px, unit_px : as in `smooth`
    """
    gauss = np.outer(weights, weights).astype(np.float64)
    whole = np.pad(gauss, gauss.shape[0] // 2)
    lift = whole.copy()
    lift[lift.shape[0] // 2, lift.shape[1] // 2] -= 1.0
    inner = np.s_[gauss.shape[0] // 2 : -(gauss.shape[0] // 2)] if gauss.size > 1 else np.s_[:]
    coarse = _convolved(lift[inner, inner], gauss)
    parts = np.stack([whole, coarse, lift - coarse])
    middle = parts.shape[1] // 2
    return Smoothing(
        weights,
        np.einsum("aij,bij->ab", parts, parts).astype(np.float32),
        parts[:, middle, middle].astype(np.float32),
        np.float32(limit_px),
        np.float32(unit_px / BIAS),
        np.float32(BIAS / unit_px),
    )


def _convolved(image: FloatArray, kernel: FloatArray) -> FloatArray:
    """Return the full convolution of two images.

    The result is equal to that of SciPy to the last bit. Importing SciPy would take 2 s.
    """
    rows, cols = image.shape
    total = np.zeros((rows + kernel.shape[0] - 1, cols + kernel.shape[1] - 1))
    for (row, col), weight in np.ndenumerate(kernel):
        total[row : row + rows, col : col + cols] += weight * image
    return total


def gaussian_weights(taps: int, sigma_px: float) -> FloatImage:
    """Return symmetric weights of odd length that sum to 1; for `taps` = 0 the single weight 1.

    A kernel with an even number of taps has no centre tap: anchored at either middle tap it shifts
    the image by half a pixel. The mean of the two kernels has one tap more and no shift.
    """
    if taps == 0:
        return np.ones(1, np.float32)
    offsets = np.arange(taps) - 0.5 * (taps - 1)
    weights = np.exp(-0.5 * (offsets / sigma_px) ** 2)
    if taps % 2 == 0:
        weights = np.append(weights, 0.0) + np.insert(weights, 0, 0.0)
    return np.asarray((weights / weights.sum()).astype(np.float32))
