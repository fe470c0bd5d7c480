"""Camera model by EMVA 1288 (release 4): from radiance to digital numbers.

Drift and flicker of the lamp and light that the lens scatters (`frame_light`) change the radiance.
The order of the further steps is that of a sensor. Photons and dark current are one Poisson
process, then the pixel saturates at its full well. After this, read noise, gain, quantisation and
the limits of the converter are applied.

Binning sums b x b pixels: full well and dark current are b^2 times those of a pixel, read noise and
the spread of dark offsets b times. The gain is divided by b^2, so that the full scale in DN is
constant. The b x b pixels are assumed to have equal signals, so that all of them saturate together.
If only some of them saturate, the sum is near full scale, with an error of a few standard
deviations of its shot noise. Decoded coordinates are not affected (measured at 1.5 full wells).
"""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, reduce

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatImage
from reconstruction.errors import InputError
from reconstruction.machine import threads
from reconstruction.rig.sensor import SensorNoise
from twin.camera.frame_light import lamp_gains, scattered
from twin.camera.noise import Key, Sensor, record_frame
from twin.camera.noise_function import NoiseFunction, noisy_electrons
from twin.config import Experiment, seed_sequence
from twin.config.bounds import EXPOSURE_PERCENTILE, EXPOSURE_RANGE_MS
from twin.config.digest import keyed_sequence
from twin.config.imaging import magnification_at
from twin.config.models import Camera

_PLANCK_J_S = 6.62607015e-34
_LIGHT_SPEED_M_PER_S = 2.99792458e8


@dataclass(frozen=True)
class Exposed:
    """Frames of a camera, as `expose` records them.

    Attributes
    ----------
    stack : (frame, row, col) uint16, DN; float32 if camera.noise is false
    exposure_ms : configured exposure time, or that of the automatic exposure
    sensor : noise parameters of the camera, for a decoder
    """

    stack: NDArray[np.uint16] | FloatImage
    exposure_ms: float
    sensor: SensorNoise


@dataclass(frozen=True)
class _Pixels:
    """Fixed pattern of one camera: relative response and dark offset (e-), both (row, col)."""

    response: FloatImage
    offset_e: FloatImage


def expose(
    experiment: Experiment,
    radiance: Sequence[FloatImage],
    white_frame: int | None,
    trial: int = 0,
    progress: Callable[[float], None] = lambda _: None,
    *,
    noise: NoiseFunction | None = None,
) -> Exposed:
    """Record a sequence of radiance images with the camera.

    Parameters
    ----------
    radiance : sequence of (row, col) float32, mW / (mm^2 sr)
    white_frame : index of the white frame, for the automatic exposure; None: there is no white
        frame, and each pixel of the automatic exposure is the brightest over all frames
    trial : number of the repetition: same camera and fixed pattern, new temporal noise
    progress : called with the finished fraction, 0 to 1
    noise : function of the user instead of the camera's noise model, see `NoiseFunction`

    Raises
    ------
    InputError : the automatic exposure fails, see `choose_exposure_ms`; `noise` is given although
        camera.noise is false, or its result is no image of electrons
    """
    camera = experiment.camera
    _check_noise(camera, noise)
    exposure_ms = choose_exposure_ms(experiment, _brightest(camera, radiance, white_frame))
    gains = lamp_gains(experiment, len(radiance), trial)
    per_radiance = exposure_ms * electrons_per_ms(camera, experiment.projector.wavelength_nm)
    dark_e = camera.dark_current_e_per_s * camera.binning**2 * exposure_ms * 1e-3
    shape = radiance[0].shape
    stack = np.zeros((len(radiance), *shape), np.uint16 if camera.noise else np.float32)
    pixels = _fixed_pattern(experiment.seed, camera.prnu_percent, dark_offset_e(camera), shape)

    sensor, key = _sensor(camera, per_radiance, dark_e), _key(experiment, trial)
    draw = _drawn_by(camera, noise)

    def record(frame: int) -> None:
        light = scattered(camera, radiance[frame])
        light = light if gains is None else light * gains[frame]
        if draw is not None:
            light_e = light * np.float32(per_radiance) * pixels.response
            rng = np.random.default_rng(seed_sequence(experiment, "noise", trial, frame))
            mean_e = np.maximum(light_e + np.float32(dark_e), np.float32(0))
            electrons = noisy_electrons(draw, mean_e, rng)
            stack[frame] = _digitised(camera, electrons, pixels.offset_e)
        elif camera.noise:
            place = key, frame
            record_frame(light, pixels.response, pixels.offset_e, sensor, place, stack[frame])
        else:
            mean_e = light * np.float32(per_radiance) + np.float32(dark_e)
            stack[frame] = _expected_dn(camera, mean_e)

    # With a function of the user, which may have a state, frames are recorded one after the other.
    with ThreadPoolExecutor(threads() if noise is None else 1) as pool:
        for done, _ in enumerate(pool.map(record, range(len(radiance))), start=1):
            progress(done / len(radiance))
    return Exposed(stack, exposure_ms, noise_model(camera))


