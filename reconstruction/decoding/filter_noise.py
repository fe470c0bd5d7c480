"""Propagate the noise of single pixels through the filter of the coordinate, as a linear map.

For a given relief the filter (see `_filter`) adds to each pixel a share of its lift and of the
lift's coarse part. Noise n of the single pixels becomes e = K n of the filtered ones, with
K = 1 + (1 - f) L + (f - c) P G L. L is the map to the lift, G the Gaussian, P the division by the
sum of its weights on usable pixels. c and f are the shares of coarse and fine part that are relief.
n is independent from pixel to pixel; e is not. A parameter that is fitted to filtered pixels with
the derivatives s has the variance sum_j (K^T s)_j^2 var n_j, which includes the covariance of
neighbours. The shares depend on the data. Here they are computed from the relief without noise and
the expected squares of the noise, without random samples. Fluctuations of the shares with the noise
are neglected.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import correlate1d

from reconstruction.arrays import BoolImage, FloatArray, ReasonImage
from reconstruction.decoding._filter import gaussian_weights, make_smoothing, mark_edges
from reconstruction.decoding._lift import Smoothing
from reconstruction.decoding._relief import (
    AROUND,
    BLOCK,
    find_shares,
    predict_bias,
    weigh_edge,
    weigh_neighbours,
    weigh_own,
)

Maps = Sequence[FloatArray]


def without_edges(reason: ReasonImage) -> ReasonImage:
    """Return the mask (row, col) with `EDGE` on valid pixels next to an unlit pixel.

    It is the mask that the decoder's filter returns.
    """
    marked = np.zeros_like(reason)
    mark_edges(0, reason.shape[0], np.ascontiguousarray(reason), marked)
    return marked


@dataclass(frozen=True, eq=False)
class _Bends:
    """The Gaussian along one direction of an image, as weighted second differences of pixel pairs.

    Attributes
    ----------
    axis : 0: pairs along a column, 1: pairs along a row
    weights : (half,) weights of the pairs, nearest pair first
    pairs : for each distance (row, col) bool, True if both pixels of the pair about a pixel count
    factor : (row, col) 1 / sum of weights; 0 for pixels that are not usable
    """

    axis: int
    weights: FloatArray
    pairs: tuple[BoolImage, ...]
    factor: FloatArray

    @classmethod
    def of(
        cls, value: FloatArray, usable: BoolImage, weights: FloatArray, limit: float, axis: int
    ) -> "_Bends":
        half = len(weights) // 2
        factor, pairs = np.full(value.shape, float(weights[half])), []
        for k in range(1, half + 1):
            inner, before, after = _pair_views(k, axis)
            both = usable[inner] & usable[before] & usable[after]
            factor[inner] += 2.0 * weights[half + k] * both
            bend = value[before] + value[after]
            bend -= 2.0 * value[inner]
            pair = np.zeros(value.shape, np.bool_)
            pair[inner] = both & (np.abs(bend, out=bend) < limit)
            pairs.append(pair)
        return cls(axis, weights[half + 1 :], tuple(pairs), usable / factor)

    def of_values(self, value: FloatArray) -> FloatArray:
        """Return the change of each pixel of an image by its pairs, (row, col)."""
        total = np.zeros_like(value)
        for weight, pair, (inner, before, after) in self._weighted_pairs():
            bend = value[before] + value[after]
            bend -= 2.0 * value[inner]
            bend *= weight * pair[inner]
            total[inner] += bend
        total *= self.factor
        return total

    def transposed(self, slope: FloatArray) -> FloatArray:
        """Return the adjoint of `of_values`, applied to derivatives (row, col)."""
        scaled, total = self.factor * slope, np.zeros_like(slope)
        for weight, pair, (inner, before, after) in self._weighted_pairs():
            part = weight * pair[inner] * scaled[inner]
            total[before] += part
            total[after] += part
            total[inner] -= 2.0 * part
        return total

    def gain(self, variance: FloatArray) -> FloatArray:
        """Return the variance (row, col) after the Gaussian of noise with the given variance.

        The noise is independent from pixel to pixel.
        """
        middle = float(1.0 - 2.0 * self.weights.sum())
        total = middle**2 * variance
        for weight, pair, (inner, before, after) in self._weighted_pairs():
            both = variance[before] + variance[after]
            both *= weight**2 * pair[inner]
            total[inner] += both
        total *= self.factor**2
        return total

    def _weighted_pairs(self) -> Iterator[tuple[float, BoolImage, "_Views"]]:
        for k, (weight, pair) in enumerate(zip(self.weights, self.pairs, strict=True), start=1):
            yield float(weight), pair, _pair_views(k, self.axis)


_View = tuple[slice, ...]
_Views = tuple[_View, _View, _View]


def _pair_views(by: int, axis: int) -> _Views:
    """Return three index tuples: the pixels with both neighbours, and those two neighbours.

    by : distance of pixel and neighbour, px
    axis : 0: neighbours along a column, 1: along a row
    """
    rest = (slice(None),) * axis
    ends = slice(by, -by), slice(None, -2 * by), slice(2 * by, None)
    inner, before, after = ((*rest, part) for part in ends)
    return inner, before, after


@dataclass(frozen=True, eq=False)
class FilterNoise:
    """Effect of the filter on the noise of one coordinate, for a given relief.

    Attributes
    ----------
    variance_px2 : (row, col) variance of the filtered coordinate by noise, as the decoder predicts
        it, without the bias
    bias_px2 : (row, col) mean square of the relief that the filter may remove
    """

    variance_px2: FloatArray
    bias_px2: FloatArray
    _single_px2: FloatArray
    _along: _Bends
    _across: _Bends
    _gauss: FloatArray
    _support: FloatArray
    _of_lift: FloatArray
    _of_coarse: FloatArray

    def noise(self, slope: FloatArray) -> float:
        """Return the standard deviation by noise of sum(slope * filtered coordinate).

        slope : (row, col) derivative of a parameter by the filtered coordinate, unit per px
        """
        rows, cols = _around(slope != 0.0, 4 * (len(self._gauss) // 2))
        part = self._part(rows, cols).transposed(slope[rows, cols])
        return float(np.sqrt(np.sum(part**2 * self._single_px2[rows, cols])))

    def transposed(self, slope: FloatArray) -> FloatArray:
        """Return K^T s, (row, col): the derivatives by the unfiltered coordinate of each pixel.

        slope : (row, col) s, the derivatives by the filtered coordinate
        """
        through = _smoothed(self._support * self._of_coarse * slope, self._gauss)
        lifted = self._of_lift * slope + through
        across = self._across.transposed(lifted)
        return np.asarray(slope + across + self._along.transposed(lifted + across))

    def _part(self, rows: slice, cols: slice) -> "FilterNoise":
        """Return the map for a part of the image; exact for derivatives not near its border."""
        cut = np.s_[rows, cols]
        along, across = (
            _Bends(b.axis, b.weights, tuple(p[cut] for p in b.pairs), b.factor[cut])
            for b in (self._along, self._across)
        )
        return FilterNoise(
            self.variance_px2[cut], self.bias_px2[cut], self._single_px2[cut],
            along, across, self._gauss, self._support[cut],
            self._of_lift[cut], self._of_coarse[cut],
        )  # fmt: skip


def filter_noise(
    coordinate_px: FloatArray,
    single_px2: FloatArray,
    usable: BoolImage,
    *,
    taps: int,
    sigma_px: float,
    limit_px: float,
    restores: bool = True,
) -> FilterNoise:
    """Return the effect of the filter on the noise of the coordinate, for a given relief.

    Parameters
    ----------
    coordinate_px : (row, col) coordinate without noise
    single_px2 : (row, col) noise variance of each pixel's unfiltered coordinate, px^2
    usable : (row, col) bool, pixels that are filtered
    taps, sigma_px : width and standard deviation of the Gaussian; taps 0: no filter
    limit_px : a pair of pixels is excluded if its mean differs by more than half of this value from
        the pixel in its middle
    restores : False if the filter does not restore relief, as with `weights` "modulation". The
        modulation is assumed equal over the window
    """
    value = np.where(usable, coordinate_px, 0.0).astype(np.float64)
    variance = np.where(usable, single_px2, 0.0).astype(np.float64)
    smoothing = make_smoothing(gaussian_weights(taps, sigma_px), limit_px, 1.0)
    gauss = smoothing.weights.astype(np.float64)
    along = _Bends.of(value, usable, gauss, limit_px, 1)
    across = _Bends.of(value + along.of_values(value), usable, gauss, limit_px, 0)
    support = usable / np.maximum(_smoothed(usable.astype(np.float64), gauss), 1e-30)
    lift = _lift(value, along, across)
    coarse = support * _smoothed(lift, gauss)
    blocks = _block_values(lift, coarse, variance, usable, smoothing, restores=restores)
    of_lift, of_coarse, own, neighbours, edge, bias = (_per_pixel(b, value.shape) for b in blocks)
    gain = across.gain(along.gain(usable.astype(np.float64)))
    excess = np.maximum(gain - float(smoothing.noise[0, 0]), 0.0)
    total = usable * (own * variance + neighbours + excess * edge)
    return FilterNoise(
        total, usable * bias, variance, along, across, gauss, support, of_lift, of_coarse
    )


def _lift(value: FloatArray, along: _Bends, across: _Bends) -> FloatArray:
    first = along.of_values(value)
    return first + across.of_values(value + first)


def _smoothed(image: FloatArray, gauss: FloatArray) -> FloatArray:
    if len(gauss) == 1:
        return image
    rows = correlate1d(image, gauss, axis=1, mode="constant")
    return np.asarray(correlate1d(rows, gauss, axis=0, mode="constant"))


def _block_values(
    lift: FloatArray, coarse: FloatArray, variance: FloatArray, usable: BoolImage,
    smoothing: Smoothing, *, restores: bool,
) -> Maps:  # fmt: skip
    """Return six maps (block row, block col) of the values that `_relief` computes for each block.

    The values are the factors of lift and of coarse part, the weight of the pixel's own variance,
    the variance of the neighbours, the factor of the excess gain, and the bias.
    """
    noise, count = _around_blocks(variance), _around_blocks(usable.astype(np.float64))
    large = _around_blocks(coarse**2) + smoothing.noise[1, 1] * noise
    small = _around_blocks((lift - coarse) ** 2) + smoothing.noise[2, 2] * noise
    of_coarse, of_fine, of_noise, number = (
        np.asarray(sums, np.float32).ravel() for sums in (large, small, noise, count)
    )
    c, f, own, bias, neighbours, edge = np.zeros((6, large.size), np.float32)
    if restores:
        find_shares(of_coarse, of_fine, of_noise, smoothing.noise, c, f)
    weigh_own(c, f, smoothing.centre, own)
    predict_bias(of_coarse, of_fine, c, f, number, bias)
    weigh_neighbours(c, f, own, of_noise, number, np.zeros_like(bias), smoothing.noise, neighbours)
    weigh_edge(c, f, of_noise, number, edge)
    shape = -(-lift.shape[0] // BLOCK), -(-lift.shape[1] // BLOCK)
    block_values = (1.0 - f, f - c, own, neighbours, edge, bias)
    return [np.asarray(values.reshape(shape), np.float64) for values in block_values]


def _around_blocks(image: FloatArray) -> FloatArray:
    """Return the sums of an image over 5 x 5 blocks about each block, (block row, block col)."""
    rows, cols = image.shape
    padded = np.pad(image, ((0, -rows % BLOCK), (0, -cols % BLOCK)))
    shape = padded.shape[0] // BLOCK, BLOCK, padded.shape[1] // BLOCK, BLOCK
    sums = padded.reshape(shape).sum(axis=(1, 3))
    ones = np.ones(2 * AROUND + 1)
    down = correlate1d(sums, ones, axis=0, mode="constant")
    return np.asarray(correlate1d(down, ones, axis=1, mode="constant"))


def _per_pixel(blocks: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    spread = np.repeat(np.repeat(blocks, BLOCK, axis=0), BLOCK, axis=1)
    return spread[: shape[0], : shape[1]]


def _around(marked: BoolImage, margin: int) -> tuple[slice, slice]:
    """Return the slices of rows and columns that contain all marked pixels, with a margin, px."""
    slices = []
    for axis, size in ((1, marked.shape[0]), (0, marked.shape[1])):
        places = np.flatnonzero(marked.any(axis=axis))
        first, last = (places[0], places[-1]) if len(places) else (0, 0)
        slices.append(slice(max(0, first - margin), min(size, last + margin + 1)))
    return slices[0], slices[1]
