"""Numbers of the sensor after binning, in EMVA 1288 terms, and its link to radiance.

Binning sums b x b pixels: full well, dark current and fixed pattern add up, noise variances add,
and the gain shrinks so that the full scale in DN stays. The b x b pixels are taken to fill alike:
their sum clips as one. Where some of them clip before others, the sum is near the top and errs by
a few sigmas of its shot noise, which no decoded coordinate shows (measured at 1.5 full wells).
"""

import math

from reconstruction.rig.sensor import SensorNoise
from twin.config.models import Camera

_PLANCK_J_S = 6.62607015e-34
_LIGHT_SPEED_M_PER_S = 2.99792458e8


def full_well_e(camera: Camera) -> float:
    """Saturation capacity of a binned pixel, e-."""
    return camera.full_well_e * camera.binning**2


def read_noise_e(camera: Camera) -> float:
    """Temporal dark noise of a binned pixel, e-."""
    return camera.read_noise_e * camera.binning


def dark_offset_e(camera: Camera) -> float:
    """Spread of the dark offsets of binned pixels (DSNU), e-."""
    return camera.dsnu_e * camera.binning


def largest_code_dn(camera: Camera) -> int:
    """Largest digital number of the converter."""
    return int(2**camera.bit_depth) - 1


def gain_dn_per_e(camera: Camera) -> float:
    """System gain K: the full well maps to the largest code."""
    return (largest_code_dn(camera) - camera.black_level_dn) / full_well_e(camera)


def electrons_per_ms(camera: Camera, wavelength_nm: float) -> float:
    """Photoelectrons per ms and per unit radiance (mW / (mm^2 sr)) of a binned pixel.

    Notes
    -----
    Irradiance behind a lens at magnification m: E = pi L tau / (4 (N (1 + m))^2), pupil
    magnification 1; electrons = QE * E * area * t * wavelength / (h c). Natural vignetting
    (cos^4, 2 % in the corner of the paper's camera) is not modelled.
    """
    magnification = camera.focal_length_mm / (camera.pose.standoff_mm - camera.focal_length_mm)
    working_f_number = camera.f_number * (1.0 + magnification)
    irradiance = math.pi * camera.lens_transmission / (4.0 * working_f_number**2)
    area_mm2 = (camera.pixel_pitch_um * 1e-3 * camera.binning) ** 2
    photons_per_mj = 1e-3 * wavelength_nm * 1e-9 / (_PLANCK_J_S * _LIGHT_SPEED_M_PER_S)
    return camera.quantum_efficiency * irradiance * area_mm2 * 1e-3 * photons_per_mj


def noise_model(camera: Camera) -> SensorNoise:
    """Return what a decoder needs to know of the sensor."""
    return SensorNoise(
        gain_dn_per_e=gain_dn_per_e(camera),
        read_noise_e=read_noise_e(camera),
        black_level_dn=camera.black_level_dn,
        saturation_dn=float(largest_code_dn(camera)),
        dsnu_e=dark_offset_e(camera),
    )
