"""Radius and budget from the pressed face alone."""

import numpy as np
import pytest

from twin.config import load_experiment, vary
from twin.paper.face_model import _of_differences, contributions, face_figures
from twin.paper.scatter import Input

ON_COAT = {
    "elastomer.layout": "contact_face",
    "press.back_pressure_kpa": 0.0,
    "press.solver_pitch_mm": 0.1,
}


@pytest.fixture(scope="module")
def on_coat():
    """The coat touches the balls: within the contact it IS their surface."""
    return load_experiment("paper/two_balls", ON_COAT)


def test_a_coat_that_touches_the_ball_shows_its_radius(on_coat):
    figures = face_figures(on_coat)
    assert figures["sphere_1_radius_mm"] == pytest.approx(4.0, rel=1e-3)
    assert figures["sphere_1_rmse_mm"] < 1e-4


def test_contributions_against_the_closed_form(on_coat):
    """R = D / 2 on such a coat: u(R) = u(D) / 2; depth does not change R."""
    size = {"group": "placement", "key": "specimen.diameter_mm", "distribution": "uniform"}
    depth = {"group": "press", "key": "press.depth_mm", "distribution": "normal"}
    inputs = {"size": Input(**size, spread=0.01), "depth": Input(**depth, spread=0.05)}
    found = contributions(on_coat, inputs, "sphere_1_radius_mm")
    assert [one.name for one in found] == ["size", "depth"]
    assert found[0].output_u_mm == pytest.approx(0.01 / np.sqrt(3) / 2, rel=0.05)
    assert found[1].output_u_mm < 2e-4


def test_the_drape_makes_one_hump_two_balls():
    """What the decision on the paper's scenes rests on: radius and residual with and without."""
    draped = load_experiment("paper/two_balls", {"press.solver_pitch_mm": 0.1})
    free = vary(draped, {"press.back_pressure_kpa": 0.0})
    with_drape, without = face_figures(draped), face_figures(free)
    assert with_drape["sphere_1_radius_mm"] == pytest.approx(6.5, abs=0.1)
    assert without["sphere_1_radius_mm"] > 30.0
    assert 5e-3 < with_drape["sphere_1_rmse_mm"] < 13e-3


def test_optics_do_not_move_the_press_and_hardly_the_radius(mi):
    """One press, no noise: the same figures twice; half as bright again moves it little."""
    from twin.paper.optics_model import chain_figures
    from twin.pipeline.press import press_specimen

    small = {"camera.binning": 4, "patterns.steps": 3, "render.samples": 1}
    experiment = load_experiment("paper/two_balls", small | {"press.solver_pitch_mm": 0.2})
    pressed = press_specimen(experiment)
    first, again = (chain_figures(pressed, experiment) for _ in range(2))
    assert first == again
    bright = chain_figures(pressed, vary(experiment, {"coating.base_albedo": 0.6}))
    assert bright["sphere_1_true_face_radius_mm"] == first["sphere_1_true_face_radius_mm"]
    moved_mm = bright["sphere_1_radius_mm"] - first["sphere_1_radius_mm"]
    assert 0.0 < abs(moved_mm) < 0.05


def test_a_bend_counts_where_there_is_no_slope():
    """f = x^2 of a standard normal x has a standard deviation of sqrt 2; f = 3 x + x^2, sqrt 11."""
    assert _of_differences(1.0, 0.0, 1.0) == pytest.approx(np.sqrt(2.0))
    assert _of_differences(-2.0, 0.0, 4.0) == pytest.approx(np.sqrt(11.0))
