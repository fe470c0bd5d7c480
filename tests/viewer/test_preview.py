"""A preview shows the changed values, with the press and the trace of a measurement."""

import numpy as np
import pytest

from reconstruction.errors import InputError
from twin.cli import run
from twin.config import load_experiment
from twin.mechanics import press
from twin.viewer.preview import Preview, PreviewPicture, slider_ranges, thinned


@pytest.fixture(scope="module")
def preview(mi) -> Preview:
    return Preview(load_experiment("examples/slab_balls"))


@pytest.fixture(scope="module")
def first(preview):
    return preview.show({})


def test_a_picture_is_small_and_lit(first):
    assert max(first.fringes.shape) < 300
    assert first.fringes.shape == first.white.shape
    assert first.white.max() > 150
    # Fringes: along a row through the coat, light and dark in turn.
    row = first.fringes[first.fringes.shape[0] // 2].astype(float)
    assert np.ptp(row) > 100


@pytest.mark.parametrize(
    "changes",
    [
        {"elastomer.thickness_mm": 2.0},
        {"camera.pose.polar_deg": 6.0},
        {"projector.pose.polar_deg": 24.0},
        {"specimen.x_mm": 1.0},
    ],
)
def test_what_is_moved_changes_the_picture(preview, first, changes):
    moved = preview.show(changes)
    assert (moved.fringes != first.fringes).mean() > 0.05
    assert moved.experiment != first.experiment


def test_moved_back_it_is_the_same(preview, first):
    preview.show({"specimen.x_mm": 1.0})
    np.testing.assert_array_equal(preview.show({}).fringes, first.fringes)


def test_a_thinner_sheet_shows_more_of_the_balls(preview, first):
    """The peak of the coat at the same travel equals that of the press stage."""
    thin = preview.show({"elastomer.thickness_mm": 2.0})
    experiment = load_experiment("examples/slab_balls", {"elastomer.thickness_mm": 2.0})
    alone = press(experiment.specimen, experiment.elastomer, experiment.press)
    assert thin.pressed.face_z_mm.max() == pytest.approx(alone.face_z_mm.max(), abs=2e-3)
    assert thin.pressed.face_z_mm.max() != pytest.approx(first.pressed.face_z_mm.max(), abs=2e-3)


def test_a_press_that_is_refused_says_so(preview):
    with pytest.raises(InputError, match="thickness_mm"):
        preview.show({"elastomer.thickness_mm": -1.0})


def test_controls_stay_within_their_sources():
    experiment = load_experiment("examples/slab_balls")
    controls = {slider.key: slider for slider in slider_ranges(experiment)}
    assert {"camera.pose.polar_deg", "elastomer.thickness_mm", "specimen.yaw_deg"} <= set(controls)
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


def test_a_thinned_coat_keeps_its_outline():
    experiment = load_experiment("examples/slab_balls")
    whole = press(experiment.specimen, experiment.elastomer, experiment.press)
    few = thinned(whole)
    assert max(few.face_z_mm.shape) < 500
    assert few.face_x_mm[0] == whole.face_x_mm[0]
    row, col = np.abs(whole.face_y_mm - few.face_y_mm[5]).argmin(), 0
    assert few.face_z_mm[5, 0] == whole.face_z_mm[row, col]


def test_surfaces_are_the_coat_and_the_specimen_under_it():
    """Why: the foremost point of the specimen touches the elastomer, a thickness below the coat."""
    experiment = load_experiment("examples/slab_balls")
    pressed = thinned(press(experiment.specimen, experiment.elastomer, experiment.press))
    blank = np.zeros((2, 2), np.uint8)
    coat, specimen = PreviewPicture(experiment, blank, blank, pressed).surfaces
    assert coat.vertices_mm[:, 2].max() == pytest.approx(pressed.face_z_mm.max())
    assert coat.rgb.shape == coat.vertices_mm.shape
    front_mm = pressed.depth_mm + experiment.elastomer.touched_plane_mm
    assert specimen.vertices_mm[:, 2].max() == pytest.approx(front_mm, abs=0.01)


@pytest.mark.parametrize("modality", ["direct_fpp", "photometric_stereo"])
def test_other_methods_are_refused(modality):
    name = "paper/nut" if modality == "direct_fpp" else "examples/gelsight_ball"
    experiment = load_experiment(name, {"modality": modality})
    with pytest.raises(InputError, match="contact_fpp"):
        Preview(experiment)


def test_without_viser_one_line_says_what_to_install(capsys, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "viser", None)
    assert run(["view", "examples/slab_balls"]) == 2
    said = capsys.readouterr().err
    assert "pip install -e" in said
    assert "[view]" in said
