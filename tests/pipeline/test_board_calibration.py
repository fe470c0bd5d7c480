"""A calibration on a board in one line, in pictures and as labelled arrays."""

import numpy as np
import pytest

import twin
from reconstruction.calibration import calibrate
from reconstruction.errors import InputError
from reconstruction.rig.calibration import Calibration
from tests.reconstruction.conftest import looking_at
from tests.reconstruction.test_calibrate_adjust import (
    CAMERA,
    PROJECTOR,
    aim_projector,
    board_poses,
    observations,
)
from twin.pipeline.board_calibration import BoardCalibration


@pytest.fixture(scope="module")
def done():
    """Eight poses of a dot board with 0.02 px of noise in the camera, 0.05 px in the projector."""
    above = looking_at([0.0, 0.0, 214.0], [0.0, 0.0, 0.0])
    rig = Calibration(CAMERA, PROJECTOR, above, aim_projector(looking_at))
    poses = observations(rig, board_poses(), (0.02, 0.05))
    return BoardCalibration(calibrate(poses), tuple(poses), "0")


def test_one_line(done):
    text = repr(done)
    assert text.startswith("<BoardCalibration: 8 poses, features ")
    camera, projector = (float(part.split()[-3]) for part in text[:-1].split(", ")[-2:])
    assert camera == pytest.approx(0.02, rel=0.15)
    assert projector == pytest.approx(0.05, rel=0.15)


def test_features_as_labelled_arrays(done):
    data = done.to_xarray()
    assert data["residual_camera_x_px"].dims == ("feature",)
    assert data["residual_camera_x_px"].attrs["units"] == "px"
    assert data.sizes["feature"] == sum(len(pose.ids) for pose in done.observations)
    assert set(data["pose"].values) == {pose.name for pose in done.observations}
    assert np.std(data["residual_camera_x_px"]) == pytest.approx(0.02, rel=0.15)


def test_the_figure_has_both_devices_in_px(done):
    drawing = done.plot()
    shown = [(axes.get_title(), axes.get_xlabel()) for axes in drawing.axes]
    assert shown == [
        ("camera residuals", "camera_x_px"),
        ("projector residuals", "projector_column_px"),
        ("RMS residuals", "pose"),
    ]
    assert len(drawing.axes[2].lines[0].get_xdata()) == 8
    assert "data:image/png;base64," in done._repr_html_()


def test_a_wrong_source_is_one_line():
    with pytest.raises(InputError, match="source is 3, of type int; give an experiment"):
        twin.calibrate(3)
