"""Readings of full pixels are detected, although read noise moves them below the largest code."""

import numpy as np
import pytest
from scipy import stats

from reconstruction.decoding.decode import DecodeOptions, decode
from reconstruction.patterns import PatternSet
from twin.camera import electrons_per_ms, expose, full_well_e, noise_model, read_noise_e
from twin.config import load_experiment

PATTERNS = PatternSet(width_px=128, height_px=128)
WHITE = PATTERNS.index("white").start
SHAPE = (200, 200)
EXPOSURE_MS = 10.0
BINNINGS = [1, 2, 4]
NO_READ_NOISE = {"read_noise_e": {"value": 0.0, "source": "test"}, "dsnu_e": 0.0}


def experiment_with(**changes):
    dotted = {f"camera.{key}": value for key, value in changes.items()}
    return load_experiment("examples/slab_balls", {"camera.exposure_ms": EXPOSURE_MS} | dotted)


def coordinates_px():
    """Projector column and row of each camera pixel."""
    row, col = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    return 6.0 + 116.0 * col / SHAPE[1] + 0.013 * row, 6.0 + 116.0 * row / SHAPE[0] + 0.017 * col


def fringes(experiment, peak):
    """Radiance of the sequence, white at `peak` of the full well."""
    column_px, row_px = coordinates_px()
    camera, wavelength_nm = experiment.camera, experiment.projector.wavelength_nm
    white = peak * full_well_e(camera) / (electrons_per_ms(camera, wavelength_nm) * EXPOSURE_MS)
    levels = (
        _level(frame, row_px if frame.axis == "row" else column_px) for frame in PATTERNS.frames
    )
    return [(white * level).astype(np.float32) for level in levels]


def _level(frame, at_px):
    if frame.kind != "phase":
        return PATTERNS.profile(frame)[np.rint(at_px).astype(int)] / 255.0
    period_px, shift = PATTERNS.phase_of(frame)
    return 0.5 + 0.5 * np.cos(2.0 * np.pi * (at_px / period_px + shift))


def is_flagged(stack, experiment):
    return stack >= noise_model(experiment.camera).clipped_from_dn


def errors_in_sigmas(stack, experiment):
    """Decode unfiltered; return (axis, pixel) error over sigma of the VALID pixels."""
    decoded = decode(stack, PATTERNS, noise_model(experiment.camera), DecodeOptions(filter_taps=0))
    assert decoded.valid.mean() > 0.999
    axes = zip((decoded.column, decoded.row), coordinates_px(), strict=True)
    return np.array(
        [((axis.coordinate_px - px) / axis.sigma_px)[decoded.valid] for axis, px in axes]
    )


def most_beyond_five_sigma(errors):
    """Largest number beyond 5 sigma that a normal distribution exceeds once in a thousand."""
    return stats.binom.ppf(0.999, errors.size, 2.0 * stats.norm.sf(5.0))


@pytest.mark.parametrize("binning", BINNINGS)
def test_clipped_readings_do_not_pass_for_good_ones(binning):
    """Setup: fringes that peak at 1.5 of the full well; clipped readings are known from the
    same photons without read noise. Expected: at most 1e-5 of them unflagged, 0.5 % of the
    rest flagged, no error beyond those of a normal distribution.
    """
    experiment = experiment_with(binning=binning)
    radiance = fringes(experiment, 1.5)
    stack = expose(experiment, radiance, WHITE).stack
    clean = expose(experiment_with(binning=binning, **NO_READ_NOISE), radiance, WHITE).stack
    is_clipped, flagged = clean == clean.max(), is_flagged(stack, experiment)
    assert is_clipped.mean() > 0.3
    assert np.mean(~flagged[is_clipped]) <= 1e-5
    assert np.mean(flagged[~is_clipped]) <= 5e-3
    errors = errors_in_sigmas(stack, experiment)
    assert np.count_nonzero(np.abs(errors) > 5.0) <= most_beyond_five_sigma(errors)


def test_dark_offsets_do_not_hide_clipped_readings():
    """Setup: offsets that spread more than the read noise. Expected: still flagged."""
    experiment = experiment_with(dsnu_e=15.0, prnu_percent=0.0)
    stack = expose(experiment, fringes(experiment, 1.5), WHITE).stack
    assert np.mean(~is_flagged(stack[WHITE], experiment)) <= 1e-3
    errors = errors_in_sigmas(stack, experiment)
    assert np.count_nonzero(np.abs(errors) > 5.0) <= most_beyond_five_sigma(errors)


@pytest.mark.parametrize("binning", BINNINGS)
def test_readings_below_the_full_well_are_valid(binning):
    """Setup: white at 0.95 of the full well. Expected: no flags, sigma is the error."""
    experiment = experiment_with(binning=binning, prnu_percent=0.0)
    stack = expose(experiment, fringes(experiment, 0.95), WHITE).stack
    assert not is_flagged(stack, experiment).any()
    assert np.std(errors_in_sigmas(stack, experiment)) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("binning", [2, 4])
def test_cells_of_which_some_wells_are_full_do_no_harm(binning):
    """Setup: every well of a binned cell clips separately, while the twin clips their sum.

    Expected: no error beyond those of a normal distribution. Why: a cell with some full wells is
    within a few sigmas of its shot noise below full scale, and so is its error.
    """
    experiment = experiment_with(binning=binning)
    camera, sensor = experiment.camera, noise_model(experiment.camera)
    rate = electrons_per_ms(camera, experiment.projector.wavelength_nm) * EXPOSURE_MS
    rng, stack = np.random.default_rng(3), np.zeros((len(PATTERNS.frames), *SHAPE), np.uint16)
    for frame, radiance in zip(stack, fringes(experiment, 1.5), strict=True):
        mean_e = np.broadcast_to(radiance * (rate / binning**2), (binning**2, *SHAPE))
        wells_e = np.minimum(rng.normal(mean_e, np.sqrt(mean_e)), camera.full_well_e)
        reading_e = wells_e.sum(axis=0) + rng.normal(0.0, read_noise_e(camera), SHAPE)
        dn = sensor.gain_dn_per_e * reading_e + sensor.black_level_dn
        frame[:] = np.clip(np.rint(dn), 0, sensor.saturation_dn)
    errors = errors_in_sigmas(stack, experiment)
    assert np.count_nonzero(np.abs(errors) > 5.0) <= most_beyond_five_sigma(errors)
