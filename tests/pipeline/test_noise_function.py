"""A measurement with noise by a function of the user."""

import numpy as np
import pytest

import twin
from reconstruction.errors import InputError

SMALL = {
    "camera.binning": 2,
    "camera.width_px": 160,
    "camera.height_px": 120,
    "press.relief_pitch_mm": 0.05,
    "press.solver_pitch_mm": 0.2,
}


def mean_only(mean_e, rng):
    return mean_e


def test_the_recording_follows_the_function_and_the_result_names_it(mi: object) -> None:
    """One memory gives recordings by the function and by EMVA 1288, as an empty memory does."""
    experiment, memory = twin.load_experiment("examples/slab_ball", SMALL), twin.Memory()
    clean = twin.measure(experiment, memory=memory, noise=mean_only)
    noisy = twin.measure(experiment, memory=memory)
    alone = twin.measure(experiment)
    stacks = [measured.images.capture.stack for measured in (clean, noisy, alone)]
    np.testing.assert_array_equal(stacks[1], stacks[2])
    difference = stacks[1].astype(float) - stacks[0]
    assert 0.0 < difference.std() < 0.05 * stacks[0].max()
    warnings = [w for w in clean.metrics["warnings"] if "function mean_only" in w]
    assert len(warnings) == 1
    assert not any("function" in warning for warning in noisy.metrics["warnings"])


def test_photometric_stereo_takes_no_function() -> None:
    experiment = twin.load_experiment("examples/gelsight_ball")
    with pytest.raises(InputError, match="noise: found a function, allowed for methods with"):
        twin.measure(experiment, noise=mean_only)
