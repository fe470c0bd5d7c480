"""Estimate black level, projector response and camera noise from captures of a rig."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from reconstruction.arrays import FloatArray, FloatImage
from reconstruction.capture.folder import Capture
from reconstruction.characterise import (
    Dark,
    FitLimits,
    NoiseSamples,
    PhotonTransfer,
    ProjectorFit,
    dark_of,
    fit_projector,
    photon_transfer,
    samples_of_pairs,
)
from reconstruction.decoding.decode import Decoded, DecodeOptions, decode
from reconstruction.errors import InputError
from reconstruction.rig.calibration import Calibration
from reconstruction.rig.sensor import SensorNoise
from reconstruction.triangulation import triangulate
from twin.adoption.defocus import CaptureBlur
from twin.adoption.fields import read_images

# Median of the square of a standard normal number.
_MEDIAN_OF_SQUARE = 0.455
# Largest ratio of squared differences to the variance of noise for two captures of one scene: for
# fitted noise, and for that of capture.toml.
_MOST_OVER_FITTED, _MOST_OVER_STATED = 1.5, 20.0
# Largest excess of the mean of dark frames over that of the darkest frame of a capture, for
# rounding and drift of the black level.
_BRIGHTER_DN, _BRIGHTER_SIGMAS = 1.0, 5.0
UNFILTERED = DecodeOptions(filter_taps=0)


def dark_frames(folder: Path, capture: Capture) -> Dark:
    """Return black level and noise of the dark frames in a folder.

    Raises
    ------
    InputError : the dark frames are brighter than the darkest frame of the capture, which shows
        the black level plus ambient light
    """
    dark = dark_of(read_images(folder, capture))
    black = dark.black_level_dn
    darkest_dn = float(capture.stack.mean(axis=(1, 2), dtype=np.float64).min())
    if black.value > darkest_dn + _BRIGHTER_DN + _BRIGHTER_SIGMAS * black.uncertainty:
        raise InputError(
            f"{folder}: dark frames have a mean of {black.value:.4g} DN, allowed up to "
            f"{darkest_dn:.4g} DN, that of the capture's darkest frame; cover the lens, and keep "
            "the camera's settings"
        )
    return dark


def with_black(sensor: SensorNoise, dark: Dark | None) -> SensorNoise:
    """Return the camera noise with the black level of `dark`; unchanged if that is None."""
    if dark is None:
        return sensor
    return replace(sensor, black_level_dn=max(dark.black_level_dn.value, 0.0))


@dataclass(frozen=True, eq=False)
class FittedCapture:
    """Fitted projector response of one capture, and the fitted blur.

    The blur is stored with mean and standard deviation of the points' inverse distances.
    """

    fit: ProjectorFit
    blur: CaptureBlur


def fit_captures(
    folders: Sequence[Path],
    captures: Sequence[Capture],
    sensor: SensorNoise,
    notes: list[str],
) -> list[FittedCapture]:
    """Return the fits of all captures that can be fitted.

    For each capture that cannot be fitted, a line with the reason is added to `notes`. Captures
    merged from several exposures cannot be fitted.
    """
    results = []
    for folder, capture in zip(folders, captures, strict=True):
        try:
            decoded = decode(capture.stack, capture.patterns, sensor, UNFILTERED, capture.scale)
            if capture.scale is not None:
                raise InputError("merged exposures have no single noise")
            inverse = _inverse_distances(decoded, capture.calibration)
            fit = _fit_twice(capture, sensor, decoded)
            results.append(
                FittedCapture(
                    fit, CaptureBlur(float(inverse.mean()), float(inverse.std()), fit.blur_px)
                )
            )
        except InputError as error:
            notes.append(f"{folder.name}: the projector's response cannot be estimated: {error}")
    return results


def _fit_twice(capture: Capture, sensor: SensorNoise, decoded: Decoded) -> ProjectorFit:
    """Return the projector response of a capture by two fits.

    The capture is decoded with the response of the first fit, and then fitted again.
    """
    stack, patterns = capture.stack, capture.patterns
    first = fit_projector(stack, patterns, sensor, decoded)
    if not patterns.kind.takes_response:
        return first
    known = first.response()
    again = decode(stack, patterns, sensor, UNFILTERED, response=known)
    return fit_projector(
        stack, patterns, sensor, again, FitLimits(gamma=known.gamma, blur_px=known.blur_px)
    )


def _inverse_distances(decoded: Decoded, calibration: Calibration) -> FloatArray:
    """Return the inverse distance (n,), 1/mm, of all points along the projector's axis."""
    points = triangulate(decoded, calibration)
    if not points.valid.any():
        raise InputError("no pixel has a point; does the calibration belong to the capture?")
    T_world_from_proj = calibration.T_world_from_proj
    points_mm = points.points_world_mm[points.valid].astype(np.float64)
    return np.asarray(1.0 / ((points_mm - T_world_from_proj[:3, 3]) @ T_world_from_proj[:3, 2]))


