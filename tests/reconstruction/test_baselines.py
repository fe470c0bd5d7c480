"""Classical methods on data sets that are written by hand, against closed forms."""

import json
from dataclasses import replace

import numpy as np
import pytest

from reconstruction.errors import InputError
from reconstruction.evaluate.baselines import (
    LEAST_MODULATION,
    absolute_phase,
    depth_of_phase,
    phase_of_frame,
    score_baseline,
)
from reconstruction.evaluate.samples import LabelledSample
from tests.reconstruction.test_predictions import COLS, SHAPE, TURN, truth, write_dataset


def with_decoded(masked: np.ndarray, jump_rad: float = 0.0) -> dict[str, np.ndarray]:
    """Decoded maps of a surface whose phase jumps between two columns."""
    arrays = truth()
    arrays["phase_column_rad"] = arrays["phase_column_rad"] + np.where(COLS >= 10, jump_rad, 0.0)
    arrays["decoded_phase_column_rad"] = arrays["phase_column_rad"] + 0.01
    wrapped = np.mod(arrays["phase_column_rad"], TURN)
    arrays["decoded_wrapped_phase_column_rad"] = wrapped.astype(np.float32)
    arrays["decoded_modulation_column_dn"] = np.full(SHAPE, 100.0, np.float32)
    arrays["decoded_reason"] = masked.astype(np.uint8)
    return arrays


def test_the_decoder_as_baseline(tmp_path) -> None:
    arrays = with_decoded(masked=COLS >= 13)
    folder = write_dataset(tmp_path / "set", {"0": ("a", arrays)})
    figures = score_baseline("decoded", folder).figures()
    assert figures["phase_column_completeness"] == pytest.approx(0.75)
    assert figures["phase_column_bias_rad"] == pytest.approx(0.01, rel=1e-3)
    assert "depth_rms_um" not in figures


def test_spatial_unwrapping_of_a_plane_is_exact_and_stops_at_a_jump(tmp_path) -> None:
    """Expected: beyond a jump of 0.4 turns the pixels are another island, without prediction.

    The larger island is that left of the jump, 10 columns, of which 6 show the measured surface.
    """
    smooth = with_decoded(masked=COLS < 0)
    jumping = with_decoded(masked=COLS < 0, jump_rad=0.4 * TURN)
    one = write_dataset(tmp_path / "one", {"0": ("a", smooth)})
    two = write_dataset(tmp_path / "two", {"0": ("a", jumping)})
    figures = score_baseline("spatial_unwrapping", one).figures()
    assert figures["phase_column_completeness"] == 1.0
    assert figures["phase_column_rms_rad"] < 1e-5
    assert figures["phase_column_wrong_order_share"] == 0.0
    figures = score_baseline("spatial_unwrapping", two).figures()
    assert figures["phase_column_completeness"] == pytest.approx(0.5)
    assert figures["phase_column_rms_rad"] < 1e-5


def test_only_one_pixel_of_the_true_phase_is_used() -> None:
    """Expected: a wrong truth anywhere else changes nothing; little modulation is left out."""
    phase = 0.4 * COLS + 3.0
    modulation = np.where(COLS == 15, 0.99 * LEAST_MODULATION, 1.0)
    rng = np.random.default_rng(1)
    predicted = absolute_phase(np.mod(phase, TURN), modulation, phase)
    np.testing.assert_allclose(predicted[:, :15], phase[:, :15], atol=1e-12)
    assert np.isnan(predicted[:, 15]).all()
    changed = 0
    for row, col in rng.integers((0, 0), SHAPE, (40, 2)):
        other = phase.copy()
        other[row, col] += TURN
        result = absolute_phase(np.mod(phase, TURN), modulation, other)
        changed += not np.array_equal(result, predicted, equal_nan=True)
    assert changed <= 2  # the pixel in the middle may be drawn
    unlit = absolute_phase(np.mod(phase, TURN), modulation, np.zeros(SHAPE))
    assert np.isnan(unlit).all()


