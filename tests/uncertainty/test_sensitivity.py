"""Sobol' indices and correlations against functions with known results."""

import numpy as np
import pytest
from scipy import stats

from reconstruction.errors import InputError
from twin.config import load_experiment
from twin.config.inputs import Input
from twin.propagation.sensitivity import (
    correlation_of,
    sobol_effects,
    sobol_of_face,
    sobol_points,
)


def sobol_indices(model, distributions, names, base_points):
    """Evaluate a model of inputs (input, n) at base points x (inputs + 2) places."""
    return sobol_effects(model(sobol_points(distributions, base_points, 0)), names)


def test_ishigami():
    """Ishigami and Homma (1990), a = 7, b = 0.1: S = 0.314, 0.442, 0; totals 0.558 to 0.244."""

    def model(x):
        return np.sin(x[0]) + 7 * np.sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * np.sin(x[0])

    angles = [stats.uniform(-np.pi, 2 * np.pi)] * 3
    effects = sobol_indices(model, angles, "abc", 4096)
    assert [effect.value for effect in effects] == pytest.approx([0.314, 0.442, 0.0], abs=0.02)
    assert [effect.total for effect in effects] == pytest.approx([0.558, 0.442, 0.244], abs=0.02)


def test_a_linear_model_of_normal_inputs():
    """S_i = (c_i u_i)^2 / sum: 0.2 and 0.8; no interactions, so totals are the same."""
    dists = [stats.norm(scale=0.5), stats.norm(scale=1.0)]
    effects = sobol_indices(lambda x: 2.0 * x[0] - 2.0 * x[1], dists, "ab", 1024)
    assert [effect.value for effect in effects] == pytest.approx([0.2, 0.8], abs=0.03)
    assert [effect.total for effect in effects] == pytest.approx([0.2, 0.8], abs=0.03)


def test_correlations():
    x = np.arange(10.0)
    straight, bent = correlation_of("x", x, 3 - 2 * x), correlation_of("x", x, np.exp(x))
    assert (straight.linear, straight.rank) == pytest.approx((-1.0, -1.0))
    assert bent.rank == pytest.approx(1.0)
    assert bent.linear < 0.9
    assert correlation_of("x", x, np.ones(10)) is None


@pytest.fixture(scope="module")
def on_coat():
    """The coat touches the balls: within the contact it coincides with their surface."""
    settings = {
        "elastomer.layout": "contact_face",
        "press.back_pressure_kpa": 0.0,
        "press.solver_pitch_mm": 0.2,
        "press.relief_pitch_mm": 0.05,
    }
    return load_experiment("examples/slab_balls", settings)


def test_the_radius_on_a_touched_coat_follows_the_diameter(on_coat):
    """R = D / 2: the diameter explains all of the radius's variance, the travel none."""
    size = {"group": "placement", "key": "specimen.diameter_mm", "distribution": "uniform"}
    travel = {"group": "press", "key": "press.depth_mm", "distribution": "normal"}
    focus = {"group": "optics", "key": "projector.blur_px", "distribution": "normal"}
    inputs = {
        "size": Input(**size, spread=0.2),
        "travel": Input(**travel, spread=0.01),
        "focus": Input(**focus, spread=0.05),
    }
    effects = sobol_of_face(on_coat, inputs, ["sphere_1_radius_mm", "z_rmse_um"], 32)
    assert list(effects) == ["sphere_1_radius_mm"]
    assert [effect.axis for effect in effects["sphere_1_radius_mm"]] == ["size", "travel"]
    size, travel = effects["sphere_1_radius_mm"]
    assert size.total == pytest.approx(1.0, abs=0.25)
    assert travel.total < 0.05


@pytest.mark.parametrize(
    ("measurand", "points", "line"),
    [
        ("sphere_1_radius_mm", 12, "--sobol 12: allowed a power of 2"),
        ("z_rmse_um", 2, "z_rmse_um: no figure of the pressed face, allowed depth_mm"),
    ],
)
def test_bad_input_is_one_line(on_coat, measurand, points, line):
    inputs = {"x": Input(group="press", key="press.depth_mm", distribution="normal", spread=0.01)}
    with pytest.raises(InputError, match=line):
        sobol_of_face(on_coat, inputs, [measurand], points)
