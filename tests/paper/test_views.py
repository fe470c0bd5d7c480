"""Pictures for people: geometry of the view_camera, light, holes, and what the views show."""

import numpy as np
import pytest
import trimesh
from PIL import Image

from twin.config import load_experiment
from twin.optics.rig import true_calibration
from twin.pipeline.press import press_specimen

COARSE = {"press.cell_mm": 0.4, "press.relief_pitch_mm": 0.05}


@pytest.fixture(scope="module")
def experiment():
    return load_experiment("paper/two_balls", COARSE)


@pytest.fixture(scope="module")
def pressed(experiment):
    return press_specimen(experiment)


def view_camera(width_mm=10.0, size=(64, 48), eye=(0.0, -40.0, 40.0)):
    from twin.optics.view import SceneView

    return SceneView(eye, (0.0, 0.0, 0.0), width_mm, *size)


def bounds(surface):
    return np.stack([surface.vertices_mm.min(axis=0), surface.vertices_mm.max(axis=0)])


def test_view_camera_sees_the_target_in_the_middle_and_z_upright(mi):
    camera = view_camera()
    at = camera.project([(0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)])
    np.testing.assert_allclose(at[0], (31.5, 23.5), atol=1e-9)
    assert at[1, 1] < at[0, 1]
    assert at[1, 0] == pytest.approx(at[0, 0])
    assert at[2, 0] - at[0, 0] == pytest.approx(6.4)  # 64 px show 10 mm


def test_view_straight_down_has_world_y_at_the_top(mi):
    camera = view_camera(eye=(0.0, 0.0, 50.0))
    at = camera.project([(0.0, 1.0, 0.0), (1.0, 0.0, 0.0)])
    assert at[0, 1] < 23.5
    assert at[1, 0] > 31.5


def test_pictures_are_white_where_nothing_is_and_repeat_byte_for_byte(mi):
    from twin.optics.picture import picture
    from twin.optics.view import SceneSurface

    mesh = trimesh.creation.icosphere(radius=2.0)
    ball = SceneSurface.of_mesh("ball", mesh, (0.6, 0.1, 0.1), smooth=True)
    first, again = (picture([ball], view_camera(), samples=4) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert (first[0] == 255).all()
    assert (first[:, 0] == 255).all()
    red, green, blue = first[24, 32].astype(int)
    assert red > green + 60
    assert abs(green - blue) < 10


def test_a_photograph_is_gray_and_taken_once_per_specimen(mi, monkeypatch):
    """Setup: one ball under two presses. Expected: one picture, of a bright ball on the stage."""
    from twin.paper import photographs

    monkeypatch.setattr(photographs, "_SAMPLES", 2)
    monkeypatch.setattr(photographs, "_WIDTH_PX", 64)
    monkeypatch.setattr(photographs, "_HEIGHT_PX", 48)
    photographs._render.cache_clear()
    ball = load_experiment("paper/ball")
    deeper = load_experiment("paper/ball", {"press.depth_mm": 1.0})
    first = photographs.photograph_of(ball)
    assert photographs.photograph_of(deeper) is first
    np.testing.assert_array_equal(first[..., 0], first[..., 2])
    assert first[24, 32].mean() > 40
    photographs._render.cache_clear()


def test_fringes_on_the_coat_have_the_projectors_period(experiment, mi):
    """Setup: points whose projector columns are a period apart. Expected: the same shade."""
    from twin.paper.rig_scene import fringe_shade

    rig = true_calibration(experiment)
    columns = 640.0 + experiment.patterns.period_px * np.arange(4)
    slopes = rig.projector.unproject(np.column_stack([columns, np.full(4, 360.0)]))
    rays = np.column_stack([slopes, np.ones(4)]) @ rig.T_world_from_proj[:3, :3].T
    start = rig.T_world_from_proj[:3, 3]
    points = start - (start[2] / rays[:, 2])[:, None] * rays
    np.testing.assert_allclose(np.diff(fringe_shade(experiment, points)), 0.0, atol=1e-9)


def test_a_cut_sheet_ends_at_the_cut_and_is_closed(experiment, pressed, mi):
    from twin.paper.rig_scene import sheet_things

    silicone, coat = sheet_things(experiment, pressed, cut_y_mm=0.0)
    assert trimesh.Trimesh(silicone.vertices_mm, silicone.triangles).is_watertight
    low, high = bounds(silicone)
    # The clear face lies a local thickness behind the coat, along a normal that leans at the cut.
    assert -experiment.elastomer.thickness_mm < low[1] <= 0.06
    assert bounds(coat)[0, 1] == pytest.approx(0.0, abs=0.06)
    half = experiment.elastomer.length_y_mm / 2
    # A sheet leans at its simple support, where its faces are half a thickness off its middle; the
    # air bulges it a little beyond.
    assert half <= high[1] <= half + experiment.elastomer.thickness_mm
    remaining_mm = pressed.face_z_mm[pressed.face_y_mm >= 0.0]
    assert bounds(coat)[1, 2] == pytest.approx(remaining_mm.max() + 0.04, abs=0.01)


def test_the_specimen_is_where_the_press_put_it(experiment, pressed, mi):
    from twin.paper.rig_scene import specimen_things

    balls = specimen_things(experiment, pressed)[0]
    top = experiment.elastomer.touched_plane_mm + pressed.depth_mm
    assert bounds(balls)[1, 2] == pytest.approx(top, abs=0.03)


@pytest.fixture
def coarse_views(mi, monkeypatch):
    """One path per pixel of small pictures."""
    from twin.paper import rig_figures

    monkeypatch.setattr(rig_figures, "_SAMPLES", 1)
    for view in ("_RIG", "_SHEET", "_CUT"):
        full = getattr(rig_figures, view)
        small = type(full)(full.eye_mm, full.target_mm, full.width_mm, 104, 80)
        monkeypatch.setattr(rig_figures, view, small)
    return rig_figures


@pytest.mark.parametrize("name", ["concept", "setup"])
def test_views_are_drawn(coarse_views, name, experiment, pressed, tmp_path):
    """Small and noisy here: what they show is looked at by eye, that they draw is tested."""
    getattr(coarse_views, f"draw_{name}")(tmp_path / name, experiment, pressed)
    assert (tmp_path / f"{name}.pdf").read_bytes().startswith(b"%PDF")
    shown = np.asarray(Image.open(tmp_path / f"{name}.png").convert("L"))
    assert shown.shape[1] == round(7.16 * 200)
    assert shown.std() > 20
