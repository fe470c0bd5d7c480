"""A specimen on a stage: known motion removed from the frames, and the table [stage]."""

from dataclasses import replace

import numpy as np
import pytest

from reconstruction.capture.folder import Capture, read_capture, read_uncalibrated, write_capture
from reconstruction.decoding.decode import DecodeOptions
from reconstruction.errors import CaptureError, InputError
from reconstruction.motion.positions import StageMotion
from reconstruction.motion.stage import hold_still
from reconstruction.patterns import PatternSet
from reconstruction.pipeline import ReconstructOptions, reconstruct
from reconstruction.rig.layers import PlaneLayers
from reconstruction.rig.plane_view import points_at_height, projector_px
from reconstruction.rig.sensor import SensorNoise

QUIET = SensorNoise(0.0, 0.0, 0.0, 256.0)
RAW = ReconstructOptions(decode=DecodeOptions(filter_taps=0, frame_gains=False))
INSIDE = np.s_[10:-10, 10:-10]


def relief_at(calibration, displacement_mm):
    """Return the points (row, col, xyz) of a bump with waves, moved by x, y, z mm."""
    points = points_at_height(calibration, displacement_mm[2])
    eye = calibration.T_world_from_cam[:3, 3]
    for _ in range(8):
        x, y = points[..., 0] - displacement_mm[0], points[..., 1] - displacement_mm[1]
        z = displacement_mm[2] + 0.5 * np.exp(-(x**2 + y**2) / 18.0)
        z += 0.05 * np.sin(2.0 * np.pi * x / 4.0)
        points = eye + (points - eye) * ((z - eye[2]) / (points[..., 2] - eye[2]))[..., None]
    return points


def recorded(patterns, calibration, stage):
    """Return the capture of the relief with the motion of the stage, noise-free float32."""
    frames = []
    for frame, moved_mm in zip(patterns.frames, stage.displacements_mm(patterns), strict=True):
        x_px = projector_px(calibration, relief_at(calibration, moved_mm))[..., 0]
        if frame.kind == "phase":
            period_px, shift = patterns.phase_of(frame)
            frames.append(np.cos(2.0 * np.pi * (x_px / period_px + shift)))
        else:
            levels = patterns.profile(frame) / 127.5 - 1.0
            frames.append(levels[np.rint(x_px).astype(int)])
    stack = (120.0 + 100.0 * np.stack(frames)).astype(np.float32)
    return Capture(stack, patterns, QUIET, calibration, 8, stage=stage)


def rms_um(result, truth_mm):
    valid = result.point_map.valid[INSIDE]
    error_um = 1e3 * (result.point_map.points_world_mm - truth_mm)[..., 2][INSIDE][valid]
    assert valid.mean() > 0.99
    return float(np.sqrt(np.mean(np.square(error_um))))


@pytest.mark.parametrize(
    ("steps", "stepping", "velocity_mm"),
    [
        (3, "equal", (0.0, 0.0, 0.01)),
        (4, "equal", (0.02, 0.0, 0.0)),
        (4, "equal", (0.02, 0.01, 0.004)),
        (5, "cyclic", (0.02, 0.0, 0.0)),
    ],
)
def test_rigid_uniform_motion_is_removed(calibration, velocity_mm, steps, stepping):
    """Expected: error of 0.4 to 4 um with frames as they are, 20 times less with the stage.

    The error left is below 0.03 um; cyclic steps have less than 0.2 um without the stage.
    """
    patterns = PatternSet(1280, 720, steps=steps, stepping=stepping, axes=("column",))
    stage = StageMotion(velocity_mm_per_frame=velocity_mm)
    capture = recorded(patterns, calibration, stage)
    truth = relief_at(calibration, (0.0, 0.0, 0.0))
    moved = rms_um(reconstruct(replace(capture, stage=None), RAW), truth)
    still = rms_um(reconstruct(capture, RAW), truth)
    assert still < 0.03
    assert stepping == "cyclic" or moved > max(0.4, 20.0 * still)


