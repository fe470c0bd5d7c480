"""Calibrations as fields of a rig: those of rigs are reproduced, others have a misfit."""

from dataclasses import replace

import numpy as np
import pytest

from reconstruction.errors import InputError
from reconstruction.rig.calibration import Calibration
from twin.adoption.poses import place
from twin.config import load_experiment
from twin.optics.rig import true_calibration


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"camera.pose.polar_deg": 12.0, "camera.pose.azimuth_deg": -70.0},
        {"projector.pose.roll_deg": 25.0, "camera.pose.roll_deg": -8.0},
        {"camera.distortion": [-0.08, 0.1, 0.001, 0.0, 0.0], "projector.offset_percent": 40.0},
    ],
    ids=["paper", "tilted", "rolled", "distorted"],
)
def test_a_rig_is_reproduced(changes):
    """Expected: every number of both poses to 1e-6, and a misfit below 1e-4 px."""
    experiment = load_experiment("examples/slab_ball", {"camera.binning": 4, **changes})
    placed = place(true_calibration(experiment))
    assert max(placed.misfit_px) < 1e-4
    assert placed.is_close
    for pose, device in (
        (placed.camera_pose, experiment.camera),
        (placed.projector_pose, experiment.projector),
    ):
        assert pose.standoff_mm == pytest.approx(device.pose.standoff_mm, rel=1e-6)
        assert pose.polar_deg == pytest.approx(device.pose.polar_deg, abs=1e-4)
    assert placed.projector_focal_px == pytest.approx(1.2 * 1280, rel=1e-6)
    np.testing.assert_allclose(placed.origin_mm, 0.0, atol=1e-5)


def test_a_moved_origin_is_the_same_rig():
    """The world frame moved by (3, -2) mm in its plane: the rig is the same."""
    experiment = load_experiment("examples/slab_ball", {"camera.binning": 4})
    true = true_calibration(experiment)
    shift = np.eye(4)
    shift[:2, 3] = 3.0, -2.0
    moved = Calibration(
        true.camera, true.projector, shift @ true.T_world_from_cam, shift @ true.T_world_from_proj
    )
    placed = place(moved)
    np.testing.assert_allclose(placed.origin_mm, (3.0, -2.0, 0.0), atol=1e-5)
    assert placed.camera_pose.standoff_mm == pytest.approx(experiment.camera.pose.standoff_mm)


def test_properties_outside_the_rig_model_are_misfit():
    """A projector with an axis 40 px aside has another aim: a misfit of some px is reported."""
    true = true_calibration(load_experiment("examples/slab_ball", {"camera.binning": 4}))
    aside = replace(true, projector=replace(true.projector, fy_px=1.02 * true.projector.fx_px))
    placed = place(aside)
    assert placed.misfit_px[1] > 0.5
    assert not placed.is_close


DIAMOND = {
    "projector.width_px": 912,
    "projector.height_px": 1140,
    "projector.pixel_ratio": "diamond",
}


@pytest.mark.parametrize("ratio", ["diamond", 0.5])
def test_a_rig_with_oblong_pixels_is_reproduced(ratio):
    """Expected: pose and focal length in columns, as of square pixels, and a misfit below 1e-4."""
    changes = DIAMOND | {"projector.pixel_ratio": ratio, "projector.pose.roll_deg": 25.0}
    experiment = load_experiment("examples/slab_ball", {"camera.binning": 4, **changes})
    placed = place(true_calibration(experiment), ratio)
    assert max(placed.misfit_px) < 1e-4
    assert placed.projector_focal_px == pytest.approx(1.2 * 912, rel=1e-6)
    pose = experiment.projector.pose
    assert placed.projector_pose.standoff_mm == pytest.approx(pose.standoff_mm, rel=1e-6)
    assert placed.projector_pose.roll_deg == pytest.approx(25.0, abs=1e-4)


def test_another_ratio_than_stated_is_refused():
    """Setup: a diamond chip, with columns counted at half their number, stated as square."""
    true = true_calibration(load_experiment("examples/slab_ball", {"camera.binning": 4}))
    p = true.projector
    halved = replace(p, width_px=p.width_px // 2, fx_px=p.fx_px / 2, cx_px=(p.cx_px - 0.5) / 2)
    message = r"projector's pixels are 2 times as wide .* allowed 1 within 3%; set \[projector\]"
    with pytest.raises(InputError, match=message):
        place(replace(true, projector=halved))


def test_a_camera_that_looks_up_is_refused():
    true = true_calibration(load_experiment("examples/slab_ball", {"camera.binning": 4}))
    turned = np.diag([1.0, -1.0, -1.0, 1.0])
    with pytest.raises(InputError, match="look down"):
        place(
            Calibration(
                true.camera,
                true.projector,
                turned @ true.T_world_from_cam,
                turned @ true.T_world_from_proj,
            )
        )
