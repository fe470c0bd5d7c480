"""The Gaussian on the complex phasor, over a ring of the last image rows.

A ring row holds all planes (real and imaginary parts of every fringe set, then the support) side by
side with gaps of zeros as wide as half the kernel, so that one long loop filters all of them:
plane p begins at gap + p (width + gap).
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import Any, NamedTuple

from reconstruction._jit import compiled
from reconstruction.arrays import FloatImage


class Smoothing(NamedTuple):
    """Symmetric kernel of odd length, its squares to sum 1, 2-D noise gain, support demanded."""

    weights: FloatImage
    square_weights: FloatImage
    noise_gain: float
    min_support: float


@compiled
def _add_pair(a: Any, b: Any, weight: Any, out: Any) -> None:
    for i in range(out.size):
        out[i] += weight * (a[i] + b[i])


@compiled
def _add_two_pairs(
    a: Any, b: Any, weight: Any, c: Any, d: Any, other: Any, out: Any
) -> None:  # fmt: skip
    for i in range(out.size):
        out[i] += weight * (a[i] + b[i]) + other * (c[i] + d[i])


@compiled
def _sum_nine(
    a: Any, b: Any, c: Any, d: Any, middle: Any, e: Any, f: Any, g: Any, h: Any, weights: Any,
    out: Any,
) -> None:  # fmt: skip
    p, q, r, s, t = weights[0], weights[1], weights[2], weights[3], weights[4]
    for i in range(out.size):
        outer = p * (a[i] + h[i]) + q * (b[i] + g[i])
        inner = r * (c[i] + f[i]) + s * (d[i] + e[i])
        out[i] = t * middle[i] + (outer + inner)


@compiled
def _scale(a: Any, weight: Any, out: Any) -> None:
    for i in range(out.size):
        out[i] = weight * a[i]


@compiled
def _filter_across(ring: Any, row: int, weights: Any, lane: Any) -> None:
    """Filter along the columns of the image: over the rows of the ring."""
    taps, half = weights.size, weights.size // 2
    if half == 4:
        _sum_nine(
            ring[(row - 4) % taps], ring[(row - 3) % taps], ring[(row - 2) % taps],
            ring[(row - 1) % taps], ring[row % taps], ring[(row + 1) % taps],
            ring[(row + 2) % taps], ring[(row + 3) % taps], ring[(row + 4) % taps], weights, lane,
        )  # fmt: skip
        return
    _scale(ring[row % taps], weights[half], lane)
    even = half // 2 * 2
    for k in range(1, even, 2):
        _add_two_pairs(
            ring[(row - k) % taps], ring[(row + k) % taps], weights[half + k],
            ring[(row - k - 1) % taps], ring[(row + k + 1) % taps], weights[half + k + 1], lane,
        )  # fmt: skip
    if half > even:
        _add_pair(ring[(row - half) % taps], ring[(row + half) % taps], weights[0], lane)


@compiled
def _filter_along(lane: Any, weights: Any, inner: Any) -> None:
    """Filter along the rows of the image; inner is shorter by half the kernel at both ends."""
    half, size = weights.size // 2, inner.size
    if half == 4:
        _sum_nine(
            lane[:size], lane[1 : size + 1], lane[2 : size + 2], lane[3 : size + 3],
            lane[4 : size + 4], lane[5 : size + 5], lane[6 : size + 6], lane[7 : size + 7],
            lane[8 : size + 8], weights, inner,
        )  # fmt: skip
        return
    end = half + size
    _scale(lane[half:end], weights[half], inner)
    even = half // 2 * 2
    for k in range(1, even, 2):
        _add_two_pairs(
            lane[half - k : end - k], lane[half + k : end + k], weights[half + k],
            lane[half - k - 1 : end - k - 1], lane[half + k + 1 : end + k + 1],
            weights[half + k + 1], inner,
        )  # fmt: skip
    if half > even:
        _add_pair(lane[:size], lane[half + half :], weights[0], inner)


@compiled
def smooth_row(ring: Any, row: int, weights: Any, lane: Any, out: Any) -> None:
    """Filter row `row` of the image; ring row r % taps holds image row r, all planes.

    `out` is as long as a ring row; its first and last `gap` values stay untouched. The default of
    nine taps is one pass each way.
    """
    half = weights.size // 2
    _filter_across(ring, row, weights, lane)
    _filter_along(lane, weights, out[half : lane.size - half])
