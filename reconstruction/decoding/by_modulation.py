"""Filter the phase by a Gaussian on the complex phasor, which weights pixels by their modulation.

The usual filter of published decoders: z = B exp(i phi) of modulation B and phase phi, filtered
coordinate = period arg(G z) / 2 pi in the pixel's own period. A pixel with a large modulation moves
the result to its own coordinate: on a slope the coordinate is that of the centroid of the
modulation within the window. The difference from the same filter with equal weights is this error.
Relief that the Gaussian removes is not restored. Sigma squared includes the mean squares, over the
window, of this difference and of the coarse part of the relief (see `_filter`), without its noise.
"""

from typing import Any

import numpy as np

from reconstruction.arrays import BoolImage, FloatImage
from reconstruction.compact import Half
from reconstruction.compiling import run_over_rows
from reconstruction.decoding._decode import Maps
from reconstruction.decoding._filter import (
    BAND_ROWS,
    Smoothed,
    gaussian_weights,
    make_smoothing,
    mark_edges,
)
from reconstruction.decoding._relief import COARSE_FLOOR
from reconstruction.decoding.plan import SIGMA_UNIT_PX
from reconstruction.patterns import AXES, PatternSet

SHARE_STEPS = 255.0
TINY = np.float32(1e-30)


def filter_by_modulation(maps: Maps, patterns: PatternSet, taps: int, sigma_px: float) -> Smoothed:
    """Return filtered coordinates with their sigmas, see the module docstring.

    Parameters
    ----------
    maps : maps that were decoded pixel by pixel, of patterns with fringes
    taps, sigma_px : width and standard deviation of the Gaussian
    """
    reason = np.zeros_like(maps.reason)
    run_over_rows(mark_edges, len(reason), maps.reason, reason, band_rows=BAND_ROWS)
    result = Smoothed(
        np.zeros_like(maps.coordinate_px),
        np.zeros_like(maps.sigma),
        np.zeros(maps.sigma.shape, np.uint8),
        reason,
    )
    weights, usable = gaussian_weights(taps, sigma_px), reason == 0
    for axis in patterns.axes:
        k, per_px = AXES.index(axis), 2.0 * np.pi / float(patterns.period_along(axis))
        phase = (per_px * maps.coordinate_px[k].astype(np.float64)).astype(np.float32)
        modulation = usable * Half(maps.modulation[k], 1.0).expand()
        phase_sigma = np.float32(per_px) * Half(maps.sigma[k], SIGMA_UNIT_PX).expand()
        change, noise, bias = filter_phase(phase, modulation, phase_sigma, usable, weights)
        result.coordinate_px[k] = usable * (maps.coordinate_px[k] + change / np.float32(per_px))
        total = usable * (noise + bias)
        result.sigma[k] = Half.of(np.sqrt(total) / np.float32(per_px), SIGMA_UNIT_PX).bits
        share = np.divide(bias, total, out=np.zeros_like(total), where=total > 0.0)
        result.bias_share[k] = np.rint(SHARE_STEPS * share).astype(np.uint8)
    return result


def filter_phase(
    phase: FloatImage,
    modulation: FloatImage,
    sigma: FloatImage,
    usable: BoolImage,
    weights: FloatImage,
) -> tuple[FloatImage, FloatImage, FloatImage]:
    """Return change of the phase, rad, its variance by noise, and its squared bias, rad^2.

    Parameters
    ----------
    phase, sigma : phase of each pixel along the image, and its standard deviation, rad
    modulation : weight of each pixel; 0 if it is not usable
    weights : (tap,) kernel along one direction
    """
    unit = np.exp(np.complex64(1j) * phase)
    total = _smoothed(modulation * unit, weights)
    change = np.angle(total * unit.conj())
    power = (modulation * sigma) ** 2
    # A pixel's noise moves the sum by its part across the sum: cos^2 of the angle between them.
    square = weights * weights
    turned = np.exp(np.complex64(-2j) * (phase + change))
    around = _smoothed(power, square)
    around += (turned * _smoothed(power * unit * unit, square)).real
    noise = 0.5 * around / np.maximum(np.abs(total) ** 2, TINY)
    lift = usable * np.angle(_smoothed(usable * unit, weights) * unit.conj())
    pull = usable * (change - lift)
    per_support = 1.0 / np.maximum(_smoothed(usable.astype(np.float32), weights), TINY)
    coarse = usable * per_support * _smoothed(lift, weights)
    share = COARSE_FLOOR * make_smoothing(weights, 1.0, 1.0).noise[1, 1]
    relief = coarse * coarse - share * (usable * sigma * sigma)
    bias = _smoothed(pull * pull, weights) + np.maximum(_smoothed(relief, weights), 0.0)
    return change, noise, per_support * bias


def _smoothed(image: Any, weights: FloatImage) -> Any:
    """Return a real or complex image, filtered along rows and columns; it is 0 outside."""
    half = len(weights) // 2
    for axis in (0, 1):
        margin = [(half, half) if k == axis else (0, 0) for k in (0, 1)]
        padded, size = np.pad(image, margin), image.shape[axis]
        total = np.zeros_like(image)
        for k, weight in enumerate(weights):
            total += weight * (padded[k : k + size] if axis == 0 else padded[:, k : k + size])
        image = total
    return image