def noise_of(
    captures: Sequence[Capture],
    fits: Sequence[ProjectorFit],
    sensor: SensorNoise,
    notes: list[str],
) -> tuple[PhotonTransfer | None, str]:
    """Return the camera noise, and its source as text.

    It is estimated from repeated captures, or else from the residuals of a fit. If neither is
    possible, the noise is None and a line is added to `notes`.
    """
    own = next((fit.noise for fit in fits if fit.noise is not None), None)
    pairs = _pairs(captures, sensor, own)
    if pairs is not None:
        try:
            return photon_transfer(pairs, sensor), "photon transfer of repeated captures"
        except InputError as error:
            notes.append(f"repeated captures: {error}")
    if own is not None:
        return own, "photon transfer of what the fit of one capture leaves"
    notes.append("the captures do not determine the camera's noise: its gain is the model's")
    return None, ""


def _pairs(
    captures: Sequence[Capture], sensor: SensorNoise, own: PhotonTransfer | None
) -> NoiseSamples | None:
    """Return noise samples of all pairs of successive captures of the same scene.

    Two captures are taken as captures of the same scene if the differences between their values
    are explained by noise. The differences are compared with the fitted noise `own`, or, if `own`
    is None, with the noise `sensor` of capture.toml. The result is None if there is no such pair.
    """
    all_samples: NoiseSamples | None = None
    for earlier, later in pairwise(captures):
        if (
            earlier.patterns != later.patterns
            or earlier.scale is not None
            or later.scale is not None
        ):
            continue
        samples = samples_of_pairs(earlier.stack, later.stack, sensor)
        expected = own.variance_at(samples.mean_dn) if own else sensor.variance_dn2(samples.mean_dn)
        ratio = float(np.median(samples.square_dn2 / expected)) / _MEDIAN_OF_SQUARE
        if ratio < (_MOST_OVER_FITTED if own else _MOST_OVER_STATED):
            all_samples = samples if all_samples is None else all_samples.joined(samples)
    return all_samples


def two_period_chi2(captures: Sequence[Capture], known: Capture) -> float | None:
    """Return chi-square per pixel of two captures of one scene with different fringe periods.

    The decoded columns of unfiltered pixels are compared, with the noise and the response of
    `known`. The result is None without such captures, or if they do not show the same scene.
    """
    first = captures[0]
    for second in captures[1:]:
        if second.patterns.period_px == first.patterns.period_px:
            continue
        decoded = [
            decode(
                capture.stack,
                capture.patterns,
                known.sensor,
                UNFILTERED,
                capture.scale,
                response=known.response,
            )
            for capture in (first, second)
        ]
        return chi2_of(decoded[0], decoded[1])
    return None


def chi2_of(first: Decoded, second: Decoded) -> float | None:
    """Return the mean square of differences of decoded columns, divided by their uncertainties.

    Pixels that differ by more than 10 sigma show another scene or have a wrong fringe order, and
    are left out. The result is None if these are 1 % of the pixels or more, or if fewer than 100
    pixels are valid in both captures.
    """
    both = first.valid & second.valid
    if int(both.sum()) < 100:
        return None
    step: FloatArray = first.column.coordinate_px[both].astype(np.float64)
    step = step - second.column.coordinate_px[both]
    sigmas: FloatImage = np.hypot(first.column.sigma_px[both], second.column.sigma_px[both])
    square = (step / sigmas) ** 2
    near = square < 100.0
    return float(square[near].mean()) if near.mean() > 0.99 else None
