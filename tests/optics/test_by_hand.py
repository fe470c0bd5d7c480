"""Optical figures computed by hand: angles of view, pupils, light per pixel, a board's plate."""

from types import SimpleNamespace

import numpy as np
import pytest

from twin.config import load_experiment
from twin.optics.board import _corners_world_mm, albedo_image, camera_texel_mm
from twin.optics.direct import solids
from twin.optics.light import response
from twin.optics.rig import (
    ThinLens,
    camera_pinhole,
    field_of_view_deg,
    irradiance_at_1mm,
    projector_pinhole,
    true_calibration,
)


def known(value):
    return {"value": value, "range": [0.0, 1e4], "source": "test"}


@pytest.fixture(scope="module")
def experiment():
    """50 mm at 250 mm: the image is 62.5 mm behind the lens, with magnification 0.25."""
    return load_experiment(
        "examples/slab_balls",
        {
            "camera.focal_length_mm": known(50.0), "camera.pose.standoff_mm": known(250.0),
            "camera.pixel_pitch_um": known(5.0), "camera.binning": 2, "camera.width_px": 400,
            "camera.height_px": 300, "camera.f_number": known(4.0),
            "camera.depth_of_field": True,
        },
    )  # fmt: skip


def test_a_camera_focused_near(experiment):
    """Pixels of 10 um 62.5 mm behind the lens: 6250 px; 200 x 150 of them, centre (99.5, 74.5)."""
    pinhole = camera_pinhole(experiment.camera)
    assert (pinhole.width_px, pinhole.height_px) == (200, 150)
    assert (pinhole.fx_px, pinhole.fy_px) == pytest.approx((6250.0, 6250.0))
    assert (pinhole.cx_px, pinhole.cy_px) == (99.5, 74.5)


def test_a_pupil_and_its_focus(experiment):
    """50 mm at f/4: a pupil of 12.5 mm, radius 6.25; in focus on the plane through the origin."""
    pose = true_calibration(experiment).T_world_from_cam
    lens = ThinLens.of(experiment.camera, pose)
    assert (lens.radius_mm, lens.focus_mm) == pytest.approx((6.25, 250.0))
    tilted = np.diag([1.0, 1.0, 1.0, 1.0])
    tilted[:3, 3] = 30.0, 0.0, -40.0
    assert ThinLens.of(experiment.camera, tilted).focus_mm == pytest.approx(40.0)


def test_a_field_of_view():
    """As wide as twice its distance: 90 degrees; 2 tan 30 = 1.1547 distances: 60 degrees."""
    assert field_of_view_deg(200.0, 100.0) == pytest.approx(90.0)
    assert field_of_view_deg(115.470054, 100.0) == pytest.approx(60.0)


def test_a_projectors_light(experiment):
    """Throw ratio 2 at 16:10, 100 mW: at 1 mm the image is 0.5 x 0.3125 mm, 640 mW / mm^2.

    100 % offset: the axis is on the last row's lower edge, 50 % half-way down to it.
    """
    shape = {"width_px": 160, "height_px": 100, "throw_ratio": 2.0, "flux_mw": 100.0}
    for offset_percent, row_px in ((100.0, 99.5), (50.0, 74.5), (0.0, 49.5)):
        projector = experiment.projector.model_copy(
            update=shape | {"offset_percent": offset_percent}
        )
        pinhole = projector_pinhole(projector)
        assert (pinhole.cx_px, pinhole.cy_px) == (79.5, row_px)
        assert irradiance_at_1mm(projector, pinhole) == pytest.approx(640.0)


def test_light_of_8_bit_levels(experiment):
    """Contrast 100: black 0.01, level 51 of 255 is 0.2 of the rest, 0.208, or squared 0.0496."""
    projector = experiment.projector.model_copy(update={"contrast": 100.0})
    levels = np.array([0, 51, 255], np.uint8)
    np.testing.assert_allclose(response(levels, projector), [0.01, 0.208, 1.0])
    squared = projector.model_copy(update={"gamma": 2.0})
    np.testing.assert_allclose(response(levels, squared), [0.01, 0.0496, 1.0])


def test_a_board_has_two_texels_a_pixel(experiment):
    """A pixel of 10 um is 40 um on the plane: texels of 20 um."""
    assert camera_texel_mm(experiment) == pytest.approx(0.02)


def test_corners_of_a_plate():
    """8 x 6 mm, moved by (1, 2, 3), rotated by 90 degrees: the lower left corner is then right."""
    T = np.eye(4)
    T[:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    T[:3, 3] = 1.0, 2.0, 3.0
    corners = _corners_world_mm(SimpleNamespace(width_mm=8.0, height_mm=6.0), T)
    assert corners.tolist() == [[4, -2, 3], [4, 6, 3], [-2, 6, 3], [-2, -2, 3]]


def test_ink_on_white_print():
    """Half ink: the mean of 0.8 and 0.1; the plate holds whole texels."""
    plate = SimpleNamespace(width_mm=1.0, height_mm=0.5, white_albedo=0.8, ink_albedo=0.1)
    board = SimpleNamespace(ink=lambda x, y, _: 0.5 * (x > 0) + 0.5 * (y[:, None] > 0.1))
    albedo = albedo_image(board, plate, 0.26)
    assert albedo.shape == (2, 4)
    np.testing.assert_allclose(albedo, [[0.45, 0.45, 0.1, 0.1], [0.8, 0.8, 0.45, 0.45]], rtol=1e-6)


def test_the_stage_lies_just_below_the_specimen():
    """A gap of 20 um separates the two surfaces."""
    stage, *parts = solids(load_experiment("paper/ball", {"modality": "direct_fpp"}))
    lowest = min(part.mesh.bounds[0, 2] for part in parts)
    np.testing.assert_allclose(stage.mesh.bounds[:, 2], lowest - 0.02)


def test_places_of_sub_pixels(mi):
    """3 x 2 pixels of 2 x 2 samples: from the upper left, a quarter of a pixel off the centres."""
    from twin.optics.devices import SubPixels

    grid = SubPixels.of_image(3, 2, 4)
    assert grid.samples == 4
    offsets = [(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)]
    for sample, (dx, dy) in enumerate(offsets):
        x, y = (np.array(axis) for axis in grid.position(mi.UInt32(sample)))
        np.testing.assert_allclose(x, np.array([0, 1, 2, 0, 1, 2]) + dx)
        np.testing.assert_allclose(y, np.array([0, 0, 0, 1, 1, 1]) + dy)
    assert [SubPixels.of_image(1, 1, n).side for n in (1, 9, 64, 256)] == [1, 3, 8, 16]
