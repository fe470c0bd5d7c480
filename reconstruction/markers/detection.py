"""Detect dots printed on an elastomer, dark on bright, and estimate their common size.

The image is linear: proportional to the light. A dot is a local maximum, over position and scale,
of the normalised Laplacian of the logarithm of the image (Lindeberg 1998, Int. J. Computer Vision
30, 79). The logarithm makes the result independent of the illumination. A disc of radius r has its
maximum at the scale r / sqrt(2). The scale of the dots is that with the largest sum of squared
maxima, because many dots have one size, whereas noise is weak and vignetting is one large area.
`fitting` then determines the centre of each dot.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage
from scipy.spatial import KDTree

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.errors import FitError
from reconstruction.markers.fitting import FittedDots, fit_dots

# Scales: six per octave, from dots of 1.5 px radius to dots of 1/12 of the image's shorter side.
_SMALLEST_PX, _STEP, _LARGEST_SHARE = 1.06, 2.0 ** (1 / 6), 1.0 / 17.0
# Maximum of the normalised Laplacian in the middle of a disc, over the step of the logarithm.
_OF_DISC = 2.0 / math.e
# Scales that belong to dots of one size: pressed and oblique dots differ by less.
_WITHIN = 1.5
# Least response of a dot, relative to the median of the image's dots: a dot in a shadow, or at the
# border of another, is weaker.
_LEAST_RESPONSE = 0.45
# Responses up to this value are rounding: that of a dot with a contrast of 0.01 % is larger.
_LEAST_VISIBLE = 5e-5
# Least median response over the noise of the responses (robust standard deviation).
_LEAST_OVER_NOISE = 8.0
_SIGMA_PER_MAD = 1.4826
FEWEST_DOTS = 6
# A pixel is in a dot if its light is lower than around it by this share of the dots' contrast; a
# dark area is a dot if it has such shares of a dot's area; width of the rim, px.
_HALF_DARK, _AREAS, _RIM_PX = 0.4, (0.1, 2.5), 2.0
# The logarithm starts at this share of the brightest light: darker pixels are noise.
_DARKEST = 0.01


@dataclass(frozen=True, eq=False)
class DotPattern:
    """Dots of a reference image with the values that all dots have in common.

    Attributes
    ----------
    dots : dots of the image
    radius_px, contrast : medians over the dots; contrast: 1 - light of a dot over that around it
    spacing_px : median distance of a dot from the nearest other dot
    """

    dots: FittedDots
    radius_px: float
    contrast: float
    spacing_px: float


@dataclass(frozen=True, eq=False)
class _Blobs:
    """Maxima over position and scale: places (n, 2) row and col px, scale px, and response."""

    places_px: FloatArray
    scale_px: FloatArray
    response: FloatArray

    def where(self, keep: BoolImage) -> "_Blobs":
        return _Blobs(self.places_px[keep], self.scale_px[keep], self.response[keep])


def linear_light(levels: ArrayLike, gamma: float) -> FloatArray:
    """Return the mean light of the colour channels, (row, col), 0 to 1.

    Parameters
    ----------
    levels : (row, col, 3), 8-bit levels, proportional to light ** (1 / gamma)
    """
    light: FloatArray = (np.asarray(levels, np.float64) / 255.0) ** gamma
    return np.asarray(light.mean(axis=-1))


def find_pattern(light: FloatArray) -> DotPattern:
    """Return the printed dots of an image without contact; size and spacing are estimated.

    Dots at the border of the image, which are not visible as a whole, are left out.

    Parameters
    ----------
    light : (row, col) float, linear image; any unit

    Raises
    ------
    FitError : the image has fewer than six similar dots
    """
    blobs = _dots_of(_maxima(light, _ladder(light.shape)))
    radius_px = np.sqrt(2.0) * float(np.median(blobs.scale_px))
    spacing_px = _spacing_px(blobs.places_px)
    dots = fit_dots(light, blobs.places_px, radius_px, spacing_px)
    dots = dots.where(_alike(dots))
    _require_dots(len(dots.centres_px))
    return DotPattern(
        dots,
        radius_px=float(np.median(dots.radius_px)),
        contrast=float(np.median(dots.contrast)),
        spacing_px=_spacing_px(dots.centres_px),
    )


def find_alike(light: FloatArray, pattern: DotPattern) -> FittedDots:
    """Return the dots of an image of the pressed elastomer, in any order.

    They have the size and the contrast of the reference pattern, within a factor of 1.5 and 2.
    """
    scale_px = pattern.radius_px / np.sqrt(2.0)
    blobs = _maxima(light, [scale_px * _STEP**k for k in range(-4, 5)])
    expected = -_OF_DISC * np.log(1.0 - pattern.contrast)
    blobs = blobs.where(blobs.response > _LEAST_RESPONSE * expected)
    dots = fit_dots(light, blobs.places_px, pattern.radius_px, pattern.spacing_px)
    dots = dots.where(_of_size(dots, pattern.radius_px, pattern.contrast))
    return dots.where(_separate(dots, pattern.radius_px))


def covered_pixels(light: FloatArray, pattern: DotPattern, margin_px: float = 0.0) -> BoolImage:
    """Return the pixels of printed dots, (row, col) bool, also of dots that the border cuts.

    They are dark areas of about the size of a dot, or smaller, with a rim of two pixels.

    Parameters
    ----------
    light : (row, col) float, linear image, with or without contact
    margin_px : further width of the rim, such as the half width of a smoothing
    """
    side = 2 * int(np.ceil(_WITHIN * pattern.radius_px)) + 1
    bright = ndimage.grey_closing(ndimage.gaussian_filter(light, 0.5), side, mode="nearest")
    dark = light < (1.0 - _HALF_DARK * pattern.contrast) * bright
    labels, count = ndimage.label(dark)
    areas = np.bincount(labels.ravel(), minlength=count + 1)
    dot_px2 = np.pi * pattern.radius_px**2
    kept = (areas > _AREAS[0] * dot_px2) & (areas < _AREAS[1] * dot_px2)
    kept[0] = False
    away = ndimage.distance_transform_edt(~kept[labels])
    return np.asarray(away <= _RIM_PX + margin_px)


def _ladder(shape: Sequence[int]) -> list[float]:
    largest_px = max(_LARGEST_SHARE * min(shape), 2.0 * _SMALLEST_PX)
    count = int(np.log(largest_px / _SMALLEST_PX) / np.log(_STEP)) + 1
    return [_SMALLEST_PX * _STEP**k for k in range(count)]


def _maxima(light: FloatArray, scales_px: Sequence[float]) -> _Blobs:
    """Return the maxima of the normalised Laplacian over position and the given scales.

    The first and the last scale have no maxima, because one neighbour is unknown.
    """
    dark = np.log(np.maximum(light, _DARKEST * light.max()))
    dark -= np.median(dark)  # the weights of the truncated filter do not sum to 0 exactly
    stack = np.stack([s**2 * ndimage.gaussian_laplace(dark, s) for s in scales_px])
    highest = ndimage.maximum_filter(stack, size=3, mode="nearest")
    peaks = (stack == highest) & (stack > _LEAST_VISIBLE)
    peaks[0] = peaks[-1] = False
    scale, row, col = np.nonzero(peaks)
    places = np.column_stack([row, col]).astype(np.float64)
    return _Blobs(places, np.array(scales_px)[scale], stack[peaks])


def _dots_of(blobs: _Blobs) -> _Blobs:
    """Return the maxima that are dots of the most frequent scale."""
    _require_dots(len(blobs.response))
    weight = blobs.response**2
    scales_px = np.unique(blobs.scale_px)
    votes = [float(weight[_near(blobs.scale_px, s)].sum()) for s in scales_px]
    scale_px = float(scales_px[int(np.argmax(votes))])
    same = blobs.where(_near(blobs.scale_px, scale_px))
    typical = _weighted_median(same.response, same.response**2)
    dots = same.where(same.response > _LEAST_RESPONSE * typical)
    weak = same.response[same.response <= _LEAST_RESPONSE * typical]
    noise = _SIGMA_PER_MAD * float(np.median(weak)) if len(weak) else 0.0
    _require_dots(len(dots.response) if typical > _LEAST_OVER_NOISE * noise else 0)
    return dots


def _near(scales_px: FloatArray, scale_px: float) -> BoolImage:
    return np.asarray(np.abs(np.log(scales_px / scale_px)) < np.log(_WITHIN))


def _weighted_median(values: FloatArray, weights: FloatArray) -> float:
    order = np.argsort(values)
    share = np.cumsum(weights[order]) / weights.sum()
    return float(values[order][np.searchsorted(share, 0.5)])


def _alike(dots: FittedDots) -> BoolImage:
    if not len(dots.centres_px):
        return np.zeros(0, np.bool_)
    radius_px, contrast = float(np.median(dots.radius_px)), float(np.median(dots.contrast))
    return _of_size(dots, radius_px, contrast) & _separate(dots, radius_px)


def _of_size(dots: FittedDots, radius_px: float, contrast: float) -> BoolImage:
    same_size = np.abs(np.log(dots.radius_px / radius_px)) < np.log(_WITHIN)
    return np.asarray(same_size & (dots.contrast > contrast / 2.0))


def _separate(dots: FittedDots, radius_px: float) -> BoolImage:
    """Return False for a dot that is nearer than a radius to one with a smaller uncertainty."""
    keep = np.ones(len(dots.centres_px), np.bool_)
    if len(keep) > 1:
        sigma = dots.sigma_px.sum(axis=1)
        for one, other in KDTree(dots.centres_px).query_pairs(radius_px):
            keep[one if sigma[one] > sigma[other] else other] = False
    return keep


def _spacing_px(places_px: FloatArray) -> float:
    return float(np.median(KDTree(places_px).query(places_px, k=2)[0][:, 1]))


def _require_dots(count: int) -> None:
    if count < FEWEST_DOTS:
        raise FitError(
            f"found {count} printed dots of one size in the image without contact, needed at least "
            f"{FEWEST_DOTS}; remove [dots] for a gel without dots, or give a sharp image"
        )
