"""Stage positions of a moving specimen, and the predicted error of its points by motion."""

from dataclasses import replace

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.capture.folder import Capture
from reconstruction.motion.positions import StageMotion
from reconstruction.motion.prediction import (
    Displacements,
    MeasuredSurface,
    has_one_set,
    of_displacements,
)
from reconstruction.patterns import Axis, PatternSet
from reconstruction.pipeline import Reconstruction, reconstruct
from reconstruction.triangulation import Use
from twin.config.models import Experiment
from twin.config.motion import Motion
from twin.optics.frame_times import mean_times_s, row_delay_s
from twin.pipeline.captures import options_of


def stage_of(experiment: Experiment) -> StageMotion | None:
    """Return the positions that an encoder records; None: no encoder, or the specimen rests.

    The reference position is that of time 0, at which the truth is.
    """
    motion = experiment.motion
    if not (motion.moves and motion.encoder):
        return None
    places_mm = [motion.shift_mm(float(at)).tolist() for at in mean_times_s(experiment)]
    return StageMotion(
        positions_mm=tuple(map(tuple, places_mm)),
        surface_z_mm=motion.encoder_surface_z_mm,
        reference_mm=(0.0, 0.0, 0.0),
    )


def reconstruct_moving(experiment: Experiment, capture: Capture) -> Reconstruction:
    """Reconstruct a capture, with the errors by the motion that the experiment states.

    They are predicted for bare specimens only, and neither after a correction by an encoder nor
    with `decode.motion_error`, which predicts them from the frames.

    Raises
    ------
    InputError : as `reconstruct`
    """
    result = reconstruct(capture, options_of(experiment.decode))
    is_stated = experiment.motion.moves and not experiment.method.presses
    is_open = capture.stage is None and result.motion is None and not experiment.layers
    if not (is_stated and is_open and has_one_set(capture.patterns)):
        return result
    axes = result.decoded.axes
    use: Use = experiment.decode.use if len(axes) == 2 else axes[0]
    measured = MeasuredSurface(result.decoded, result.point_map, capture.calibration, use)
    points_mm = result.point_map.points_world_mm.astype(np.float64)
    displaced = {axis: _displaced(experiment, capture.patterns, axis, points_mm) for axis in axes}
    return replace(result, motion=of_displacements(measured, capture.patterns, displaced))


def _displaced(
    experiment: Experiment, patterns: PatternSet, axis: Axis, points_mm: FloatArray
) -> Displacements:
    """Return the displacements of the points (row, col, xyz) at the phase frames of one axis."""
    times_s = mean_times_s(experiment)[patterns.step_sets(axis)[0]]
    period_s, rows = float(np.diff(times_s).mean()), len(points_mm)
    from_middle_s = row_delay_s(experiment) * (np.arange(rows) - 0.5 * (rows - 1))
    parts = [
        _since(experiment.motion, points_mm[row], float(times_s.mean() + later_s), period_s)
        for row, later_s in enumerate(from_middle_s)
    ]
    return Displacements(*(np.stack(images) for images in zip(*parts, strict=True)))


def _since(
    motion: Motion, points_mm: FloatArray, time_s: float, period_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return displacements of points (point, xyz) at a time: per frame, and since time 0, mm."""
    start_mm = _placed(np.asarray(np.linalg.inv(motion.pose_at(time_s)), np.float64), points_mm)
    after, before = (
        _placed(motion.pose_at(time_s + sign * period_s), start_mm) for sign in (0.5, -0.5)
    )
    return after - before, points_mm - start_mm


def _placed(pose: FloatArray, points_mm: FloatArray) -> FloatArray:
    return np.asarray(points_mm @ pose[:3, :3].T + pose[:3, 3])
