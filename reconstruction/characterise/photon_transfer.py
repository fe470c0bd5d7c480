"""Photon transfer: estimate system gain and read noise from the increase of noise with light.

By the linear model of EMVA 1288 release 4, a pixel with the mean mu, DN, has the variance, DN^2,

    sigma^2 = K (mu - b) + (K sigma_d)^2 + 1 / 12,

with the system gain K (DN per electron), the temporal dark noise sigma_d (electrons) and the black
level b. A straight line is fitted to samples of (mean, squared deviation). The samples are from
two frames of the same scene, or from the residuals of a model of the frames (`projector_fit`).
"""

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, Stack
from reconstruction.errors import InputError
from reconstruction.rig.sensor import QUANTISATION_DN2, SensorNoise

BINS = 40
LEAST_SAMPLES = 2000
LEAST_VARIANCE_DN2 = 0.24
"""Least variance of a pixel at which rounding adds 1/12 DN^2 (EMVA 1288 release 4)."""

_LEAST_BINS, _LEAST_IN_BIN = 5, 100
# Samples with a mean nearer to an end of the scale, in standard deviations, have clipped noise.
_END_SIGMAS = 5.0
_MOST_PIXELS = 200_000
_ROUNDS = 3
SATURATION_CAPACITIES_E = (100.0, 1e9)
"""Plausible number of electrons at full scale, full scale / gain.

The limits are those of a pixel of 1 um at a gain of 30 and of the largest photodiodes.
"""
# Largest standard uncertainty of the gain, relative: the expanded uncertainty (k = 2) is 50 %.
_MOST_RELATIVE_SIGMA = 0.25
# Largest RMS of (variance / that of the line - 1). A scene that moved gives 0.4 and more, real
# sensors some 0.01.
_MOST_DEVIATION = 0.25


@dataclass(frozen=True)
class UncertainValue:
    """An estimated value and its standard uncertainty, in the same unit."""

    value: float
    uncertainty: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.value) and self.uncertainty >= 0.0):
            raise InputError(f"estimate {self.value} +- {self.uncertainty} is none")


@dataclass(frozen=True, eq=False)
class NoiseSamples:
    """Samples from which a photon transfer curve is fitted, each of one pixel in one frame.

    mean_dn : (sample,) expected value of the pixel
    square_dn2 : (sample,) squared deviation, whose expected value is the variance of the pixel
    """

    mean_dn: FloatArray
    square_dn2: FloatArray

    def joined(self, added: "NoiseSamples") -> "NoiseSamples":
        """Return the samples of this set and of `added` as one set."""
        return NoiseSamples(
            np.concatenate([self.mean_dn, added.mean_dn]),
            np.concatenate([self.square_dn2, added.square_dn2]),
        )


@dataclass(frozen=True, eq=False)
class PhotonTransfer:
    """The line that was fitted to variance over mean, and the binned samples.

    Attributes
    ----------
    gain_dn_per_e : system gain K, the slope of the line
    read_noise_e : temporal dark noise; None: not significantly above the rounding noise
    black_level_dn : mean value of a pixel without light
    mean_dn, variance_dn2, variance_uncertainty_dn2 : (bin,) mean, variance and its standard
        uncertainty in bins of the mean
    chi2_per_bin : chi-square of the line per degree of freedom; far above 1 the noise is not that
        of a linear sensor
    """

    gain_dn_per_e: UncertainValue
    read_noise_e: UncertainValue | None
    black_level_dn: float
    mean_dn: FloatArray
    variance_dn2: FloatArray
    variance_uncertainty_dn2: FloatArray
    chi2_per_bin: float

    def variance_at(self, mean_dn: FloatArray) -> FloatArray:
        """Return the variance of the line, DN^2, at the given mean values, DN."""
        read_dn = self.gain_dn_per_e.value * (self.read_noise_e.value if self.read_noise_e else 0.0)
        above = np.maximum(mean_dn - self.black_level_dn, 0.0)
        return np.asarray(
            self.gain_dn_per_e.value * above + read_dn**2 + QUANTISATION_DN2, dtype=np.float64
        )