def test_the_phase_of_one_frame_is_that_of_its_fringes() -> None:
    """Expected: a bent carrier is within the window; a border of three periods is left out."""
    rows, cols = np.indices((96, 160))
    phase = TURN * cols / 8.0 + 0.5 * np.sin(TURN * rows / 96.0)
    wrapped, modulation = phase_of_frame(120.0 + 80.0 * np.cos(phase))
    inside = np.s_[24:-24, 24:-24]
    error = np.angle(np.exp(1j * (wrapped - phase)))[inside]
    assert np.abs(error).max() < 0.02
    assert modulation[inside] == pytest.approx(80.0, rel=0.02)
    with pytest.raises(InputError, match="fringes in the image"):
        phase_of_frame(np.full((96, 160), 100.0))


def rig_sample(**changes) -> LabelledSample:
    """A camera above the world origin and a projector beside it, turned by 20 degrees."""

    def device(focal_px: float) -> dict:
        matrix = [[focal_px, 0.0, 7.5], [0.0, focal_px, 5.5], [0.0, 0.0, 1.0]]
        return {
            "image_width": 16,
            "image_height": 12,
            "camera_matrix": matrix,
            "distortion_coefficients": [0.0] * 5,
        }

    T_cam, T_proj = np.eye(4), np.eye(4)
    sine, cosine = np.sin(np.deg2rad(20.0)), np.cos(np.deg2rad(20.0))
    T_proj[:3, :3] = [[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]]
    T_proj[:3, 3] = 80.0, 5.0, 3.0
    calibration = {
        "periods_px": {"column": 4.0},
        "camera": device(200.0),
        "projector": device(150.0),
        "T_world_from_cam": T_cam.tolist(),
        "T_world_from_proj": T_proj.tolist(),
    }
    return LabelledSample("7", {}, {}, calibration | changes)


def test_the_depth_of_a_phase_is_that_of_the_point() -> None:
    """Expected: points on the camera's rays, projected into the projector, give their depth."""
    sample = rig_sample()
    rows, cols = np.indices(SHAPE)
    depth = 200.0 + 0.1 * cols + 0.05 * rows**2
    x, y = (cols - 7.5) / 200.0, (rows - 5.5) / 200.0
    points = depth[..., None] * np.stack([x, y, np.ones(SHAPE)], axis=-1)
    T_proj = np.array(sample.calibration["T_world_from_proj"])
    local = (points - T_proj[:3, 3]) @ T_proj[:3, :3]
    phase = TURN / 4.0 * (150.0 * local[..., 0] / local[..., 2] + 7.5)
    phase[0, 0] = np.nan
    result = depth_of_phase(phase, sample)
    assert np.isnan(result[0, 0])
    np.testing.assert_allclose(result.ravel()[1:], depth.ravel()[1:], rtol=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"periods_px": {"row": 4.0}}, "needs periods_px.column"),
        ({"layers": [{"top_mm": 1.0, "ior": 1.4}]}, "and no layers"),
    ],
)
def test_rigs_without_a_depth(changes: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        depth_of_phase(np.zeros(SHAPE), rig_sample(**changes))
    lens = json.loads(json.dumps(rig_sample().calibration))
    lens["projector"]["distortion_coefficients"][0] = 0.1
    with pytest.raises(InputError, match="projector lens with distortion"):
        depth_of_phase(np.zeros(SHAPE), replace(rig_sample(), calibration=lens))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("neural", "found 'neural', allowed: decoded, spatial_unwrapping, fourier"),
        ("decoded", "--baseline decoded needs depth_mm with decoded_depth_mm"),
        ("fourier", "--baseline fourier needs phase_column_rad with frames"),
    ],
)
def test_faults_of_baselines(tmp_path, name: str, message: str) -> None:
    folder = write_dataset(tmp_path / "set", {"0": ("a", truth())})
    with pytest.raises(InputError, match=message):
        score_baseline(name, folder)
