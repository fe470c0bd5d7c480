"""Light profiles of the projector: blur, response, phase origin."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from twin.config import load_experiment
from twin.optics.light import OVERSAMPLING, blur, light_tables, pattern_set, response


@pytest.fixture(scope="module")
def experiment():
    return load_experiment("paper/two_balls", {"projector.width_px": 320})


def test_blur_is_box_then_gaussian():
    """Against a numerical convolution on a grid 400 times finer than a pixel."""
    rng = np.random.default_rng(1)
    light, fine = rng.random((40, 1)), 400
    staircase = np.repeat(light[:, 0], fine)
    wanted = gaussian_filter1d(staircase, 0.7 * fine, truncate=8, mode="constant")
    at_px = (np.arange(len(staircase)) + 0.5) / fine - 0.5
    found = blur(light, at_px, 0.7)[:, 0]
    np.testing.assert_allclose(found, wanted, atol=2e-6)


def test_without_blur_every_point_belongs_to_one_pixel():
    light = np.arange(5.0)[:, None]
    at_px = np.array([-0.5, 0.49, 0.5, 3.2, 4.49])
    np.testing.assert_array_equal(blur(light, at_px, 0.0)[:, 0], [0, 0, 1, 3, 4])


def test_response_spans_black_to_white(experiment):
    projector = experiment.projector.model_copy(update={"gamma": 2.2})
    levels = np.array([0, 128, 255], np.uint8)
    black = 1.0 / projector.contrast
    expected = [black, black + (1 - black) * (128 / 255) ** 2.2, 1.0]
    np.testing.assert_allclose(response(levels, projector), expected)


def test_phase_of_the_blurred_profiles_is_the_coordinate(experiment):
    """8-bit levels, DMD box and blur leave the phase linear to 1 milliperiod, away from edges."""
    patterns = pattern_set(experiment.projector, experiment.patterns)
    table = light_tables(experiment.projector, patterns)["column"]
    steps = np.array([patterns.frames[k].kind == "phase" for k in table.frames])
    frames = table.profiles[:, :-1][:, steps].astype(np.float64)
    nodes_px = table.first_px + np.arange(len(frames)) / OVERSAMPLING
    inside = (nodes_px > 20) & (nodes_px < 300)
    turns = np.exp(-2j * np.pi * np.arange(steps.sum()) / steps.sum())
    phase = np.angle(frames[inside] @ turns)
    expected = 2 * np.pi * nodes_px[inside] / experiment.patterns.period_px
    error = np.angle(np.exp(1j * (phase - expected)))
    assert np.abs(error).max() < 2e-4 * 2 * np.pi


def test_white_is_one_inside_and_black_is_the_contrast(experiment):
    patterns = pattern_set(experiment.projector, experiment.patterns)
    table = light_tables(experiment.projector, patterns)["column"]
    kinds = [patterns.frames[k].kind for k in table.frames]
    middle = table.profiles[len(table.profiles) // 2]
    assert middle[kinds.index("white")] == pytest.approx(1.0, abs=1e-6)
    assert middle[kinds.index("black")] == pytest.approx(1 / 500, rel=1e-4)
    assert middle[-1] == pytest.approx(1.0, abs=1e-6)
