"""The object's figures where an elastomer is between it and the coat: found, or absent with why."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from reconstruction.evaluate.conformity import CombinedUncertainty
from reconstruction.triangulation import PointMap
from tests.compensation.test_command import LAYER, coat_map
from tests.results.test_object_score import STEP, experiment, score_of
from twin.config import load_experiment
from twin.config.sensor_layer import load_sensor_layer
from twin.optics.stack import Truth
from twin.report.object import measurand_in_words, object_lines
from twin.results.object_score import ObjectScore, quantity_figures, score_object
from twin.results.under_sheet import more_contact, sheet_compensation

TRAVEL_MM = 0.6


def scored(coat: PointMap, layer=None, **settings) -> ObjectScore:
    """Score a coat over a ball of 8 mm under a sheet of 0.2 mm."""
    settings["specimen"] = {"kind": "ball", "diameter_mm": 8.0}
    case = load_experiment("examples/wrapped_balls", settings)
    points_mm, valid = coat.points_world_mm, coat.valid
    z = points_mm[..., 2]
    truth = Truth(points_mm, np.zeros_like(points_mm), z, z, z, valid, valid)
    x_mm = np.linspace(-6.0, 6.0, 241)
    touched = np.hypot(x_mm, x_mm[:, None]) < 1.0
    pressed = SimpleNamespace(depth_mm=TRAVEL_MM, x_mm=x_mm, y_mm=x_mm, contact=touched)
    compensation = sheet_compensation(case, coat, layer)
    return score_object(case, (points_mm, valid, coat.sigma_z_mm), truth, pressed, compensation)


@pytest.fixture(scope="module")
def layer(tmp_path_factory):
    file = tmp_path_factory.mktemp("layer") / "layer.toml"
    file.write_text(LAYER)
    return load_sensor_layer(file)


@pytest.fixture(scope="module")
def wrapped(layer) -> ObjectScore:
    return scored(coat_map(), layer)


def test_the_radius_is_that_of_the_object(wrapped):
    """Setup: ball of 4 mm under a sheet of 0.2 mm and 2 kPa, by the one-dimensional solver.

    Expected: 4 mm within U, which has the layer's 4 um of thickness; the coat's 4.19 mm is named as
    such. Less the nominal thickness it would be 3.99 mm, 10 um off.
    """
    ball, figures = wrapped.quantity("radius_1"), wrapped.figures
    assert ball.value == pytest.approx(4.0, abs=2e-3)
    assert abs(ball.error) < ball.uncertainty.expanded < 12.0
    assert 2.5 < ball.uncertainty.elastomer < 6.0
    assert 4.15 < ball.coat < 4.25
    assert figures["object_radius_1_mm"] == ball.value
    assert figures["object_radius_1_coat_mm"] == ball.coat
    # All of its points are the object's, none is that of a sheet of the nominal thickness.
    assert figures["object_rms_um"] < 2.0


def test_the_first_figure_in_words_is_the_object(wrapped):
    words = measurand_in_words(wrapped.quantity("radius_1"))
    assert words.startswith("radius 1: 4.00") or words.startswith("radius 1: 3.99")
    before, after = words.split("apparent in the coat: ")
    assert "±" in before
    assert after.startswith(f"{wrapped.quantity('radius_1').coat:.4f} mm")


def test_a_condition_of_the_uncertainty_is_in_figures_and_words(wrapped):
    """A contact of few patches of the coat: one press does not determine the scatter."""
    ball = wrapped.quantity("radius_1")
    assert ball.condition == ""
    assert "object_radius_1_condition" not in wrapped.figures
    few = replace(ball, condition="U is a lower limit: the contact has only 5 patches")
    assert "only 5 patches" in measurand_in_words(few)
    assert dict(quantity_figures(few))["object_radius_1_condition"] == few.condition


def test_thickness_and_air_of_an_experiment_are_in_the_uncertainty():
    """Setup: the coat of a ball under 0.2 mm; without [sigma] the spreads of inputs/handling.

    Expected: 2 % of the thickness are 4 um, which move the radius by about as much.
    """
    usual, stated = (
        scored(coat_map(), **settings).quantity("radius_1").uncertainty
        for settings in ({}, {"sigma.thickness_mm": 1e-3, "sigma.back_pressure_kpa": 0.0})
    )
    assert 3.0 < usual.elastomer < 6.0
    assert stated.elastomer < 0.5 * usual.elastomer
    assert usual.calibration == pytest.approx(0.108, rel=0.02)


def test_what_is_touched_too_little_is_absent_and_says_what_to_do():
    """A coat that remains flat without air: the ball does not carry the sheet."""
    coat = coat_map()
    flat = coat.points_world_mm * np.float32([1.0, 1.0, 0.0])
    without_air = {"press.back_pressure_kpa": 0.0}
    score = scored(replace(coat, points_world_mm=flat), **without_air)
    ball = score.quantity("radius_1")
    assert (ball.value, ball.error, score.figures["object_radius_1_mm"]) == (None, None, None)
    assert "0 cells" in ball.why
    ways = more_contact(score.observed.measured.under)
    assert "press.back_pressure_kpa = " in ways
    assert "press deeper" in ways
    assert "elastomer.tack_j_m2" in ways


@pytest.mark.parametrize("radius_mm", [4.01, 80.0])
def test_a_radius_of_another_feature_has_a_remedy(wrapped, layer, radius_mm):
    """A fitted radius of 80 mm is no measurement of a ball of 4 mm, though it is a number."""
    case = load_experiment("examples/wrapped_balls", {"specimen": {"kind": "ball"}})
    ball = replace(wrapped.quantity("radius_1"), value=radius_mm)
    lines = object_lines(
        SimpleNamespace(
            experiment=case,
            object=replace(wrapped, quantities=(ball,)),
            compensation=sheet_compensation(case, coat_map(), layer),
            figures=wrapped.figures,
        )
    )
    is_lost = radius_mm > 2 * 4.0
    assert ("not measured (fit: 80 mm)" in lines[0]) == is_lost
    assert [line.startswith("to measure the object, press deeper") for line in lines[2:]] == (
        [True] if is_lost else []
    )


def test_a_slab_shows_no_length_of_the_object():
    """Nominal thickness is no thickness: under a slab the coat is no parallel surface."""
    sheet = {"elastomer.layout": "opposite_face", "layers": {}}
    sheet["elastomer.thickness_mm"] = {"value": 3.0, "source": "test"}
    score = score_of(experiment({"kind": "ball"}, **sheet), 0.0, 1e-6, skin_mm=3.0)
    ball = score.quantity("radius_1")
    assert ball.value is None
    assert "twin compensate" in ball.why
    assert ball.coat == pytest.approx(4.0, abs=1e-3)
    assert "apparent in the coat: 4.0" in measurand_in_words(ball)


@pytest.mark.parametrize(
    ("specimen", "name", "touched"),
    [
        (STEP, "step_height", lambda x: x < 0),
        (STEP, "step_height", lambda x: x > 0),
        ({"kind": "v_groove", "angle_deg": 150.0}, "depth", lambda x: np.abs(x) > 2.0),
        ({"kind": "v_groove", "angle_deg": 150.0}, "width", lambda x: x > 0.0),
        ({"kind": "grating", "pitch_mm": 1.5, "groove_mm": 0.1}, "depth",
         lambda x: np.cos(2 * np.pi * x / 1.5) > 0.5),
        ({"kind": "bars", "widths_mm": [4.0], "height_mm": 0.8}, "width_1",
         lambda x: np.abs(x) < 1.8),
    ],
)  # fmt: skip
def test_a_dimension_that_is_not_touched_is_absent(specimen, name, touched):
    """Where a gel spans from crest to crest its own relief is no depth of the object."""
    score = score_of(experiment(specimen), 0.0, 1e-6, touched=touched)
    quantity = score.quantity(name)
    assert quantity.value is None
    assert "touched" in quantity.why or "level" in quantity.why
    assert score.figures[f"object_{name}_mm"] is None


def test_what_its_points_do_not_determine_is_absent():
    """A ball that shows a plane under noise of 3 um: a radius of any size would fit."""
    case = experiment({"kind": "ball"})
    x, y = np.linspace(-6.0, 6.0, 241), np.linspace(4.5, -4.5, 181)
    ball_mm = np.sqrt(np.maximum(16.0 - x**2 - y[:, None] ** 2, 0.0)) - 4.0
    noise_mm = np.random.default_rng(3).normal(0.0, 3e-3, ball_mm.shape)
    quantity = score_of(case, noise_mm - ball_mm, 3e-3).quantity("radius_1")
    assert quantity.value is None
    assert "not determined" in quantity.why


def test_what_is_open_of_the_elastomer_is_part_of_the_uncertainty():
    assert CombinedUncertainty(3.0, elastomer=4.0).expanded == pytest.approx(10.0)
