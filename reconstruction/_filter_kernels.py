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
def _scale(a: Any, weight: Any, out: Any) -> None:
    for i in range(out.size):
        out[i] = weight * a[i]


@compiled
def smooth_row(ring: Any, row: int, weights: Any, lane: Any, out: Any) -> None:
    """Filter row `row` of the image; ring row r % taps holds image row r, all planes.

    `out` is as long as a ring row; its first and last `gap` values stay untouched.
    """
    taps, half = weights.size, weights.size // 2
    end = lane.size - half
    _scale(ring[row % taps], weights[half], lane)
    even = half // 2 * 2
    for k in range(1, even, 2):
        _add_two_pairs(
            ring[(row - k) % taps], ring[(row + k) % taps], weights[half + k],
            ring[(row - k - 1) % taps], ring[(row + k + 1) % taps], weights[half + k + 1], lane,
        )  # fmt: skip
    if half > even:
        _add_pair(ring[(row - half) % taps], ring[(row + half) % taps], weights[0], lane)
    inner = out[half:end]
    _scale(lane[half:end], weights[half], inner)
    for k in range(1, even, 2):
        _add_two_pairs(
            lane[half - k : end - k], lane[half + k : end + k], weights[half + k],
            lane[half - k - 1 : end - k - 1], lane[half + k + 1 : end + k + 1],
            weights[half + k + 1], inner,
        )  # fmt: skip
    if half > even:
        _add_pair(lane[: end - half], lane[half + half :], weights[0], inner)
