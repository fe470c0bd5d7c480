"""Every kind of distribution of a recipe, drawn as its samples are, at a level of 1 %.

Kolmogorov-Smirnov tests for numbers, chi-square tests for levels; the laws are closed forms.
"""

from collections.abc import Callable
from typing import Any, get_args

import numpy as np
import pytest
from scipy import stats

from twin.config import load_experiment, vary
from twin.config.dataset import Recipe
from twin.config.inputs import Input
from twin.dataset.draws import draw_sample, levels_of
from twin.dataset.methods import parts_of
from twin.study.trials import drawn_values

LEAST_P, DRAWS = 0.01, 400
NOMINAL = 5.0
INPUTS: dict[str, dict[str, Any]] = {
    "normal": {"spread": 0.4},
    "relative": {"distribution": "normal", "spread": 0.1, "relative": True},
    "cut": {"distribution": "normal", "spread": 1.0, "at_least": 4.5, "at_most": 7.0},
    "uniform": {"spread": 0.3},
    "triangular": {"spread": 0.3},
    "arcsine": {"spread": 0.3},
    "student_t": {"spread": 0.2, "degrees_of_freedom": 4.0},
    "choice": {"values": (1.0, 2.0, 4.0), "weights": (1.0, 2.0, 5.0)},
}


def _half(x: np.ndarray, half_width: float = 0.3) -> np.ndarray:
    """Return deviations from the nominal value in half widths, within -1 and 1."""
    return np.clip((np.asarray(x) - NOMINAL) / half_width, -1.0, 1.0)


def _cut(x: np.ndarray) -> np.ndarray:
    below, inside = stats.norm.cdf(-0.5), stats.norm.cdf(2.0) - stats.norm.cdf(-0.5)
    return np.clip((stats.norm.cdf(np.asarray(x) - NOMINAL) - below) / inside, 0.0, 1.0)


def _triangular(x: np.ndarray) -> np.ndarray:
    u = _half(x)
    return np.where(u < 0, (1 + u) ** 2 / 2, 1 - (1 - u) ** 2 / 2)


def _student_4(x: np.ndarray) -> np.ndarray:
    """Return the distribution function of t with 4 degrees of freedom (its closed form)."""
    t = (np.asarray(x) - NOMINAL) / 0.2
    return 0.5 + t * (t**2 + 6) / (2 * (t**2 + 4) ** 1.5)


LAWS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "normal": stats.norm(NOMINAL, 0.4).cdf,
    "relative": stats.norm(NOMINAL, 0.1 * NOMINAL).cdf,
    "cut": _cut,
    "uniform": lambda x: (1 + _half(x)) / 2,
    "triangular": _triangular,
    "arcsine": lambda x: 0.5 + np.arcsin(_half(x)) / np.pi,
    "student_t": _student_4,
}


@pytest.mark.parametrize("name", [*INPUTS])
def test_inputs(name: str) -> None:
    known = {"group": "optics", "key": "camera.read_noise_e", "distribution": name} | INPUTS[name]
    base = vary(load_experiment("examples/slab_ball"), {known["key"]: NOMINAL})
    inputs = {name: Input(**known)}
    drawn = [drawn_values(base, inputs, 7, n)[known["key"]] for n in range(1, DRAWS + 1)]
    if name == "choice":
        counts = [drawn.count(value) for value in known["values"]]
        weights = np.array(known["weights"])
        assert stats.chisquare(counts, DRAWS * weights / weights.sum()).pvalue > LEAST_P
    else:
        assert stats.kstest(drawn, LAWS[name]).pvalue > LEAST_P


def test_all_kinds_of_inputs_are_tested() -> None:
    kinds = get_args(Input.model_fields["distribution"].annotation)
    assert {INPUTS[name].get("distribution", name) for name in INPUTS} == set(kinds)


