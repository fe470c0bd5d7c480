"""Predicted errors by motion of synthetic captures, and light that is not mistaken for motion."""

from dataclasses import replace

import numpy as np
import pytest

from reconstruction.decoding.decode import DecodeOptions, decode
from reconstruction.decoding.gains import estimate_gains
from reconstruction.errors import InputError
from reconstruction.motion.neighbourhood import motion_nearby
from reconstruction.motion.phase_rate import phase_error, steps_of
from reconstruction.motion.positions import StageMotion
from reconstruction.motion.prediction import Displacements, MeasuredSurface, of_displacements
from reconstruction.patterns import PatternSet
from reconstruction.pipeline import (
    read_reconstruction,
    reconstruct,
    write_reconstruction,
)
from reconstruction.rig.layers import PlaneLayers
from reconstruction.rig.sensor import SensorNoise
from tests.reconstruction.moving import moving_frames, ramp
from tests.reconstruction.test_stage import INSIDE, RAW, recorded, relief_at

PER_RAD = 18.0 / (2.0 * np.pi)
SENSOR = SensorNoise(0.5, 5.0, 0.0, 1e5)


def of(steps, stepping="equal", **keys):
    return PatternSet(1280, 720, steps=steps, stepping=stepping, axes=("column",), **keys)


def noisy(frames, seed):
    noise = np.random.default_rng(seed).normal(0.0, 1.0, frames.shape)
    return (frames + noise * np.sqrt(0.5 * frames + 6.25)).astype(np.float32)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize("sequence", [(3,), (4,), (8, "quarter_pairs"), (5, "cyclic")])
def test_error_by_levels_that_change_is_that_of_the_decoder(quiet_sensor, sequence):
    """Setup: mean and modulation change by 0.8 and 0.5 DN per frame, the phase by 0.05 rad."""
    patterns, columns = of(*sequence), ramp(8, 300)
    stack = moving_frames(patterns, columns, 0.0)
    times = steps_of(patterns).times[:, None, None]
    shifts = steps_of(patterns).shifts_rad[:, None, None]
    angles = columns / PER_RAD + shifts + 0.05 * times
    stack[: patterns.steps] = 120.0 + 0.8 * times + (100.0 + 0.5 * times) * np.cos(angles)
    decoded = decode(stack, patterns, quiet_sensor, RAW.decode)
    error_rad = (decoded.column.coordinate_px - columns)[decoded.valid] / PER_RAD
    changes = {"mean_change": 0.8 / 100.0, "modulation_change": 0.5 / 100.0}
    expected = phase_error(columns / PER_RAD, 0.05, steps_of(patterns), **changes)
    np.testing.assert_allclose(error_rad, expected[decoded.valid], atol=2e-5)
    still = phase_error(columns / PER_RAD, 0.05, steps_of(patterns))
    assert np.abs(expected - still).max() > 5e-3


@pytest.mark.parametrize("steps", [4, 5, 8, 18])
def test_motion_is_not_taken_for_light_that_changes(steps):
    """Setup: 0 to 0.1 rad per frame, noise. Expected: no light; a drift of 1 % is estimated."""
    patterns, columns = of(steps), ramp(120, 160)
    rate = np.linspace(0.0, 0.1, 160) * np.ones(columns.shape)
    sensor, rng = SensorNoise(0.1, 2.0, 0.0, 1e5), np.random.default_rng(1)
    noise = rng.normal(0.0, 1.0, (len(patterns.frames), *columns.shape)).astype(np.float32)
    moved = moving_frames(patterns, columns, rate * PER_RAD) + noise
    assert estimate_gains(moved, patterns, sensor, DecodeOptions(), None) is None
    rested = moving_frames(patterns, columns, 0.0)
    drift = np.linspace(0.995, 1.005, steps)
    rested[:steps] *= drift[:, None, None]
    gains = estimate_gains(rested + noise, patterns, sensor, DecodeOptions(), None)
    assert gains is not None
    np.testing.assert_allclose(gains.relative[0, 0], drift, atol=2e-3)


@pytest.mark.parametrize("sequence", [(4,), (5,), (8, "quarter_pairs")])
def test_rate_from_a_neighbourhood(sequence):
    """Setup: noise, rates from 0.04 to 0.06 rad per frame. Expected: error / sigma 1 within 30 %.

    A hundred windows do not overlap, and the rate changes linearly, which a window keeps.
    """
    patterns, columns = of(*sequence), ramp(100, 300)
    rate = np.linspace(0.04, 0.06, 100)[:, None] * np.ones(columns.shape)
    frames = noisy(moving_frames(patterns, columns, rate * PER_RAD), 4)
    decoded = decode(frames, patterns, SENSOR, RAW.decode)
    motion = motion_nearby(frames, patterns, decoded, SENSOR)
    inner = np.s_[10:-10, 10:-10]
    normalised = (motion.rate_rad - rate)[inner] / motion.sigma_rad[inner]
    assert rms(normalised) == pytest.approx(1.0, abs=0.3)
    actual_px = phase_error(columns / PER_RAD, rate, steps_of(patterns)) * PER_RAD
    assert rms((motion.error_px - actual_px)[inner]) < 0.3 * rms(actual_px[inner])