def samples_of_pairs(first: Stack, second: Stack, sensor: SensorNoise) -> NoiseSamples:
    """Return samples from two image stacks of the same scene, frame by frame.

    Parameters
    ----------
    first, second : (frame, row, col) DN. The light may differ between them: each frame of `second`
        is scaled to the mean of that of `first`
    sensor : black level of the camera

    Raises
    ------
    InputError : the stacks have different shapes
    """
    if first.shape != second.shape:
        raise InputError(
            f"repeated captures have shapes {first.shape} and {second.shape}; give the same "
            "sequence recorded twice"
        )
    step = max(1, int(np.ceil(np.prod(first.shape[1:]) / _MOST_PIXELS)))
    samples = [
        _pair(
            frame.ravel()[::step].astype(np.float64) - sensor.black_level_dn,
            repeated.ravel()[::step].astype(np.float64) - sensor.black_level_dn,
            sensor,
        )
        for frame, repeated in zip(first, second, strict=True)
    ]
    return NoiseSamples(
        np.concatenate([pair.mean_dn for pair in samples]),
        np.concatenate([pair.square_dn2 for pair in samples]),
    )


def _pair(first: FloatArray, second: FloatArray, sensor: SensorNoise) -> NoiseSamples:
    total = float(second.sum())
    ratio = float(first.sum()) / total if total > 0.0 else 1.0
    # With very little light, or an implausible ratio, the frame is not scaled.
    ratio = ratio if 0.5 < ratio < 2.0 and np.mean(second) > 10.0 else 1.0
    mean = 0.5 * (first + ratio * second)
    square = (first - ratio * second) ** 2 / (1.0 + ratio**2)
    return NoiseSamples(mean + sensor.black_level_dn, square)


def photon_transfer(samples: NoiseSamples, sensor: SensorNoise) -> PhotonTransfer:
    """Fit the photon transfer line, variance over mean, to samples.

    Parameters
    ----------
    sensor : black level and saturation of the camera. Its gain and noise are only used to exclude
        samples near the ends of the scale

    Raises
    ------
    InputError : too few samples, equally bright frames, noise below rounding, or a line that is
        impossible for a sensor
    """
    inside = _inside(samples, sensor)
    if int(inside.sum()) < LEAST_SAMPLES:
        raise InputError(
            f"photon transfer has {int(inside.sum())} samples between black and saturation; needs "
            f"{LEAST_SAMPLES}: expose between them"
        )
    span_dn = float(np.ptp(samples.mean_dn[inside]))
    if not span_dn > 0.05 * (sensor.saturation_dn - sensor.black_level_dn):
        raise InputError("photon transfer: all frames are equally bright; record dark and bright")
    mean, variance, sigma = _bins(samples.mean_dn[inside], samples.square_dn2[inside])
    is_resolved = variance >= LEAST_VARIANCE_DN2
    if int(is_resolved.sum()) < _LEAST_BINS:
        raise InputError(
            "photon transfer: the noise is below the rounding of the levels; record more bits, "
            "or raise the camera's gain"
        )
    mean, variance, sigma = mean[is_resolved], variance[is_resolved], sigma[is_resolved]
    above = mean - sensor.black_level_dn
    slope, intercept, covariance, chi2 = _line(above, variance, sigma)
    if not slope > 0.0:
        raise InputError("photon transfer: noise does not increase with light; is this one sensor?")
    gain = UncertainValue(slope, float(np.sqrt(covariance[0, 0])))
    _require_plausible(gain, sensor)
    _require_straight(variance / (slope * above + intercept))
    read = _read_noise(slope, intercept, covariance)
    return PhotonTransfer(
        gain, read, sensor.black_level_dn, mean, variance, sigma, chi2 / max(len(mean) - 2, 1)
    )


