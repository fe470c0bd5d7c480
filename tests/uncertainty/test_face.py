"""Radius, width and budget from the pressed face, without rendering."""

import numpy as np
import pytest

from twin.config import load_experiment, vary
from twin.config.inputs import Input
from twin.pipeline.press import press_specimen
from twin.propagation.budget import part_of
from twin.results.parts import face_figures
from twin.study.measuring import CaseMeasurer
from twin.study.trials import INPUT, STEP, alone_cases

ON_COAT = {
    "elastomer.layout": "contact_face",
    "press.back_pressure_kpa": 0.0,
    "press.solver_pitch_mm": 0.1,
}


@pytest.fixture(scope="module")
def on_coat():
    """The coat touches the balls: within the contact it coincides with their surface."""
    return load_experiment("examples/slab_balls", ON_COAT)


def test_a_coat_on_the_ball_has_its_radius(on_coat):
    figures = pressed_figures(on_coat)
    assert figures["sphere_1_radius_mm"] == pytest.approx(4.0, rel=1e-3)
    assert figures["sphere_1_rmse_mm"] < 1e-4


def test_parts_against_the_closed_form(on_coat):
    """R = D / 2 on such a coat: u(R) = u(D) / 2; depth does not change R; optics are not varied."""
    size = {"group": "placement", "key": "specimen.diameter_mm", "distribution": "uniform"}
    depth = {"group": "press", "key": "press.depth_mm", "distribution": "normal"}
    focus = {"group": "optics", "key": "projector.blur_px", "distribution": "normal"}
    inputs = {
        "size": Input(**size, spread=0.01),
        "depth": Input(**depth, spread=0.05),
        "focus": Input(**focus, spread=0.05),
    }
    cases, measurer = alone_cases(on_coat, inputs, face_only=True), CaseMeasurer()
    by_step = {
        (case.settings[INPUT], case.settings[STEP]): measurer(
            case.experiment, case.conditions
        ).figures
        for case in cases
    }
    assert {title for title, _ in by_step} == {"", "size", "depth"}

    def part(title):
        steps = {
            step: figures["sphere_1_radius_mm"]
            for (of, step), figures in by_step.items()
            if of in ("", title)
        }
        return part_of(title, inputs[title], steps).u

    assert part("size") == pytest.approx(0.01 / np.sqrt(3) / 2, rel=0.05)
    assert part("depth") < 2e-4


def test_back_pressure_separates_the_two_balls():
    """Radius and residual with and without back pressure, which the paper's scenes have."""
    draped = load_experiment("examples/slab_balls", {"press.solver_pitch_mm": 0.1})
    free = vary(draped, {"press.back_pressure_kpa": 0.0})
    with_drape, without = pressed_figures(draped), pressed_figures(free)
    assert with_drape["sphere_1_radius_mm"] == pytest.approx(6.5, abs=0.1)
    assert without["sphere_1_radius_mm"] > 30.0
    assert 5e-3 < with_drape["sphere_1_rmse_mm"] < 13e-3


def test_optics_do_not_change_the_press_and_hardly_the_radius(mi):
    """One press, no noise: 1.5 x the albedo changes the radius slightly, the face not at all."""
    small = {"camera.binning": 4, "patterns.steps": 3, "render.samples": 1}
    experiment = load_experiment("examples/slab_balls", small | {"press.solver_pitch_mm": 0.2})
    albedo = {"group": "optics", "key": "coating.base_albedo", "distribution": "choice"}
    cases = alone_cases(experiment, {"albedo": Input(**albedo, values=(0.4, 0.6))})
    measurer = CaseMeasurer()
    middle, *_, bright = (measurer(case.experiment).figures for case in cases)
    assert bright["sphere_1_true_face_radius_mm"] == middle["sphere_1_true_face_radius_mm"]
    assert 0.0 < abs(bright["sphere_1_radius_mm"] - middle["sphere_1_radius_mm"]) < 0.05


def pressed_figures(experiment):
    return face_figures(experiment, press_specimen(experiment))