def _check_noise(camera: Camera, noise: NoiseFunction | None) -> None:
    if noise is not None and not camera.noise:
        raise InputError(
            "camera.noise: found false, which records expected values; a function for the noise "
            "needs true"
        )


def _drawn_by(camera: Camera, noise: NoiseFunction | None) -> NoiseFunction | None:
    """Return the function that draws noise; None: the compiled kernel does, or there is none."""
    model = camera.noise_model
    if noise is not None or not camera.noise or model.is_emva1288:
        return noise
    sensor = noise_model(camera)

    def electrons(mean_e: FloatImage, rng: np.random.Generator) -> FloatImage:
        return model.electrons(mean_e, rng, sensor)

    electrons.__name__ = model.kind
    return electrons


def _brightest(
    camera: Camera, radiance: Sequence[FloatImage], white_frame: int | None
) -> FloatImage:
    """Return the radiance by which the automatic exposure is set, see `expose`."""
    if white_frame is not None:
        return radiance[white_frame]
    return reduce(np.maximum, radiance) if camera.exposure_ms == "auto" else radiance[0]


def choose_exposure_ms(experiment: Experiment, brightest: FloatImage) -> float:
    """Return the configured exposure time, ms, or that of the automatic exposure.

    The automatic exposure puts the 99.5th percentile of the brightest frame, with the light that
    the lens scatters, at `auto_level` times the full well.

    Parameters
    ----------
    brightest : (row, col) float32, mW / (mm^2 sr); radiance of the white frame, or the largest of
        each pixel

    Raises
    ------
    InputError : this frame has no light, or the automatic exposure is outside the range of
        exposure times
    """
    camera = experiment.camera
    if camera.exposure_ms != "auto":
        return camera.exposure_ms
    bright = float(np.percentile(scattered(camera, brightest), EXPOSURE_PERCENTILE))
    if bright <= 0.0:
        raise InputError(
            "camera.exposure_ms = 'auto': the brightest frame is black; aim the projector"
        )
    rate = bright * electrons_per_ms(camera, experiment.projector.wavelength_nm)
    exposure_ms = camera.auto_level * full_well_e(camera) / rate if rate > 0.0 else math.inf
    shortest_ms, longest_ms = EXPOSURE_RANGE_MS
    if not shortest_ms <= exposure_ms <= longest_ms:
        dark = exposure_ms > longest_ms
        remedy = (
            "more light (projector.flux_mw, camera.quantum_efficiency, a lower camera.f_number)"
        )
        raise InputError(
            f"camera.exposure_ms = 'auto': the brightest frame needs {exposure_ms:.3g} ms, allowed "
            f"{shortest_ms:g} to {longest_ms:g}, as for a number; use "
            + (remedy if dark else "less light (projector.flux_mw, a higher camera.f_number)")
        )
    return exposure_ms


@lru_cache(maxsize=2)
def _fixed_pattern(
    seed: int, prnu_percent: float, offset_e: float, shape: tuple[int, ...]
) -> _Pixels:
    """Return the random fixed pattern of a camera; cached, because this takes as long as a frame.

    `offset_e` is the standard deviation of the dark offsets, e-.
    """
    rng = np.random.default_rng(keyed_sequence(seed, "fixed_pattern"))
    response = 1.0 + prnu_percent / 100.0 * rng.standard_normal(shape, np.float32)
    offset = offset_e * rng.standard_normal(shape, np.float32)
    return _Pixels(response.astype(np.float32), offset.astype(np.float32))


