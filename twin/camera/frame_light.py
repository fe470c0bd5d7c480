"""Light of a frame before it reaches the sensor: lamp in time, and scattering in the lens.

The lamp's light of frame n of F is, relative to the nominal light,

    g_n = (1 + d n / (F - 1)) (1 + s x_n)                                       linear drift
    g_n = (1 + d (1 - exp(-n / T)) / (1 - exp(-(F - 1) / T))) (1 + s x_n)       exponential drift

with the drift d (`projector.drift_percent`), its time constant T (`drift_frames`), the flicker s
(`flicker_percent`) and independent standard normal numbers x_n, which differ between trials.

A lens scatters the share s of a frame evenly over the image (`camera.stray_percent`), and the share
g by a wide Gaussian (`glare_percent`, `glare_width_percent`). Light that would be scattered beyond
the image's edge is reflected into it, so that the sum over the image is constant.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from reconstruction.arrays import FloatArray, FloatImage
from twin.config import Experiment, seed_sequence
from twin.config.models import Camera, Projector

CELLS_PER_SIGMA = 4
"""Cells in which the image is averaged before it is convolved. The averages and the interpolation
between cells add 1 / 4 cell^2 to the variance, which is subtracted from that of the Gaussian."""

TINY = 1e-30


def lamp_gains(experiment: Experiment, frames: int, trial: int) -> NDArray[np.float32] | None:
    """Return the light of the projector's lamp in each frame (frame,), relative to the nominal.

    It is None if the light is constant, or if the images are not those of a projector's sequence.

    Parameters
    ----------
    frames : number of frames of the sequence
    trial : number of the repetition, which selects the flicker
    """
    projector = experiment.projector
    if not experiment.method.fringes or not (projector.drift_percent or projector.flicker_percent):
        return None
    rng = np.random.default_rng(seed_sequence(experiment, "flicker", trial))
    flicker = 0.01 * projector.flicker_percent * rng.standard_normal(frames)
    gains = _drift(projector, frames) * (1.0 + flicker)
    return np.maximum(gains, 0.0).astype(np.float32)


def _drift(projector: Projector, frames: int) -> FloatArray:
    """Return the light (frame,) by drift only, relative to that of the first frame."""
    place = np.arange(frames, dtype=np.float64)
    if projector.drift_frames is not None:
        place = -np.expm1(-place / projector.drift_frames)
    last = place[-1] if place[-1] > 0.0 else 1.0
    return 1.0 + 0.01 * projector.drift_percent * place / last


def scattered(camera: Camera, radiance: FloatImage) -> FloatImage:
    """Return a frame (row, col) with the light that the lens scatters; its sum is unchanged."""
    stray, glare = 0.01 * camera.stray_percent, 0.01 * camera.glare_percent
    if not (stray or glare):
        return radiance
    total = float(radiance.sum(dtype=np.float64))
    light = radiance * np.float32(1.0 - stray - glare)
    light += np.float32(stray * total / radiance.size)
    if glare:
        blurred = _widely_blurred(radiance, 0.01 * camera.glare_width_percent * radiance.shape[1])
        blurred *= np.float32(glare * total / max(float(blurred.sum(dtype=np.float64)), TINY))
        light += blurred
    return light


def _widely_blurred(image: FloatImage, sigma_px: float) -> FloatImage:
    """Return the convolution of an image with a Gaussian, reflected at the edges, on coarse cells.

    Its sum is that of the image up to the averages of cells that differ in size by a pixel.
    """
    cell_px = max(sigma_px / CELLS_PER_SIGMA, 1.0)
    counts = [max(1, round(size / cell_px)) for size in image.shape]
    cells = _averaged(_averaged(image, counts[0], 0), counts[1], 1)
    sizes_px = [size / count for size, count in zip(image.shape, counts, strict=True)]
    sigmas = [math.sqrt((sigma_px / size) ** 2 - 0.25 * (size > 1.0)) for size in sizes_px]
    cells = gaussian_filter(cells, sigmas, mode="reflect").astype(np.float32)
    return _interpolated(_interpolated(cells, image.shape[0], 0), image.shape[1], 1)


def _averaged(image: FloatArray | FloatImage, count: int, axis: int) -> FloatArray:
    """Return the means of `count` nearly equal parts of an image along an axis."""
    ends = np.linspace(0, image.shape[axis], count + 1).round().astype(int)
    sums = np.add.reduceat(image, ends[:-1], axis=axis, dtype=np.float64)
    return np.asarray(sums / np.expand_dims(np.diff(ends), 1 - axis))


def _interpolated(cells: FloatImage, size: int, axis: int) -> FloatImage:
    """Return an image with `size` pixels along an axis, linear between the centres of the cells."""
    count = cells.shape[axis]
    place = np.clip((np.arange(size) + 0.5) * count / size - 0.5, 0.0, count - 1.0)
    low = np.minimum(place.astype(int), max(count - 2, 0))
    share = np.expand_dims((place - low).astype(np.float32), 1 - axis)
    image: FloatImage = cells.take(np.minimum(low + 1, count - 1), axis)
    first = cells.take(low, axis)
    image -= first
    image *= share
    image += first
    return image