def _require_plausible(gain: UncertainValue, sensor: SensorNoise) -> None:
    low, high = SATURATION_CAPACITIES_E
    capacity_e = (sensor.saturation_dn - sensor.black_level_dn) / gain.value
    if gain.uncertainty > _MOST_RELATIVE_SIGMA * gain.value:
        raise InputError(
            f"photon transfer: the gain is {gain.value:.3g} +- {gain.uncertainty:.2g} DN/e-, "
            f"allowed an uncertainty of up to {_MOST_RELATIVE_SIGMA:.0%}; record brighter frames, "
            "more of them, or raw ones without noise reduction"
        )
    if not low <= capacity_e <= high:
        raise InputError(
            f"photon transfer: a gain of {gain.value:.3g} DN/e- makes full scale {capacity_e:.3g} "
            f"electrons, allowed {low:g} to {high:g}; record the same scene at rest twice, in raw "
            "levels, and check black_level_dn and saturation_dn"
        )


def _require_straight(over_line: FloatArray) -> None:
    """Raise InputError if the variances differ from the line more than those of a real sensor.

    Parameters
    ----------
    over_line : (bin,) variances divided by those of the line
    """
    deviation = float(np.sqrt(np.mean((over_line - 1.0) ** 2)))
    if not deviation <= _MOST_DEVIATION:
        raise InputError(
            f"photon transfer: the variance differs by {deviation:.0%} (RMS) from a straight line, "
            f"allowed {_MOST_DEVIATION:.0%}; record the same scene at rest twice, in raw levels"
        )


def _inside(samples: NoiseSamples, sensor: SensorNoise) -> BoolArray:
    margin = _END_SIGMAS * np.sqrt(sensor.variance_dn2(samples.mean_dn))
    low = samples.mean_dn - margin > 0.0
    return np.asarray(low & (samples.mean_dn + margin < sensor.clipped_from_dn))


def _bins(mean_dn: FloatArray, square_dn2: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return mean, variance and standard uncertainty of the variance, each (bin,).

    All bins have the same width in the mean. Bins with equal numbers of samples would be biased: of
    two integer values, sum and difference are both even or both odd. Such bins would therefore
    separate samples with even differences from those with odd differences.
    """
    low, high = float(mean_dn.min()), float(mean_dn.max())
    place = (mean_dn - low) / max(high - low, 1e-9) * BINS
    number = np.minimum(place.astype(int), BINS - 1)
    count = np.bincount(number, minlength=BINS)
    full = count >= _LEAST_IN_BIN
    per = 1.0 / np.maximum(count, 1)
    mean = np.bincount(number, mean_dn, BINS) * per
    variance = np.bincount(number, square_dn2, BINS) * per
    fourth = np.bincount(number, square_dn2**2, BINS) * per
    sigma = np.sqrt(np.maximum(fourth - variance**2, 1e-24) * per)
    return mean[full], variance[full], sigma[full]


def _line(
    above: FloatArray, variance: FloatArray, sigma: FloatArray
) -> tuple[float, float, FloatArray, float]:
    """Fit variance over mean above black; return slope, intercept, their covariance, chi-square.

    The weights are computed from the fitted line, not from the measured variances. Otherwise a bin
    that has a small variance by chance would get too large a weight.
    """
    design = np.stack([above, np.ones_like(above)], axis=1)
    fitted = variance
    for _ in range(_ROUNDS):
        weight = (np.maximum(variance, 1e-12) / sigma / np.maximum(fitted, 1e-12)) ** 2
        normal = design.T @ (weight[:, None] * design)
        line = np.linalg.solve(normal, design.T @ (weight * variance))
        fitted = np.maximum(design @ line, 0.01 * variance)
    chi2 = float(np.sum(weight * (variance - design @ line) ** 2))
    freedom = max(len(above) - 2, 1)
    covariance: FloatArray = np.asarray(
        np.linalg.inv(normal) * max(1.0, chi2 / freedom), dtype=np.float64
    )
    return float(line[0]), float(line[1]), covariance, chi2


def _read_noise(slope: float, intercept: float, covariance: FloatArray) -> UncertainValue | None:
    variance_dn2 = intercept - QUANTISATION_DN2
    if variance_dn2 <= np.sqrt(covariance[1, 1]):
        return None
    read_e = np.sqrt(variance_dn2) / slope
    towards = np.array([-read_e / slope, read_e / (2.0 * variance_dn2)])
    return UncertainValue(float(read_e), float(np.sqrt(towards @ covariance @ towards)))