def _expected_dn(camera: Camera, mean_e: FloatImage) -> FloatImage:
    well_e = np.minimum(mean_e, np.float32(full_well_e(camera)))
    return (well_e * gain_dn_per_e(camera) + camera.black_level_dn).astype(np.float32)


def _digitised(camera: Camera, electrons: FloatImage, offset_e: FloatImage) -> NDArray[np.uint16]:
    """Return digital numbers of electrons (row, col): full well, offset, gain, converter."""
    signal_e = np.minimum(electrons, np.float32(full_well_e(camera))) + offset_e
    dn = np.rint(signal_e * gain_dn_per_e(camera) + camera.black_level_dn)
    codes: NDArray[np.uint16] = np.clip(dn, 0, largest_code_dn(camera)).astype(np.uint16)
    return codes


def _sensor(camera: Camera, per_radiance: float, dark_e: float) -> Sensor:
    """Return the parameters of the camera for the compiled kernel."""
    return Sensor(
        per_radiance=np.float32(per_radiance),
        dark_e=np.float32(dark_e),
        full_well_e=np.float32(full_well_e(camera)),
        read_noise_e=np.float32(read_noise_e(camera)),
        gain_dn_per_e=np.float32(gain_dn_per_e(camera)),
        black_level_dn=np.float32(camera.black_level_dn),
        largest_dn=np.float32(largest_code_dn(camera)),
    )


def _key(experiment: Experiment, trial: int) -> Key:
    """Return the key, four words, of the random numbers of one repetition."""
    a, b, c, d = seed_sequence(experiment, "sensor", trial).generate_state(4, np.uint32)
    return a, b, c, d


def full_well_e(camera: Camera) -> float:
    """Return the saturation capacity of a binned pixel, e-."""
    return camera.full_well_e * camera.binning**2


def read_noise_e(camera: Camera) -> float:
    """Return the temporal dark noise of a binned pixel, e- (standard deviation)."""
    return camera.read_noise_e * camera.binning


def dark_offset_e(camera: Camera) -> float:
    """Return the standard deviation of the dark offsets of binned pixels (DSNU), e-."""
    return camera.dsnu_e * camera.binning


def largest_code_dn(camera: Camera) -> int:
    """Return the largest digital number of the converter, DN."""
    return int(2**camera.bit_depth) - 1


def gain_dn_per_e(camera: Camera) -> float:
    """Return the system gain K, DN/e-, with which the full well gives the largest DN."""
    return (largest_code_dn(camera) - camera.black_level_dn) / full_well_e(camera)


def electrons_per_ms(camera: Camera, wavelength_nm: float) -> float:
    """Return the photoelectrons of a binned pixel per ms and per radiance in mW / (mm^2 sr).

    Notes
    -----
    The irradiance behind a lens at magnification m is E = pi L tau / (4 (N (1 + m))^2), for a pupil
    magnification of 1. L is the radiance, tau the transmission and N the f-number. Then
    electrons = QE * E * area * t * wavelength / (h c). Natural vignetting (cos^4, 2 % in the corner
    of the paper's camera) is not included.
    """
    magnification = magnification_at(camera.focal_length_mm, camera.pose.standoff_mm)
    working_f_number = camera.f_number * (1.0 + magnification)
    irradiance = math.pi * camera.lens_transmission / (4.0 * working_f_number**2)
    area_mm2 = (camera.pixel_pitch_um * 1e-3 * camera.binning) ** 2
    photons_per_mj = 1e-3 * wavelength_nm * 1e-9 / (_PLANCK_J_S * _LIGHT_SPEED_M_PER_S)
    return camera.quantum_efficiency * irradiance * area_mm2 * 1e-3 * photons_per_mj


def noise_model(camera: Camera) -> SensorNoise:
    """Return the noise parameters of the sensor for a decoder."""
    return SensorNoise(
        gain_dn_per_e=gain_dn_per_e(camera),
        read_noise_e=read_noise_e(camera),
        black_level_dn=camera.black_level_dn,
        saturation_dn=float(largest_code_dn(camera)),
        dsnu_e=dark_offset_e(camera),
    )
