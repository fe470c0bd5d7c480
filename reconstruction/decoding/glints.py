"""Uncertainty of coordinates by flakes that glint, from the graininess of the modulation.

`_glints` has the formula for a pixel. The width of the footprint, i.e. the area from which a pixel
collects light, is estimated from the graininess: the wider the footprint, the more alike are the
modulations of neighbouring pixels. Let D(k) be the mean square of B(-k) - 2 B + B(+k), relative to
the largest of the three modulations, without the camera's noise; its median over parts of image
rows and columns is used, so that a few edges do not matter. For a Gaussian footprint of
standard deviation s px the modulations at a distance of k px have the correlation g^(k^2), with
g = exp(-1 / (4 s^2)), so that

    D(2) / D(1) = (6 - 8 g^4 + 2 g^16) / (6 - 8 g + 2 g^4)

determines s. Second differences are used because those of smooth shading are small. Sigma is not
changed if D(1) is below three times the camera's noise or that of a contrast of 1 %, because glints
then add little to the variance, or if the modulation is smooth.
"""

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, Reason
from reconstruction.compact import Half
from reconstruction.compiling import run_over_rows
from reconstruction.decoding._decode import Maps
from reconstruction.decoding._glints import GlintPixels, GlintScale, add_glint_rows
from reconstruction.decoding._rows import BIAS
from reconstruction.decoding.plan import SIGMA_UNIT_PX
from reconstruction.patterns import AXES, PatternSet

BAND_ROWS = 128
# Rows and columns of the image from which the width of the footprint is estimated, at most.
SAMPLED = 24
# Length of the parts of these rows and columns of which the median is used.
PART_PX = 48
# Graininess below this multiple of the camera's noise is neglected, and a contrast below 1 %, which
# differences of the pixels' response have.
LEAST_OVER_NOISE, LEAST_BEND = 3.0, 6.0 * 0.01**2
# A larger ratio D(2) / D(1) is not graininess, but shading by the relief (5 for the texture of a
# sprayed coat at 2.5 px per correlation length, 16 for a parabola) or the ripple of the modulation
# by a projector response that is not linear. Both hardly move the centroid. 4: s = 0.8 px.
LARGEST_RATIO = 4.0
CORRELATION = np.linspace(0.0, 0.8, 801)
RATIO = (6.0 - 8.0 * CORRELATION**4 + 2.0 * CORRELATION**16) / (
    6.0 - 8.0 * CORRELATION + 2.0 * CORRELATION**4
)
BOX_FACTOR = 1.0 / 24.0
# The largest of three modulations, by which `_glints` divides, exceeds that of the pixel itself. In
# a footprint wider than a pixel this makes the variance too small, by 1.2 to 1.8 on simulated
# flakes of contrast 0.2 to 1.
DENOMINATOR = 1.5


def add_glints(maps: Maps, patterns: PatternSet) -> None:
    """Add the phase error by glints to the sigmas of single pixels, in place.

    maps : decoded pixels of patterns with fringes
    """
    factor = _factor(maps, patterns)
    if factor == 0.0:
        return
    first, last = AXES.index(patterns.axes[0]), AXES.index(patterns.axes[-1])
    periods_px = [float(patterns.period_along(axis)) for axis in patterns.axes]
    # Neighbours that differ by more are on different surfaces, or one has a wrong order.
    scale = GlintScale(
        np.float32(factor),
        np.array(periods_px, np.float32) / 8.0,
        np.float32(SIGMA_UNIT_PX / BIAS),
        np.float32(BIAS / SIGMA_UNIT_PX),
    )
    at = slice(first, last + 1)
    pixels = GlintPixels(
        maps.coordinate_px[at], maps.sigma[at], maps.reason, maps.modulation[first]
    )
    run_over_rows(add_glint_rows, len(maps.reason), pixels, scale, band_rows=BAND_ROWS)


def _factor(maps: Maps, patterns: PatternSet) -> float:
    """Return `GlintScale.factor` of a decoded image, 0: no graininess.

    Glints are alike along rows and along columns. Steep shading, of grooves for example, may look
    like graininess along one of them only.
    """
    axis, (rows, cols) = AXES.index(patterns.axes[0]), maps.reason.shape
    per_px = 2.0 * np.pi / float(patterns.period_along(patterns.axes[0]))
    images = (maps.modulation[axis], maps.sigma[axis], maps.residual[axis], maps.reason)
    directions = []
    for image_lines in (
        [image[:: max(1, rows // SAMPLED)] for image in images],
        [image.T[:: max(1, cols // SAMPLED)] for image in images],
    ):
        modulation, sigma, residual = (
            Half(np.ascontiguousarray(lines), unit).expand()
            for lines, unit in zip(image_lines[:3], (1.0, SIGMA_UNIT_PX * per_px, 1.0), strict=True)
        )
        # The residual also contains noise that the stated sensor does not have.
        measured = np.float32(2.0 / patterns.steps) * np.square(residual)
        noise = np.maximum(np.square(sigma * modulation), measured)
        usable = image_lines[3] == Reason.VALID
        directions.append([_bends(modulation, noise, usable, step) for step in (1, 2)])
    if any(factor_of(*sums) == 0.0 for sums in directions):
        return 0.0
    near, far = np.mean(directions, axis=0)
    return factor_of(near, far)


def _bends(modulation: FloatImage, noise: FloatImage, usable: BoolImage, step: int) -> FloatArray:
    """Return medians over parts of rows: mean squared second difference, and its part by noise.

    They are 0 without usable pixels.

    Parameters
    ----------
    noise : (row, col) variance of the modulation by noise
    step : distance of the pixels, px
    """
    parts = np.s_[:, : -2 * step], np.s_[:, step:-step], np.s_[:, 2 * step :]
    (a, b, c), (u, v, w) = ([image[part] for part in parts] for image in (modulation, noise))
    is_whole = np.logical_and.reduce([usable[part] for part in parts])
    largest = np.maximum(np.maximum(a, b), np.maximum(c, np.float32(1e-12)))
    weight = is_whole / np.square(largest)
    sums = [is_whole, weight * np.square((a - b) + (c - b)), weight * (u + 4.0 * v + w)]
    starts = np.arange(0, is_whole.shape[1], PART_PX)
    count, bends, expected = (np.add.reduceat(of, starts, axis=1, dtype=np.float64) for of in sums)
    is_used = count > 0.5 * min(PART_PX, is_whole.shape[1])
    if not is_used.any():
        return np.zeros(2)
    return np.array([np.median(of[is_used] / count[is_used]) for of in (bends, expected)])


def factor_of(near: FloatArray, far: FloatArray) -> float:
    """Return the factor of `_glints` from two results of `_bends`, of distance 1 and 2 px.

    The factor is 0 if the modulation has no graininess above the camera's noise.
    """
    close, wide = near[0] - near[1], far[0] - far[1]
    least = max(LEAST_BEND, LEAST_OVER_NOISE * near[1])
    if close <= least or wide > LARGEST_RATIO * close:
        return 0.0
    correlation = float(np.interp(wide / close, RATIO, CORRELATION))
    if correlation <= 0.0:
        return BOX_FACTOR
    square_px2 = -0.25 / np.log(correlation)
    # Along a direction the centroid has the variance s^2 / 2 C^2, and the differences of the
    # modulation over 2 px have the mean square 2 (1 - g^4) C^2, with the contrast C.
    wide_factor = DENOMINATOR * 0.25 * square_px2 / (1.0 - correlation**4)
    return max(BOX_FACTOR, float(wide_factor))
