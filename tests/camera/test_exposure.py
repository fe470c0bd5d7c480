"""The camera against EMVA 1288: photon transfer, dark noise, saturation, quantisation."""

import numpy as np
import pytest

from reconstruction.errors import InputError
from twin.camera import (
    choose_exposure_ms,
    electrons_per_ms,
    expose,
    full_well_e,
    gain_dn_per_e,
    noise_model,
)
from twin.config import load_experiment

SHAPE = (200, 200)
BASE = {"camera.exposure_ms": 10.0, "camera.prnu_percent": 0.0, "camera.dsnu_e": 0.0}


def experiment_with(**changes):
    dotted = {f"camera.{key}": value for key, value in changes.items()}
    return load_experiment("examples/slab_balls", BASE | dotted)


def uniform(experiment, electrons):
    """Frames with the given mean number of electrons per pixel."""
    rate = electrons_per_ms(experiment.camera, experiment.projector.wavelength_nm)
    return [np.full(SHAPE, e / (rate * 10.0), np.float32) for e in electrons]


def test_photon_transfer_slope_is_the_gain():
    """Var[DN] = K^2 (read^2 + dark) + K (mean - black) + 1/12: slope K, intercept dark noise."""
    experiment = experiment_with()
    stack = expose(experiment, uniform(experiment, np.linspace(0, 15000, 16)), 0).stack
    mean = stack.mean(axis=(1, 2)) - experiment.camera.black_level_dn
    variance = stack.var(axis=(1, 2), ddof=1)
    slope, intercept = np.polyfit(mean, variance, 1, w=1 / variance)
    gain = gain_dn_per_e(experiment.camera)
    assert slope == pytest.approx(gain, rel=0.01)
    dark_e2 = 6.2**2 + 10.0 * 10e-3
    assert intercept == pytest.approx(gain**2 * dark_e2 + 1 / 12, rel=0.05)


def test_the_decoder_has_the_same_variance():
    experiment = experiment_with()
    stack = expose(experiment, uniform(experiment, [5000.0]), 0).stack
    predicted = noise_model(experiment.camera).variance_dn2(float(stack.mean()))
    assert stack.var(ddof=1) == pytest.approx(float(predicted), rel=0.03)


def test_saturation_and_zero_are_exact():
    experiment = experiment_with(read_noise_e={"value": 0.0, "source": "test"})
    well = full_well_e(experiment.camera)
    stack = expose(experiment, uniform(experiment, [0.0, 3 * well]), 0).stack
    assert np.all(stack[1] == 4095)
    assert abs(float(stack[0].mean()) - experiment.camera.black_level_dn) < 0.05


def test_well_clips_before_read_noise():
    """Saturated pixels still carry read noise below the largest code."""
    experiment = experiment_with()
    stack = expose(experiment, uniform(experiment, [3 * full_well_e(experiment.camera)]), 0).stack
    share_below = (stack < 4095).mean()
    assert 0.2 < share_below < 0.7


@pytest.mark.parametrize("binning", [1, 2, 4])
def test_binning_keeps_the_dn_and_improves_the_signal_to_noise(binning):
    experiment = experiment_with(binning=binning)
    frames = uniform(experiment, [10000.0 * binning**2])
    stack = expose(experiment, frames, 0).stack
    signal = stack.mean() - experiment.camera.black_level_dn
    single = gain_dn_per_e(experiment_with().camera) * 10000.0
    assert signal == pytest.approx(single, rel=0.002)
    expected = np.sqrt((10000.0 + 6.2**2) * binning**2) * gain_dn_per_e(experiment.camera)
    assert stack.std(ddof=1) == pytest.approx(np.hypot(expected, np.sqrt(1 / 12)), rel=0.03)