@pytest.mark.parametrize(
    ("sequence", "velocity_mm"),
    [((4,), (0.0, 0.0, 0.01)), ((4,), (0.02, 0.01, 0.004)), ((3,), (0.02, 0.0, 0.0))],
)
def test_error_of_a_known_motion(calibration, sequence, velocity_mm):
    """Setup: a bump with waves that moves. Expected: 80 % of the error of z is predicted.

    The truth is the surface 6 frames later than the middle of the phase frames.
    """
    patterns = of(*sequence)
    stage = StageMotion(velocity_mm_per_frame=velocity_mm)
    capture = replace(recorded(patterns, calibration, stage), stage=None)
    result = reconstruct(capture, RAW)
    shape, velocity = result.point_map.points_world_mm.shape, np.array(velocity_mm)
    shifts = Displacements(np.broadcast_to(velocity, shape), np.broadcast_to(-6 * velocity, shape))
    measured = MeasuredSurface(result.decoded, result.point_map, calibration, "column")
    motion = of_displacements(measured, patterns, {"column": shifts})
    valid = result.point_map.valid[INSIDE]

    def error_mm(frames_later):
        truth = relief_at(calibration, frames_later * velocity)
        return (result.point_map.points_world_mm - truth)[..., 2][INSIDE][valid]

    ripple_mm, lag_mm = motion.error_z_mm[INSIDE][valid], motion.lag_z_mm[INSIDE][valid]
    assert rms(ripple_mm - error_mm(0.0)) < 0.2 * rms(error_mm(0.0))
    assert rms(ripple_mm + lag_mm - error_mm(6.0)) < 0.2 * rms(error_mm(6.0))


def test_errors_by_motion_are_stored(calibration, tmp_path):
    """Setup: prediction from residuals. Expected: the same maps from the file, with units."""
    patterns = of(4)
    stage = StageMotion(velocity_mm_per_frame=(0.0, 0.0, 0.01))
    capture = replace(recorded(patterns, calibration, stage), stage=None)
    result = reconstruct(capture, replace(RAW, motion_error=True))
    truth = relief_at(calibration, (0.0, 0.0, 0.0))
    valid = result.point_map.valid[INSIDE]
    actual_mm = (result.point_map.points_world_mm - truth)[..., 2][INSIDE][valid]
    assert rms(result.motion.error_z_mm[INSIDE][valid] - actual_mm) < 0.1 * rms(actual_mm)
    write_reconstruction(tmp_path / "maps.nc", result.decoded, result.point_map, result.motion)
    stored = read_reconstruction(tmp_path / "maps.nc").motion
    for name, image in result.motion.maps().items():
        np.testing.assert_array_equal(stored.maps()[name], image)
    assert result.to_xarray()["motion_error_z_mm"].attrs["units"] == "mm"
    assert result.to_xarray()["phase_rate_column_rad"].attrs["units"] == "rad"
    assert reconstruct(capture, RAW).motion is None


def test_motion_that_cannot_be_predicted_is_an_error(calibration):
    three = of(3)
    capture = recorded(three, calibration, StageMotion(velocity_mm_per_frame=(0.0, 0.0, 0.01)))
    with pytest.raises(InputError, match=r"motion_error: found 3 steps.* needed are 4 steps"):
        reconstruct(capture, replace(RAW, motion_error=True))
    result = reconstruct(capture, RAW)
    layered = replace(calibration, layers=PlaneLayers((5.0,), (1.4,)))
    with pytest.raises(InputError, match=r"not available below \[layers\]"):
        of_displacements(
            MeasuredSurface(result.decoded, result.point_map, layered, "column"), three, {}
        )
    beats = of(4, code="heterodyne", further_periods_px=(19.0, 20.0))
    with pytest.raises(InputError, match="not available with patterns code 'heterodyne'"):
        of_displacements(
            MeasuredSurface(result.decoded, result.point_map, calibration, "column"), beats, {}
        )


def test_the_reference_of_a_stage_may_be_a_position(calibration):
    """Setup: reference at the position of frame 2. Expected: as `reference_frame = 2`."""
    patterns = of(4)
    places = tuple((0.02 * n, 0.0, 0.0) for n in range(len(patterns.frames)))
    framed = StageMotion(positions_mm=places, reference_frame=2)
    placed = StageMotion(positions_mm=places, reference_mm=places[2])
    np.testing.assert_array_equal(
        placed.displacements_mm(patterns), framed.displacements_mm(patterns)
    )
    for wrong in (replace(placed, reference_mm=()), framed):
        assert wrong.reference_mm == ()
    with pytest.raises(InputError, match="reference_mm: allowed with positions_mm"):
        StageMotion(positions_mm=places, reference_frame=2, reference_mm=(0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="reference_mm has the entry"):
        StageMotion(positions_mm=places, reference_mm=(0.0, 1.0))
