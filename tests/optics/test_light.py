"""Light profiles of the projector: blur, response, phase origin."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from reconstruction.rig.projected_light import blurred
from twin.config import ConfigError, load_experiment, to_toml, vary
from twin.optics.light import (
    OVERSAMPLING,
    dithering_error,
    light_tables,
    pattern_set,
    response,
)
from twin.optics.rig import projector_pinhole


@pytest.fixture(scope="module")
def experiment():
    return load_experiment("examples/slab_balls", {"projector.width_px": 320})


def test_blur_is_box_then_gaussian():
    """Against a numerical convolution on a grid 400 times finer than a pixel."""
    rng = np.random.default_rng(1)
    light, fine = rng.random((40, 1)), 400
    staircase = np.repeat(light[:, 0], fine)
    wanted = gaussian_filter1d(staircase, 0.7 * fine, truncate=8, mode="constant")
    at_px = (np.arange(len(staircase)) + 0.5) / fine - 0.5
    profile = blurred(light, at_px, 0.7)[:, 0]
    np.testing.assert_allclose(profile, wanted, atol=2e-6)


def test_without_blur_every_point_belongs_to_one_pixel():
    """On the border of two pixels both share it: the limit of ever less blur."""
    light = np.arange(5.0)[:, None]
    at_px = np.array([-0.5, 0.49, 0.5, 0.51, 3.2, 4.49, 4.5])
    np.testing.assert_array_equal(blurred(light, at_px, 0.0)[:, 0], [0, 0, 0.5, 1, 3, 4, 2])


def test_no_blur_is_the_limit_of_little_blur(experiment):
    """Setup: phase read from the table in use, between its nodes, with blur 0 and 0.001 px.

    Expected: the same coordinate within 0.0005 px, and neither shifted by a part of a node.
    """
    patterns = pattern_set(experiment.projector, experiment.patterns)
    at_px = np.linspace(20.0, 300.0, 4481) + 1e-3
    without, little = (
        _decoded_px(
            vary(experiment, {"projector.blur_px": {"value": blur_px, "source": "test"}}),
            patterns,
            at_px,
        )
        for blur_px in (0.0, 0.001)
    )
    np.testing.assert_allclose(without, little, atol=5e-4)
    assert abs(np.mean(without - at_px)) < 5e-4


def test_diamond_pixels_have_blur_in_rows_and_their_shape(experiment):
    """Expected: fy = 2 fx; along rows twice the blur and a wider pixel; square ones unnamed."""
    changed = vary(experiment, {"projector.pixel_ratio": {"value": "diamond", "source": "test"}})
    lens, square = projector_pinhole(changed.projector), projector_pinhole(experiment.projector)
    assert (lens.fx_px, lens.fy_px) == (square.fx_px, 2.0 * square.fx_px)
    assert lens.cy_px == square.cy_px
    patterns = pattern_set(changed.projector, changed.patterns)
    assert patterns.pixel_ratio == "diamond"
    tables = light_tables(changed.projector, patterns)
    for axis, blur, smear in (("column", 1.0, 0.5), ("row", 2.0, 1.0)):
        profiles = tables[axis].profiles
        nodes_px = tables[axis].first_px + np.arange(len(profiles)) / OVERSAMPLING
        length = patterns.width_px if axis == "column" else patterns.height_px
        outline = blurred(np.ones((length, 1)), nodes_px, blur * changed.projector.blur_px, smear)
        np.testing.assert_allclose(profiles[:, -1], outline[:, 0], atol=1e-6)
    assert "pixel_ratio" not in to_toml(experiment)


def _decoded_px(experiment, patterns, at_px):
    """Column coordinates from the phase frames, as the renderer interpolates them."""
    table = light_tables(experiment.projector, patterns)["column"]
    nodes_px = table.first_px + np.arange(len(table.profiles)) / OVERSAMPLING
    steps = [k for k, n in enumerate(table.frames) if patterns.frames[n].kind == "phase"]
    turns = np.exp(-2j * np.pi * np.arange(len(steps)) / len(steps))
    frames = [np.interp(at_px, nodes_px, table.profiles[:, k].astype(np.float64)) for k in steps]
    period_px = experiment.patterns.period_px
    phase = np.angle(turns @ np.array(frames)) - 2 * np.pi * at_px / period_px
    return at_px + period_px * np.angle(np.exp(1j * phase)) / (2 * np.pi)


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


def test_a_measured_response_is_interpolated(experiment):
    """Levels on the table's nodes get its values, those between the mean of their neighbours."""
    table = (0.0, 0.1, 0.1, 0.4, 0.7, 1.0)  # at levels 0, 51, 102, ...
    projector = vary(experiment, {"projector.response": table}).projector
    levels = np.array([0, 51, 102, 153, 204, 255, 178, 179], np.uint8)
    relative = [*table, 0.4 + 0.3 * 25 / 51, 0.4 + 0.3 * 26 / 51]
    black = 1.0 / projector.contrast
    expected = black + (1.0 - black) * np.array(relative)
    np.testing.assert_allclose(response(levels, projector), expected)


