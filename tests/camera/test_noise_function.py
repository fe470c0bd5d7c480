"""Noise by a function of the user."""

import numpy as np
import pytest

from reconstruction.errors import InputError
from twin.camera import electrons_per_ms, expose
from twin.config import load_experiment

SHAPE = (200, 200)
LEVELS_E = (0.0, 50.0, 2000.0, 9000.0)


def experiment_with(**changes):
    plain = {"exposure_ms": 10.0, "prnu_percent": 0.0, "dsnu_e": 0.0} | changes
    return load_experiment("examples/slab_balls", {f"camera.{k}": v for k, v in plain.items()})


def frames(experiment):
    """Uniform frames of `LEVELS_E` electrons per pixel."""
    rate = 10.0 * electrons_per_ms(experiment.camera, experiment.projector.wavelength_nm)
    return [np.full(SHAPE, electrons / rate, np.float32) for electrons in LEVELS_E]


def test_poisson_and_normal_numbers_have_the_statistics_of_the_built_in_model():
    """Setup: uniform frames, and the EMVA terms by numpy's generators. 40,000 pixels each.

    Expected: means within 5 standard errors (spread / 200) of both, spreads within 2 %.
    """
    case = experiment_with()
    read_e = case.camera.read_noise_e * case.camera.binning
    own = expose(
        case,
        frames(case),
        3,
        noise=lambda mean_e, rng: rng.poisson(mean_e) + rng.normal(0.0, read_e, mean_e.shape),
    )
    built_in = expose(case, frames(case), 3)
    for mine, theirs in zip(own.stack.astype(float), built_in.stack.astype(float), strict=True):
        assert mine.mean() == pytest.approx(theirs.mean(), abs=5 * 1.5 * theirs.std() / 200)
        assert mine.std() == pytest.approx(theirs.std(), rel=0.02)


def test_the_mean_gives_the_stack_without_noise():
    case = experiment_with()
    same = expose(case, frames(case), 3, noise=lambda mean_e, rng: mean_e).stack
    clean = expose(experiment_with(noise=False), frames(case), 3).stack
    assert same.dtype == np.uint16
    np.testing.assert_array_equal(same, np.rint(clean))


def test_random_numbers_follow_experiment_trial_and_frame():
    case = experiment_with()

    def gaussian(mean_e, rng):
        return mean_e + rng.normal(0.0, 30.0, mean_e.shape)

    first, again, reseeded = (
        expose(case, frames(case), 3, trial=trial, noise=gaussian).stack for trial in (0, 0, 1)
    )
    np.testing.assert_array_equal(first, again)
    assert (first != reseeded).mean() > 0.3
    assert (first[2] - first[2].mean() != first[3] - first[3].mean()).any()


@pytest.mark.parametrize(
    ("noise", "message"),
    [
        (lambda mean_e, rng: mean_e[0], "returned the shape"),
        (lambda mean_e, rng: mean_e * np.nan, "not finite"),
    ],
)
def test_results_that_are_no_electrons_are_rejected(noise, message):
    case = experiment_with()
    with pytest.raises(InputError, match=message):
        expose(case, frames(case), 3, noise=noise)


def test_a_function_needs_a_camera_with_noise():
    case = experiment_with(noise=False)
    with pytest.raises(InputError, match=r"camera\.noise: found false"):
        expose(case, frames(case), 3, noise=lambda mean_e, rng: mean_e)