@pytest.mark.parametrize(
    ("pattern", "electrons", "spread_e"),
    [({"prnu_percent": 1.0}, 10000.0, 100.0), ({"dsnu_e": 15.0}, 100.0, 15.0)],
)
def test_prnu_and_dsnu_are_fixed_over_frames_and_trials(pattern, electrons, spread_e):
    """One at a time: the common pattern of two trials, to 1 %; 40,000 pixels resolve 0.5 %."""
    experiment = experiment_with(**pattern)
    frames = uniform(experiment, [electrons] * 12)
    first, second = (
        expose(experiment, frames, 0).stack,
        expose(experiment, frames, 0, trial=1).stack,
    )
    assert np.any(first != second)
    a, b = (stack.mean(axis=0) - stack.mean() for stack in (first, second))
    pattern_dn = np.sqrt(np.mean(a * b))
    expected = gain_dn_per_e(experiment.camera) * spread_e
    assert pattern_dn == pytest.approx(expected, rel=0.01)


def test_automatic_exposure_reaches_its_level():
    experiment = load_experiment("examples/slab_balls")
    rng = np.random.default_rng(5)
    white = rng.uniform(0.0, 1e-3, SHAPE).astype(np.float32)
    exposed = expose(experiment, [white], 0)
    level = (np.percentile(exposed.stack, 99.5) - 16) / (4095 - 16)
    assert level == pytest.approx(experiment.camera.auto_level, rel=0.02)


def test_automatic_exposure_in_the_dark_is_an_error():
    with pytest.raises(ValueError, match="brightest frame is black"):
        expose(load_experiment("examples/slab_balls"), [np.zeros(SHAPE, np.float32)], 0)


@pytest.mark.parametrize(
    ("radiance", "remedy"), [(1e-30, "use more light"), (1e30, "use less light")]
)
def test_automatic_exposure_no_camera_has_is_refused(radiance, remedy):
    """Without the check, a rig without light was exposed for 1e16 ms."""
    white = np.full(SHAPE, radiance, np.float32)
    with pytest.raises(InputError, match=r"needs .* ms, allowed 0\.0001 to 1e\+06") as caught:
        choose_exposure_ms(load_experiment("examples/slab_balls"), white)
    assert remedy in str(caught.value)
    assert "\n" not in str(caught.value)


def test_same_seed_same_bytes_and_noise_free_is_the_expectation():
    experiment = experiment_with()
    frames = uniform(experiment, [3000.0])
    assert (
        expose(experiment, frames, 0).stack.tobytes()
        == expose(experiment, frames, 0).stack.tobytes()
    )
    clean = expose(experiment_with(noise=False), frames, 0).stack
    dark_e = 10.0 * 10e-3
    expected = gain_dn_per_e(experiment.camera) * (3000.0 + dark_e) + 16
    np.testing.assert_allclose(clean, expected, rtol=1e-5)


def test_frames_are_the_same_in_any_order_and_on_any_number_of_threads(monkeypatch):
    """Frames recorded singly, last first, equal those recorded together on one or two threads."""
    experiment = experiment_with(prnu_percent=1.0)
    frames = uniform(experiment, [0.0, 5.0, 150.0, 9000.0])
    stacks = []
    for count in ("1", "2"):
        monkeypatch.setenv("NUMBA_NUM_THREADS", count)
        stacks.append(expose(experiment, frames, 0).stack)
    assert np.array_equal(*stacks)
    backwards = experiment_with(prnu_percent=1.0)
    separate = [expose(backwards, frames[: end + 1], 0).stack[end] for end in (3, 1, 2, 0)]
    assert all(
        np.array_equal(stacks[0][end], single)
        for end, single in zip((3, 1, 2, 0), separate, strict=True)
    )


def test_shot_and_read_noise_of_frames_and_trials_are_independent():
    """Correlation of the readings of frames and of trials: none beyond four standard errors."""
    experiment = experiment_with()
    frames = uniform(experiment, [2000.0] * 3)
    stack = expose(experiment, frames, 0).stack.reshape(3, -1)
    again = expose(experiment, frames, 0, trial=1).stack.reshape(3, -1)
    both = np.corrcoef(np.concatenate([stack, again]))
    assert np.abs(both - np.eye(6)).max() < 4 / np.sqrt(stack.shape[1])