def test_a_fine_table_of_a_power_law_is_the_power_law(experiment):
    levels = np.arange(256, dtype=np.uint8)
    table = ((levels / 255.0) ** 2.2).tolist()
    by_table = vary(experiment, {"projector.response": table}).projector
    by_law = experiment.projector.model_copy(update={"gamma": 2.2})
    np.testing.assert_allclose(response(levels, by_table), response(levels, by_law), atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"response": [0.0, 0.5, 0.4, 1.0]}, "never decrease"),
        ({"response": [0.0, 0.9]}, "the last 1"),
        ({"response": [1.0]}, "two or more"),
        ({"response": [0.0, 1.0], "gamma": 1.5}, "gamma = 1"),
    ],
)
def test_a_wrong_response_is_one_line(changes, problem):
    dotted = {f"projector.{key}": value for key, value in changes.items()}
    with pytest.raises(ConfigError) as caught:
        load_experiment("examples/slab_balls", dotted)
    assert "projector.response: found" in str(caught.value)
    assert problem in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_response_survives_writing_and_reading(experiment, tmp_path):
    curved = vary(experiment, {"projector.response": [0.0, 0.3, 1.0]})
    file = tmp_path / "experiment.toml"
    file.write_text(to_toml(curved), encoding="utf-8")
    assert load_experiment(file) == curved


@pytest.mark.parametrize("periods", [0.4, 1.3, 7.6])
def test_dithering_is_the_mean_of_the_mirrors_over_the_exposure(experiment, periods):
    """Setup: mirrors sampled at 2550 times per period, highest bit first. Expected: their mean."""
    projector = experiment.projector.model_copy(update={"dither_periods": periods})
    codes = np.array([0, 1, 77, 128, 200, 255], np.uint8)
    light = response(codes, projector)[:, None] + dithering_error(
        np.repeat(codes[:, None], 5, axis=1), projector, range(5)
    )
    order = np.repeat(np.arange(7, -1, -1), 10 * 2 ** np.arange(7, -1, -1))
    black = 1.0 / projector.contrast
    for frame in range(5):
        time = (np.arange(100_000) + 0.5) / 100_000 * periods + frame * periods
        bit = order[(time % 1.0 * order.size).astype(int)]
        shown = np.array([(code >> bit & 1).mean() for code in codes])
        np.testing.assert_allclose(light[:, frame], black + (1.0 - black) * shown, atol=2e-3)


def test_dithering_over_whole_periods_has_exact_levels(experiment):
    levels = np.repeat(np.arange(256, dtype=np.uint8)[:, None], 9, axis=1)
    synchronised = experiment.projector.model_copy(update={"dither_periods": 12.0})
    np.testing.assert_allclose(dithering_error(levels, synchronised, range(9)), 0.0, atol=1e-12)
    changed = vary(experiment, {"projector.dither_periods": 12.4})
    patterns = pattern_set(changed.projector, changed.patterns)
    tables = [light_tables(e.projector, patterns)["row"].profiles for e in (experiment, changed)]
    kinds = [frame.kind for frame in patterns.frames if frame.axis == "row"]
    same = [np.allclose(*(table[:, k] for table in tables), atol=1e-6) for k in range(len(kinds))]
    assert same == [kind != "phase" for kind in kinds]
