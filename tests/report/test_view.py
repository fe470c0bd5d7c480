"""The view that a reader turns: its rays, its data, and that a drag turns it in a browser."""

import base64
import json
import re
from collections.abc import Iterator

import numpy as np
import pytest

from reconstruction.rig.layers import PlaneLayers
from tests.browser import Browser, browser
from twin.report.measurement import write_report
from twin.report.scene import DEVIATION, HEIGHTS, SPECIMEN, measured_scene, ray_path
from twin.report.view import view_data
from twin.results.folder import read_measurement

CANVAS = "document.querySelector('.view3d canvas')"


@pytest.fixture(scope="module")
def page(finished, tmp_path_factory):
    into = tmp_path_factory.mktemp("view")
    return write_report(finished, into=into)


@pytest.fixture(scope="module")
def data(finished):
    return view_data(measured_scene(read_measurement(finished)))


@pytest.fixture(scope="module")
def tab(tmp_path_factory) -> Iterator[Browser]:
    with browser(tmp_path_factory.mktemp("profile")) as started:
        yield started


def heights(grid) -> np.ndarray:
    values = np.frombuffer(base64.b64decode(grid["z"]), "<f4")
    return values.reshape(grid["ny"], grid["nx"])


def test_light_takes_the_way_that_snell_says():
    """n sin(theta) is the same in all media, and the way ends where it should."""
    layers = PlaneLayers((7.0, 4.0), (1.52, 1.41))
    start, end = np.array([30.0, -40.0, 200.0]), np.array([-3.0, 2.0, 0.0])
    path = ray_path(start, end, layers)
    np.testing.assert_allclose(path[[0, -1]], [start, end], atol=1e-9)
    np.testing.assert_allclose(path[1:3, 2], layers.tops_mm)
    steps = np.diff(path, axis=0)
    sines = np.hypot(steps[:, 0], steps[:, 1]) / np.linalg.norm(steps, axis=1)
    np.testing.assert_allclose(np.array([1.0, 1.52, 1.41]) * sines, sines[0], rtol=1e-9)


def test_light_in_air_goes_straight():
    start, end = np.array([10.0, 0.0, 100.0]), np.array([0.0, 0.0, 5.0])
    for layers in (None, PlaneLayers((4.0,), (1.4,))):
        np.testing.assert_array_equal(ray_path(start, end, layers), [start, end])


def test_data_are_the_measured_surface(data, finished):
    measured = read_measurement(finished)
    grids = {grid["name"]: grid for grid in data["grids"]}
    assert set(grids) == {HEIGHTS, DEVIATION, SPECIMEN}
    z_mm = heights(grids[HEIGHTS])
    measured_mm = measured.points.world_mm[measured.points.valid][:, 2]
    assert np.nanmax(z_mm) == pytest.approx(measured_mm.max(), abs=5e-3)
    assert np.nanmean(z_mm) == pytest.approx(measured_mm.mean(), abs=5e-3)
    # The specimen's foremost point has travelled so far from the touched face.
    front = measured.press.depth_mm + measured.experiment.elastomer.touched_plane_mm
    assert np.nanmax(heights(grids[SPECIMEN])) == pytest.approx(front, abs=0.01)
    assert {line["name"] for line in data["lines"]} == {
        "camera's rays",
        "projector's rays",
        "elastomer",
    }


def test_the_page_holds_the_data(page, data):
    text = page.read_text(encoding="utf-8")
    (held,) = re.findall(r'<script type="application/json">(.*?)</script>', text, re.DOTALL)
    assert json.loads(held) == json.loads(json.dumps(data))
    assert len(held) < 600_000


def middle(tab: Browser) -> tuple[float, float]:
    box = f"(b => [b.x + b.width / 2, b.y + b.height / 2])({CANVAS}.getBoundingClientRect())"
    x, y = tab.evaluate(box)
    return x, y


@pytest.mark.parametrize("width", [1280, 390])
def test_a_drag_turns_it(page, tab, width):
    """In a browser: no error, nothing loaded, and the picture changes, and back by a button."""
    tab.open(page.as_uri(), width)
    if not tab.evaluate("!!document.createElement('canvas').getContext('webgl2')"):
        pytest.skip("no WebGL here")
    tab.evaluate(f"{CANVAS}.scrollIntoView({{block: 'center'}})")
    drawn = f"{CANVAS}.toDataURL()"
    before = tab.evaluate(drawn)
    x, y = middle(tab)
    tab.drag((x, y), (x + 80, y - 40))
    turned = tab.evaluate(drawn)
    assert turned != before
    tab.evaluate("document.querySelector('.view3d button[value=rig]').click()")
    assert tab.evaluate(drawn) not in (before, turned)
    tab.evaluate("document.querySelector('.view3d button[value=relief]').click()")
    assert tab.evaluate(drawn) == before
    assert tab.activity.errors == []
    assert [one for one in tab.activity.requests if not one.startswith(("file:", "data:"))] == []
    assert tab.overflow() == []


def test_parts_are_shown_and_hidden(page, tab):
    tab.open(page.as_uri())
    if not tab.evaluate("!!document.createElement('canvas').getContext('webgl2')"):
        pytest.skip("no WebGL here")
    drawn = f"{CANVAS}.toDataURL()"
    before = tab.evaluate(drawn)
    box = "document.querySelector('.view3d input[value=specimen]')"
    assert tab.evaluate(f"{box}.checked") is False
    tab.evaluate(f"{box}.click()")
    assert tab.evaluate(drawn) != before
