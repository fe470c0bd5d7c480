"""The live view on its server, without a browser: scene graph, sliders, figures."""

from collections.abc import Iterator

import numpy as np
import pytest

from twin.config import load_experiment

pytest.importorskip("viser", reason="the extra `view` is not installed")

from twin.viewer.live import LiveView


@pytest.fixture(scope="module")
def view(mi) -> Iterator[LiveView]:
    shown = LiveView(load_experiment("examples/slab_balls"), None, "127.0.0.1", 18090)
    shown.update()
    shown.measure()
    yield shown
    shown.close()


def test_object_devices_and_section_are_in_the_scene(view):
    names = (
        "/surfaces/coat", "/surfaces/specimen", "/section/coat", "/section_line", "/near/camera",
        "/near/projector", "/near/camera label", "/near/projector field", "/rig/camera",
        "/rig/projector", "/rig/camera's rays",
    )  # fmt: skip
    assert [name for name in names if view.server.scene.get_handle_by_name(name) is None] == []


def test_it_opens_on_the_object_with_devices(view):
    scene = view.server.scene
    visible = {name: scene.get_handle_by_name(f"/{name}").visible for name in ("near", "rig")}
    assert visible == {"near": True, "rig": False}
    assert np.linalg.norm(view.server.initial_camera.position) < 50


def test_the_view_of_the_rig_shows_the_true_places(view):
    scene = view.server.scene
    view._picture.show("rig")
    try:
        assert not scene.get_handle_by_name("/near").visible
        camera = scene.get_handle_by_name("/rig/camera")
        assert np.linalg.norm(camera.position) == pytest.approx(214.0, abs=0.01)
    finally:
        view._picture.show("object")


def test_figures_and_error_map_are_those_of_the_measurement(view):
    assert "apparent in the coat" in view._results._figures.content
    assert "z error against the true coat" in view._results._figures.content
    colours = view._results._errors.image.reshape(-1, 3)
    assert len(np.unique(colours, axis=0)) > 50


def test_a_slider_changes_picture_command_and_figures(view):
    before, figures = view._results._fringes.image, view._results._figures.content
    _, moved = view._sliders["elastomer.thickness_mm"]
    moved.value = 2.5
    view.update()
    assert (view._results._fringes.image != before).mean() > 0.05
    assert "-s elastomer.thickness_mm=2.5" in view._command.content
    assert view.measure()
    assert view._results._figures.content != figures


def test_a_slider_moved_during_the_measurement_ends_it(view):
    view._moved.set()
    assert not view.measure()
    view._moved.clear()


def test_a_value_that_is_not_possible_is_reported(view):
    view._changes["elastomer.thickness_mm"] = -1.0
    view.update()
    assert "not possible" in view._status.content
    del view._changes["elastomer.thickness_mm"]
