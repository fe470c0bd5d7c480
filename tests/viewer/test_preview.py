"""A preview shows the changed values at once, and then measures them."""

import numpy as np
import pytest

from reconstruction.errors import InputError
from twin.cli import run
from twin.config import load_experiment, vary
from twin.mechanics import press
from twin.pipeline import measure
from twin.viewer.preview import Preview, thinned


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


def test_an_exposure_is_that_of_the_full_image(preview, first):
    """Why: a pixel of the preview covers several binned pixels, so that it is exposed less."""
    half = preview.show({"camera.exposure_ms": first.exposure_ms / 2})
    assert half.exposure_ms == pytest.approx(first.exposure_ms / 2)
    assert half.white.mean() == pytest.approx(first.white.mean() / 2, rel=0.03)


def test_row_fringes_are_shown_if_there_are_no_others(mi, first):
    rows = Preview(load_experiment("examples/slab_balls", {"patterns.axes": ["row"]})).show({})
    middle = rows.fringes[:, rows.fringes.shape[1] // 2].astype(float)
    assert np.ptp(middle) > 100
    assert not np.array_equal(rows.fringes, first.fringes)


def test_the_measurement_is_that_of_twin_measure_with_binned_pixels(preview):
    changes = {"coating.base_albedo": 0.3}
    done = preview.measure(changes)
    alone = measure(load_experiment("examples/slab_balls", {**changes, "camera.binning": 4}))
    assert done.metrics == alone.metrics
    exposure_ms = preview.show(changes).exposure_ms
    assert exposure_ms == pytest.approx(alone.figures["exposure_ms"], rel=0.05)
    np.testing.assert_array_equal(
        preview.show(changes).pressed.face_z_mm, thinned(alone.press).face_z_mm
    )


def test_a_measurement_ends_where_its_progress_callback_raises(preview):
    def moved(stage: str, fraction: float, /) -> None:
        if stage == "render":
            raise KeyError(stage)

    with pytest.raises(KeyError, match="render"):
        preview.measure({"specimen.x_mm": 0.5}, moved)
    assert preview.show({"specimen.x_mm": 0.5}).fringes.max() > 150


@pytest.fixture(scope="module")
def sheet(mi) -> Preview:
    shown = Preview(load_experiment("examples/wrapped_balls"))
    shown.show({})
    shown.show({"press.depth_mm": 1.01})  # compiles
    return shown


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("elastomer.thickness_mm", 0.22),
        ("elastomer.shore_a", 11.0),
        ("press.back_pressure_kpa", 2.5),
        ("press.depth_mm", 1.1),
    ],
)
def test_a_slider_updates_a_thin_sheet_in_few_steps(sheet, key, value):
    """From the mounted sheet it takes 36 steps and more; `bench view` measures the time."""
    before, steps = sheet.show({}).pressed, sheet._sheet.sheet.state.steps
    after, state = sheet.show({key: value}).pressed, sheet._sheet.sheet.state
    assert state.steps - steps <= 12
    assert len(state.control_mm.reshape(-1, 3)) < 5000
    assert np.abs(after.face_z_mm - before.face_z_mm).max() > 2e-3


def test_a_coarse_sheet_does_not_depend_on_the_values_shown_before(mi, sheet):
    sheet.show({"press.depth_mm": 1.3})
    here = sheet.show({"elastomer.thickness_mm": 0.3}).pressed.face_z_mm
    wrapped = vary(load_experiment("examples/wrapped_balls"), {"elastomer.thickness_mm": 0.3})
    np.testing.assert_allclose(here, Preview(wrapped).show({}).pressed.face_z_mm, atol=2e-3)


def test_a_press_that_is_refused_says_so(preview):
    with pytest.raises(InputError, match="thickness_mm"):
        preview.show({"elastomer.thickness_mm": -1.0})


def test_a_thinned_coat_keeps_its_outline():
    experiment = load_experiment("examples/slab_balls")
    whole = press(experiment.specimen, experiment.elastomer, experiment.press)
    few = thinned(whole)
    assert max(few.face_z_mm.shape) < 500
    assert few.face_x_mm[0] == whole.face_x_mm[0]
    row, col = np.abs(whole.face_y_mm - few.face_y_mm[5]).argmin(), 0
    assert few.face_z_mm[5, 0] == whole.face_z_mm[row, col]


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