def test_positions_that_are_not_uniform(calibration):
    """Setup: a stage with irregular steps; reference at frame 2. Expected: the relief there."""
    patterns = PatternSet(1280, 720, steps=4, axes=("column",))
    rng = np.random.default_rng(4)
    positions = np.cumsum(rng.uniform(0.0, 0.02, (len(patterns.frames), 3)), axis=0)
    positions[:, 2] *= 0.3
    stage = StageMotion(positions_mm=tuple(map(tuple, positions)), reference_frame=2)
    capture = recorded(patterns, calibration, stage)
    truth = relief_at(calibration, (0.0, 0.0, 0.0))
    assert rms_um(reconstruct(replace(capture, stage=None), RAW), truth) > 0.5
    assert rms_um(reconstruct(capture, RAW), truth) < 0.05


def test_noise_of_corrected_frames_is_that_of_the_camera(calibration):
    """Setup: read noise of 2 DN, motion along z. Expected: error / sigma 1 within 4 %."""
    patterns = PatternSet(1280, 720, steps=4, axes=("column",))
    stage = StageMotion(velocity_mm_per_frame=(0.0, 0.0, 0.005))
    capture = recorded(patterns, calibration, stage)
    noise = np.random.default_rng(6).normal(0.0, 2.0, capture.stack.shape)
    noisy = (capture.stack + noise).astype(np.float32)
    capture = replace(capture, stack=noisy, sensor=SensorNoise(1e-3, 2e3, 0.0, 2e5), bit_depth=16)
    result = reconstruct(capture, RAW)
    valid = result.point_map.valid[INSIDE]
    truth = relief_at(calibration, (0.0, 0.0, 0.0))
    error = (result.point_map.points_world_mm - truth)[..., 2][INSIDE][valid]
    normalised = error / result.point_map.sigma_z_mm[INSIDE][valid]
    assert valid.mean() > 0.99
    assert normalised.std() == pytest.approx(1.0, abs=0.04)


def test_the_table_stage_is_kept_in_the_folder_of_a_capture(calibration, tmp_path):
    patterns = PatternSet(1280, 720, steps=3, axes=("column",))
    stage = StageMotion(velocity_mm_per_frame=(0.0, 0.0, 0.01), surface_z_mm=0.25)
    write_capture(tmp_path, recorded(patterns, calibration, stage))
    assert read_capture(tmp_path).stage == stage
    with pytest.raises(CaptureError, match=r"\[stage\] needs the calibration of the rig"):
        read_uncalibrated(tmp_path)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "give either positions_mm or velocity_mm_per_frame"),
        ({"velocity_mm_per_frame": (1.0, 2.0)}, "give x, y and z in mm"),
        ({"positions_mm": ((0.0, 0.0, np.inf),)}, "positions_mm is inf"),
    ],
)
def test_wrong_positions_are_errors(given, message):
    with pytest.raises(InputError, match=message):
        StageMotion(**given)


def test_a_stage_that_cannot_be_applied_is_an_error(calibration):
    patterns = PatternSet(1280, 720, steps=3, axes=("column",))
    stack = np.zeros((len(patterns.frames), 90, 120), np.float32)

    def held(shown, rig=calibration, **given):
        hold_still(stack[: len(shown.frames)], shown, QUIET, rig, StageMotion(**given))

    with pytest.raises(InputError, match=r"has 1 positions; the sequence has \d+ frames"):
        held(patterns, positions_mm=((0.0, 0.0, 0.0),))
    with pytest.raises(InputError, match=r"reference_frame is 99; allowed are 0 to"):
        held(patterns, velocity_mm_per_frame=(0.0, 0.0, 0.01), reference_frame=99)
    with pytest.raises(InputError, match="frames of code words are displaced by up to"):
        held(patterns, velocity_mm_per_frame=(0.2, 0.0, 0.0))
    layered = replace(calibration, layers=PlaneLayers((5.0,), (1.4,)))
    with pytest.raises(InputError, match=r"not available below \[layers\]"):
        held(patterns, layered, velocity_mm_per_frame=(0.0, 0.0, 0.01))
    single = PatternSet(1280, 720, steps=1, stepping="single", axes=("column",))
    with pytest.raises(InputError, match="no effect on patterns stepping 'single'"):
        held(single, velocity_mm_per_frame=(0.0, 0.0, 0.01))
