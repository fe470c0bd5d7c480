"""Budgets in quadrature from known parts."""

import numpy as np
import pytest

from twin.config.inputs import Input
from twin.propagation.budget import (
    Part,
    calibration_part,
    noise_left,
    noise_part,
    part_of,
    ranked,
    shares,
    spread_of_parabola,
    together,
)

NORMAL = Input(group="press", key="press.depth_mm", distribution="normal", spread=0.05)


def test_a_bend_has_an_uncertainty_without_a_slope():
    """f = x^2 of a standard normal x has a standard deviation of sqrt 2; f = 3 x + x^2, sqrt 11."""
    assert spread_of_parabola(1.0, 0.0, 1.0) == pytest.approx(np.sqrt(2.0))
    assert spread_of_parabola(-2.0, 0.0, 4.0) == pytest.approx(np.sqrt(11.0))


def test_parts_of_inputs():
    part = part_of("travel", NORMAL, {"low": 3.9, "nominal": 4.0, "high": 4.1})
    assert part == Part("travel", "press", "press.depth_mm", pytest.approx(0.1))
    assert part_of("travel", NORMAL, {"nominal": 4.0, "high": 4.1}) is None


def test_the_part_of_a_choice_is_its_weighted_spread():
    """1 with weight 3 and 5 with weight 1: mean 2, variance (3 + 9) / 4 = 3."""
    choice = Input(
        group="optics", key="k.k", distribution="choice", values=(10, 20), weights=(3, 1)
    )
    assert part_of("c", choice, {"10": 1.0, "20": 5.0}).u == pytest.approx(np.sqrt(3.0))


def test_quadrature_ranks_and_shares():
    parts = [Part("a", "", "", 3.0), Part("b", "", "", 4.0), Part("c", "", "", 0.0)]
    assert together(parts) == pytest.approx(5.0)
    assert [part.name for part in ranked(parts)] == ["b", "a", "c"]
    assert shares(parts) == pytest.approx([9 / 25, 16 / 25, 0.0])
    assert shares([Part("c", "", "", 0.0)]) == [0.0]


def test_sample_standard_deviations():
    """n - 1 in the denominator: of 1, 2, 3 the standard deviation is 1; one value has none."""
    values = np.array([1.0, 2.0, 3.0])
    assert noise_part(values).u == calibration_part(values).u == 1.0
    assert noise_part(values[:1]) is calibration_part(values[:1]) is None


def test_the_optics_part_is_subtracted_from_the_noise_once():
    """Trials differ from the face by 5 um; with 3 um from the optics, noise and decoding are 4 um.

    Optics, noise and calibration of 12 um then combine to 13 um, as in the trials.
    """
    rng = np.random.default_rng(1)
    raw = rng.normal(size=50)
    differences = 5.0 * (raw - raw.mean()) / raw.std(ddof=1)
    optics = [Part("focus", "optics", "", 3.0), Part("place", "placement", "", 7.0)]
    noise = noise_left(differences, optics)
    assert (noise.name, noise.u) == ("noise and decoding", pytest.approx(4.0))
    assert together([optics[0], noise, Part("calibration", "rig", "", 12.0)]) == pytest.approx(13.0)
    without = noise_left(differences, optics[1:])
    assert (without.name, without.u) == ("noise, optics and decoding", pytest.approx(5.0))
    assert noise_left(differences / 10, optics).u == 0.0
