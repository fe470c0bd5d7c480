"""Sum the equations for the relative light of frames, and add its uncertainty to sigma.

See `gains` for the equations and symbols.
"""

from typing import Any, NamedTuple

import numpy as np

from reconstruction.compiling import compiled, inlined
from reconstruction.decoding._rows import pack_row, unpack_row

TINY = 1e-30


class SampledSet(NamedTuple):
    """Sampled levels of one fringe set, and the limits of the pixels that are used."""

    levels: Any  # (step, row, col) float32, DN
    scale: Any  # (row, col) float32, see `decode`
    dark_dn: float  # level without light of the projector
    factors: Any  # (step,) float64, 1 / assumed relative light
    basis: Any  # (step, 3), levels of unit A, B cos(phi) and B sin(phi)
    tiles: int  # number of tiles along each image axis
    limits: tuple[float, float, float]  # black level, clipped, level of a lost frame, DN
    noise: tuple[float, float]  # gain, DN per electron, and variance in the dark, DN^2
    most_variance: float  # largest noise variance over B^2
    most_misfit: float  # largest `TileSums.misfit` of a pixel that is used


class TileSums(NamedTuple):
    """Sums over the pixels of each tile, weighted by 1 / variance; the features are in `gains`.

    misfit is read and written: sum of squared residuals over the variance of a level.
    """

    pairs: Any  # (tile, feature, feature), products of features
    products: Any  # (tile, feature, step), products of feature and level
    counts: Any  # (tile,) int64, number of pixels
    misfit: Any  # (row, col); -1: the pixel is not used


class PixelScratch(NamedTuple):
    """Work arrays for one pixel."""

    levels: Any  # (step,) float64, DN above the level without light
    features: Any  # (feature,)


@inlined
def _read(sample: SampledSet, row: int, col: int, levels: Any) -> bool:
    """Write the levels of a pixel; return True if none is clipped, lost or not finite."""
    black, clipped, lowest = sample.limits
    limit = black + (clipped - black) * sample.scale[row, col]
    is_whole = True
    for n in range(levels.size):
        level = np.float64(sample.levels[n, row, col])
        is_whole = is_whole and lowest < level < limit
        levels[n] = (level - sample.dark_dn) * sample.factors[n]
    return is_whole


@inlined
def _describe(sample: SampledSet, pixel: PixelScratch) -> Any:
    """Write the features of a pixel; return its weight, 0 for too few fringes, and its misfit."""
    levels, features = pixel
    steps = levels.size
    a, p, q, square = 0.0, 0.0, 0.0, 0.0
    for n in range(steps):
        level = levels[n]
        a, square = a + level, square + level * level
        p, q = p + sample.basis[n, 1] * level, q + sample.basis[n, 2] * level
    a, p, q = a / steps, 2.0 * p / steps, 2.0 * q / steps
    power = p * p + q * q
    gain, dark_dn2 = sample.noise
    variance = dark_dn2 + gain * max(a + sample.dark_dn - sample.limits[0], 0.0)
    if not (a > 0.0 and variance <= sample.most_variance * power):
        return 0.0, -1.0
    features[0], features[1], features[2] = a, p, q
    length = max(np.sqrt(power), TINY)
    c, s = p / length, q / length
    for k in range(3, features.size - 1, 2):
        p, q = p * c - q * s, p * s + q * c
        features[k], features[k + 1] = p, q
    features[features.size - 1] = sample.limits[1]
    return 1.0 / variance, max(square - steps * (a * a + 0.5 * power), 0.0) / variance


@compiled
def sum_tiles(sample: SampledSet, pixel: PixelScratch, sums: TileSums) -> None:
    """Add up the pixels of all tiles; `sums` has zeros, except `misfit`."""
    _, rows, cols = sample.levels.shape
    for row in range(rows):
        for col in range(cols):
            tile = row * sample.tiles // rows * sample.tiles + col * sample.tiles // cols
            weight, misfit = 0.0, -1.0
            if 0.0 <= sums.misfit[row, col] <= sample.most_misfit and _read(
                sample, row, col, pixel.levels
            ):
                weight, misfit = _describe(sample, pixel)
            sums.misfit[row, col] = misfit
            if weight > 0.0:
                sums.counts[tile] += 1
                _add(pixel, weight, sums.pairs[tile], sums.products[tile])


@inlined
def _add(pixel: PixelScratch, weight: float, pairs: Any, products: Any) -> None:
    levels, features = pixel
    for f in range(features.size):
        value = weight * features[f]
        for g in range(features.size):
            pairs[f, g] += value * features[g]
        for n in range(levels.size):
            products[f, n] += value * levels[n]


class Widening(NamedTuple):
    """Packed maps of one axis, (row, col), and the added variance.

    The variance of the coordinate, px^2, is first_px2 ((mean - dark_dn) / modulation)^2 +
    second_px2. The factors are those of `pack_row` and `unpack_row`.
    """

    sigma: Any  # uint16, overwritten
    share: Any  # uint8, share of the bias in sigma squared, overwritten
    mean: Any  # uint16
    modulation: Any  # uint16
    first_px2: np.float32
    second_px2: np.float32
    dark_dn: np.float32
    per_sigma: np.float32  # of unpacking
    per_level: np.float32  # of unpacking
    pack: np.float32  # of packing sigma


def widen_rows(first_row: int, end_row: int, widening: Widening) -> None:
    """Add the variance to sigma squared in rows first_row to end_row - 1 of one axis."""
    _widen_band(first_row, end_row, widening, np.zeros((4, widening.sigma.shape[1]), np.float32))


@compiled
def _widen_band(first_row: int, end_row: int, widening: Widening, lines: Any) -> None:
    sigma, mean, modulation, spare = lines[0], lines[1], lines[2], lines[3]
    one, half = np.float32(1.0), np.float32(0.5)
    for row in range(first_row, end_row):
        share = widening.share[row]
        unpack_row(widening.sigma[row], widening.per_sigma, sigma)
        unpack_row(widening.mean[row], widening.per_level, mean)
        unpack_row(widening.modulation[row], widening.per_level, modulation)
        for col in range(sigma.size):
            if sigma[col] > np.float32(0.0):
                ratio = (mean[col] - widening.dark_dn) / modulation[col]
                more = widening.first_px2 * ratio * ratio + widening.second_px2
                growth = one + more / (sigma[col] * sigma[col])
                sigma[col] *= np.sqrt(growth)
                share[col] = np.uint8(np.float32(share[col]) / growth + half)
        pack_row(sigma, widening.pack, spare, widening.sigma[row])
