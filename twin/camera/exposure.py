"""Expose the sensor: linear radiance in, digital numbers out (EMVA 1288 release 4 model).

Order of the steps matters: photons and dark current arrive as one Poisson process, the pixel
saturates at its full well, and only then read noise, gain, quantisation and the converter's limits
follow.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatImage
from reconstruction.cores import threads
from reconstruction.errors import InputError
from reconstruction.rig.sensor import SensorNoise
from twin.camera.sensor import (
    dark_offset_e,
    electrons_per_ms,
    full_well_e,
    gain_dn_per_e,
    largest_code_dn,
    noise_model,
    read_noise_e,
)
from twin.camera.shot_noise import photon_counts
from twin.config import Experiment, seed_sequence
from twin.config.models import Camera

_THREADS = min(2, threads())


@dataclass(frozen=True)
class Exposed:
    """The recorded sequence.

    Attributes
    ----------
    stack : (frame, row, col) uint16, DN; float32 when camera.noise is off
    exposure_ms : float
        As set, or as found by the automatic exposure.
    sensor : SensorNoise
    """

    stack: NDArray[np.uint16] | FloatImage
    exposure_ms: float
    sensor: SensorNoise


@dataclass(frozen=True)
class _Pixels:
    """Fixed pattern of one camera: relative response and dark offset (e-) per pixel."""

    response: FloatImage
    offset_e: FloatImage


def expose(
    experiment: Experiment,
    radiance: Sequence[FloatImage],
    white_frame: int,
    trial: int = 0,
    progress: Callable[[float], None] = lambda _: None,
) -> Exposed:
    """Record a radiance stack.

    Parameters
    ----------
    experiment : Experiment
    radiance : sequence of (row, col) float32, mW / (mm^2 sr)
    white_frame : int
        Index of the white frame, on which the automatic exposure measures.
    trial : int
        Repetition: same camera and same fixed pattern, new temporal noise.
    progress : callable
        Called with the finished fraction.
    """
    camera = experiment.camera
    exposure_ms = choose_exposure_ms(experiment, radiance[white_frame])
    per_radiance = exposure_ms * electrons_per_ms(camera, experiment.projector.wavelength_nm)
    dark_e = camera.dark_current_e_per_s * camera.binning**2 * exposure_ms * 1e-3
    shape = radiance[0].shape
    stack = np.zeros((len(radiance), *shape), np.uint16 if camera.noise else np.float32)
    pixels = _fixed_pattern(experiment, shape)

    def record(frame: int) -> None:
        mean_e = radiance[frame] * np.float32(per_radiance)
        if not camera.noise:
            stack[frame] = _expected_dn(camera, mean_e + np.float32(dark_e))
            return
        rng = np.random.default_rng(seed_sequence(experiment, "sensor", trial, frame))
        stack[frame] = _recorded_dn(camera, mean_e, dark_e, pixels, rng)

    with ThreadPoolExecutor(_THREADS) as pool:
        for done, _ in enumerate(pool.map(record, range(len(radiance))), start=1):
            progress(done / len(radiance))
    return Exposed(stack, exposure_ms, noise_model(camera))


def choose_exposure_ms(experiment: Experiment, white: FloatImage) -> float:
    """Return the set exposure, or the one that puts the white frame at `auto_level`.

    Raises
    ------
    ValueError
        Automatic exposure on a white frame without any light.
    """
    camera = experiment.camera
    if camera.exposure_ms != "auto":
        return camera.exposure_ms
    bright = float(np.percentile(white, 99.5))
    if bright <= 0.0:
        raise InputError("camera.exposure_ms = 'auto': the white frame is black; aim the projector")
    rate = bright * electrons_per_ms(camera, experiment.projector.wavelength_nm)
    return camera.auto_level * full_well_e(camera) / rate


def _fixed_pattern(experiment: Experiment, shape: tuple[int, ...]) -> _Pixels:
    camera = experiment.camera
    rng = np.random.default_rng(seed_sequence(experiment, "fixed_pattern"))
    response = 1.0 + camera.prnu_percent / 100.0 * rng.standard_normal(shape, np.float32)
    offset_e = dark_offset_e(camera) * rng.standard_normal(shape, np.float32)
    return _Pixels(response.astype(np.float32), offset_e.astype(np.float32))


def _expected_dn(camera: Camera, mean_e: FloatImage) -> FloatImage:
    well_e = np.minimum(mean_e, np.float32(full_well_e(camera)))
    return (well_e * gain_dn_per_e(camera) + camera.black_level_dn).astype(np.float32)


def _recorded_dn(
    camera: Camera, mean_e: FloatImage, dark_e: float, pixels: _Pixels, rng: np.random.Generator
) -> NDArray[np.uint16]:
    collected_e = photon_counts(mean_e * pixels.response + np.float32(dark_e), rng)
    np.minimum(collected_e, np.float32(full_well_e(camera)), out=collected_e)
    dn = rng.standard_normal(mean_e.shape, np.float32)
    dn *= np.float32(read_noise_e(camera))
    dn += collected_e
    dn += pixels.offset_e
    dn *= np.float32(gain_dn_per_e(camera))
    dn += np.float32(camera.black_level_dn)
    np.clip(np.rint(dn, out=dn), 0, largest_code_dn(camera), out=dn)
    return dn.astype(np.uint16)
