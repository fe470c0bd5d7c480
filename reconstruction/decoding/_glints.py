"""Add to the variance of each coordinate the phase error by uneven reflectance within the pixel.

A pixel has the coordinate at the centroid of the light in its footprint. A flake that glints at
the pixel's edge moves the centroid u to the flake. For flakes at random places the variance of u,
along rows and along columns, follows from the modulation B of the pixel and of its two neighbours:

    var u = factor ((B(+1) - B(-1)) / max(B(-1), B, B(+1)))^2 px^2

With factor = 1 / 24 this is exact on average for a footprint of one pixel, both for many weak
flakes (var u = C^2 / 12, where C is the contrast of B from pixel to pixel) and for a single flake
(u is uniform over the pixel). `glints` computes the factor of a wider footprint. The coordinate x
changes by u dx/du.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments
from typing import Any, NamedTuple

import numpy as np

from reconstruction.compiling import compiled, inlined, merged, nested
from reconstruction.decoding._rows import BIAS, fill, larger, pack_row, unpack_row

ZERO, HALF, ONE, TINY = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(1e-30)
PER_MODULATION = np.float32(1.0 / BIAS)
# Value of a pixel without a coordinate, so large that each difference to a neighbour is excluded.
NOWHERE = np.float32(1e30)


class GlintPixels(NamedTuple):
    """Maps of single pixels; the variance by glints is added to sigma in place."""

    coordinate_px: Any  # (axis, row, col) float32
    sigma: Any  # (axis, row, col), packed to 16 bits
    reason: Any  # (row, col)
    modulation: Any  # (row, col), packed to 16 bits, of any unit


class GlintScale(NamedTuple):
    """Quantities that are equal for all pixels.

    factor : var u over the squared relative difference of the modulation, px^2
    limit_px : a larger difference of two neighbouring coordinates is not a slope
    """

    factor: np.float32
    limit_px: Any  # (axis,) float32
    sigma_unit: np.float32  # factor for `unpack_row` of sigmas
    sigma_factor: np.float32  # factor for `pack_row` of sigmas


class GlintLines(NamedTuple):
    """Buffers: three image rows, with a margin of one pixel on either side, and results."""

    modulation: Any  # (3, col + 2)
    coordinate: Any  # (axis, 3, col + 2)
    parts: Any  # (7, col): var u along columns and along rows, sigma, and scratch lines


def make_lines(axes: int, width: int) -> GlintLines:
    return GlintLines(
        np.zeros((3, width + 2), np.float32),
        np.full((axes, 3, width + 2), NOWHERE, np.float32),
        np.zeros((7, width), np.float32),
    )


@nested
def _write_square_step(before: Any, middle: Any, after: Any, factor: Any, out: Any) -> None:
    for col in range(out.size):
        a, b, c = before[col], middle[col], after[col]
        step = (c - a) / larger(larger(a, c), larger(b, TINY))
        out[col] = factor * (step * step)


@nested
def _add_variance(
    before: Any, middle: Any, after: Any, spread: Any, limit: Any, variance: Any, out: Any
) -> None:
    """Write variance + slope^2 spread; the slope is to the neighbours that have a coordinate."""
    for col in range(out.size):
        first, second = middle[col] - before[col], after[col] - middle[col]
        has_first, has_second = abs(first) < limit, abs(second) < limit
        total = (first if has_first else ZERO) + (second if has_second else ZERO)
        slope = total * (HALF if has_first & has_second else ONE)
        out[col] = variance[col] + slope * slope * spread[col]


@nested
def _square(sigma: Any, out: Any) -> None:
    for col in range(out.size):
        out[col] = sigma[col] * sigma[col]


@nested
def _root(variance: Any, sigma: Any, out: Any) -> None:
    """Write the root of a variance; masked pixels, which have no sigma, keep 0."""
    for col in range(out.size):
        root = np.sqrt(variance[col])
        out[col] = root if sigma[col] > ZERO else ZERO


@nested
def _place(x: Any, reason: Any, out: Any) -> None:
    for col in range(x.size):
        out[col] = x[col] if reason[col] == 0 else NOWHERE


@merged
def _load(row: int, maps: GlintPixels, lines: GlintLines) -> None:
    """Load an image row to its lines.

    Outside the image there is no coordinate, and the modulation is that of the nearest pixel.
    """
    height, width = maps.reason.shape
    at, inside = row % 3, slice(1, width + 1)
    target = lines.modulation[at]
    unpack_row(maps.modulation[min(max(row, 0), height - 1)], PER_MODULATION, target[inside])
    target[0], target[width + 1] = target[1], target[width]
    for axis in range(maps.coordinate_px.shape[0]):
        placed = lines.coordinate[axis, at, inside]
        if 0 <= row < height:
            _place(maps.coordinate_px[axis, row], maps.reason[row], placed)
        else:
            fill(placed, NOWHERE)


@inlined
def _around(lines: Any) -> Any:
    """Return three views of a line: the left neighbours, the pixels, and the right neighbours."""
    return lines[:-2], lines[1:-1], lines[2:]


@compiled
def _add_glints(
    first_row: int, end_row: int, maps: GlintPixels, scale: GlintScale, lines: GlintLines
) -> None:
    _load(first_row - 1, maps, lines)
    _load(first_row, maps, lines)
    down, along, sigma = lines.parts[0], lines.parts[1], lines.parts[2]
    own, more, whole, spare = lines.parts[3], lines.parts[4], lines.parts[5], lines.parts[6]
    for row in range(first_row, end_row):
        _load(row + 1, maps, lines)
        above, at, below = (row - 1) % 3, row % 3, (row + 1) % 3
        m, factor = lines.modulation, scale.factor
        left, middle, right = _around(m[at])
        _write_square_step(m[above, 1:-1], middle, m[below, 1:-1], factor, down)
        _write_square_step(left, middle, right, factor, along)
        for axis in range(maps.coordinate_px.shape[0]):
            x, limit = lines.coordinate[axis], scale.limit_px[axis]
            left, middle, right = _around(x[at])
            unpack_row(maps.sigma[axis, row], scale.sigma_unit, sigma)
            _square(sigma, own)
            _add_variance(x[above, 1:-1], middle, x[below, 1:-1], down, limit, own, more)
            _add_variance(left, middle, right, along, limit, more, whole)
            _root(whole, sigma, own)
            pack_row(own, scale.sigma_factor, spare, maps.sigma[axis, row])


def add_glint_rows(first_row: int, end_row: int, maps: GlintPixels, scale: GlintScale) -> None:
    """Add the variance by glints to the sigmas of image rows first_row to end_row - 1."""
    lines = make_lines(maps.coordinate_px.shape[0], maps.reason.shape[1])
    _add_glints(first_row, end_row, maps, scale, lines)