AXES: dict[str, dict[str, Any]] = {
    "uniform": {"low": 2.0, "high": 6.0},
    "log": {"low": 0.1, "high": 100.0, "scale": "log"},
    "values": {"values": [1.0, 3.0, 7.0]},
    "count": {"low": 1.0, "high": 2.0, "count": 5},
    "integer": {"low": -1.5, "high": 2.0, "integer": True},
    "log_integer": {"low": 1, "high": 6, "scale": "log", "integer": True},
    "choices": {"choices": {"a": {"camera": {"gain": 1.0}}, "b": {"camera": {"gain": 2.0}}}},
}
SHARES: dict[str, dict[Any, float]] = {
    "values": dict.fromkeys([1.0, 3.0, 7.0], 1 / 3),
    "count": dict.fromkeys([1.0, 1.25, 1.5, 1.75, 2.0], 0.2),
    "integer": dict.fromkeys([-1, 0, 1, 2], 0.25),
    # The whole number n has the share of [n, n + 1) on the logarithmic scale from 1 to 7.
    "log_integer": {n: np.log((n + 1) / n) / np.log(7.0) for n in range(1, 7)},
    "choices": {"a": 0.5, "b": 0.5},
}


def recipe_of(axis: dict[str, Any], **keys: Any) -> Recipe:
    named = {"name": "drawn"} | ({} if "choices" in axis else {"path": "camera.read_noise_e"})
    scenes = [{"name": "one", "base": "examples/slab_ball"}]
    known = {"sample": {"hold": ["depth_mm"]}, "seed": 3} | keys
    return Recipe(name="test", scene=scenes, axis=[named | axis], **known)


@pytest.mark.parametrize("name", [*AXES])
def test_axes(name: str) -> None:
    recipe = recipe_of(AXES[name])
    drawn = [levels_of(recipe, recipe.scene[0], n)["drawn"].label for n in range(2 * DRAWS)]
    if name in SHARES:
        assert set(drawn) <= set(SHARES[name])
        counts = [drawn.count(level) for level in SHARES[name]]
        expected = 2 * DRAWS * np.array([*SHARES[name].values()])
        assert stats.chisquare(counts, expected).pvalue > LEAST_P
    else:
        law = {"uniform": stats.uniform(2.0, 4.0), "log": stats.loguniform(0.1, 100.0)}[name]
        assert stats.kstest(drawn, law.cdf).pvalue > LEAST_P


def test_inputs_that_are_drawn_together_are_a_joint_distribution() -> None:
    """Expected: only the pairs of the lists, equally frequent; other inputs are independent."""
    known = {"group": "optics", "distribution": "choice", "together": "calibration"}
    pairs = {
        "noise": Input(key="camera.read_noise_e", values=(2.0, 3.0, 4.0), **known),
        "dark": Input(key="camera.dark_current_e_per_s", values=(9.0, 8.0, 7.0), **known),
    }
    base = load_experiment("examples/slab_ball")
    drawn = [tuple(drawn_values(base, pairs, 2, n).values()) for n in range(1, 301)]
    counts = [drawn.count(pair) for pair in ((2.0, 9.0), (3.0, 8.0), (4.0, 7.0))]
    assert sum(counts) == len(drawn)
    assert stats.chisquare(counts).pvalue > LEAST_P


def test_all_methods_of_a_sample_have_the_same_drawn_values() -> None:
    """Expected: one draw for all methods, with the distribution of the recipe; poses, too."""
    angle = {"group": "optics", "key": "projector.pose.polar_deg", "distribution": "normal"}
    recipe = recipe_of(
        {"low": 2.0, "high": 6.0},
        inputs={"angle": angle | {"spread": 0.5}},
        sample={"hold": ["depth_mm"], "methods": ["contact_fpp", "direct_fpp"]},
    )
    material = {"kind": "diffuse", "albedo": 0.5}
    base = vary(load_experiment("examples/slab_ball"), {"specimen.material": material})
    noise, angles = [], []
    for number in range(100):
        case = draw_sample(recipe, (base,), number).case
        assert case is not None
        parts = [part.experiment for part in parts_of(recipe.sample, case.experiment)]
        assert [part.modality for part in parts] == ["contact_fpp", "direct_fpp"]
        (read_noise_e,) = {part.camera.read_noise_e for part in parts}
        (polar_deg,) = {part.projector.pose.polar_deg for part in parts}
        noise.append(read_noise_e)
        angles.append(polar_deg)
    assert stats.kstest(noise, stats.uniform(2.0, 4.0).cdf).pvalue > LEAST_P
    law = stats.norm(base.projector.pose.polar_deg, 0.5)
    assert stats.kstest(angles, law.cdf).pvalue > LEAST_P
