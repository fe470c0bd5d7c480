"""The sliders of the live view are the numbers of the design, within their stated sources."""

import pytest

from twin.config import load_experiment, vary
from twin.viewer.sliders import slider_ranges

KEY = "elastomer.thickness_mm"
DESIGNED = {
    "coating.base_albedo",
    "coating.flake_fraction",
    "elastomer.shore_a",
    "elastomer.thickness_mm",
    "press.back_pressure_kpa",
    "press.depth_mm",
    "projector.pose.polar_deg",
    "patterns.period_px",
}


def test_controls_stay_within_their_sources():
    experiment = load_experiment("examples/slab_balls")
    controls = {slider.key: slider for slider in slider_ranges(experiment)}
    assert {"camera.pose.polar_deg", "specimen.yaw_deg"} | DESIGNED <= set(controls)
    for key, slider in controls.items():
        assert slider.low <= slider.value <= slider.high
        origin = experiment.provenance.get(key)
        if origin and origin.range:
            assert origin.range[0] <= slider.low
            assert slider.high <= origin.range[1]
    assert "press.force_n" not in controls


def test_linked_values_are_not_moved_by_themselves():
    """The gel layer follows the elastomer."""
    keys = {slider.key for slider in slider_ranges(load_experiment("examples/gel_on_window"))}
    assert "elastomer.thickness_mm" in keys
    assert "press.force_n" in keys
    assert not any(key.startswith("layers") for key in keys)


def test_an_automatic_exposure_has_a_slider_if_its_value_is_known():
    experiment = load_experiment("examples/slab_balls")
    assert all(slider.key != "camera.exposure_ms" for slider in slider_ranges(experiment))
    (exposure,) = (
        slider for slider in slider_ranges(experiment, 116.31) if slider.key == "camera.exposure_ms"
    )
    assert exposure.value == pytest.approx(116.31)
    assert exposure.low < 20
    assert exposure.high > 200


def test_a_thin_sheet_has_fine_steps_although_its_source_allows_slabs():
    sliders = {
        slider.key: slider for slider in slider_ranges(load_experiment("examples/wrapped_balls"))
    }
    thickness = sliders["elastomer.thickness_mm"]
    assert thickness.high == pytest.approx(4 * thickness.value)
    assert thickness.step < 0.01
    assert 1 < sliders["patterns.period_px"].low < sliders["patterns.period_px"].high < 100


def test_a_value_beyond_the_range_of_its_source_is_shown():
    changes = {"elastomer.thickness_mm": {"value": 2.0, "range": [2.0, 4.0], "source": "test"}}
    experiment = vary(load_experiment("examples/slab_balls", changes), {KEY: 1.5})
    (slider,) = (slider for slider in slider_ranges(experiment) if slider.key == KEY)
    assert (slider.low, slider.value, slider.high) == (1.5, 1.5, 4.0)


def test_a_share_has_no_value_above_1():
    changes = {"coating.base_albedo": {"value": 0.9, "source": "test"}}
    sliders = {s.key: s for s in slider_ranges(load_experiment("examples/slab_balls", changes))}
    assert sliders["coating.base_albedo"].high <= 1.0
