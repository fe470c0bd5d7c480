"""Frames of a specimen that a stage moves, corrected by the positions of the stage.

The specimen is rigid, does not turn, and has a nominal surface, a plane z of the world. By the
pinhole models each frame's position gives, for each camera pixel, where the point of the surface is
in the image of that frame, and which projector coordinate lights it. Sources: Jeon et al.,
"Motion-induced error reduction for high-speed dynamic digital fringe projection system", arXiv
2401.15938 (2024), for pixel shift and phase shift from the encoder of a stage; Greivenkamp, Opt.
Eng. 23, 350 (1984), for the least-squares fit of known unequal shifts.

1. Each frame is resampled, so that a point of the surface has the same pixel in all frames.
2. Each fringe set is fitted by least squares with the actual phase shift of each pixel and frame.
3. The fit at the actual shifts is replaced by the fit at the shifts of the sequence. The residuals
   remain in the frames, so that masks and noise of the decoder are those of the camera.

The result is the surface at the reference position. Relief z above the nominal surface changes the
shift of a pixel by (motion in px) x z / (distance of the devices), to first order.
"""

from typing import Any

import numpy as np
from scipy import ndimage

from reconstruction.arrays import FloatArray, FloatImage, Stack
from reconstruction.errors import InputError
from reconstruction.motion.least_squares import fit_fringes
from reconstruction.motion.positions import StageMotion
from reconstruction.patterns import AXES, Axis, PatternSet
from reconstruction.reduction.equivalent import lost_pixels
from reconstruction.rig.calibration import Calibration
from reconstruction.rig.plane_view import camera_px, points_at_height, projector_px
from reconstruction.rig.sensor import SensorNoise

TURN = 2.0 * np.pi
# A frame whose pixels move less than this is not resampled, px.
_LEAST_MOTION_PX = 1e-4
# Largest displacement of Gray frames against the phase frames, in periods: a word of half a period
# is read up to a quarter away from its middle.
_MOST_WORD_SHIFT = 0.2


def hold_still(
    stack: Stack,
    patterns: PatternSet,
    sensor: SensorNoise,
    calibration: Calibration,
    stage: StageMotion,
    *,
    scale: FloatImage | None = None,
) -> FloatImage:
    """Return the frames as if the specimen had rested at the reference position.

    Parameters
    ----------
    stack, patterns, sensor, scale : as in `decode`
    calibration : rig, without layers
    stage : positions of the specimen

    Returns
    -------
    (frame, row, col) float32, DN. Pixels that were outside the image in a frame have the level of a
    clipped pixel in it, so that they are not used

    Raises
    ------
    InputError : the rig has layers, the stepping is "single", the number of positions is wrong, or
        the frames of code words are displaced by more than 0.2 fringe periods
    """
    if calibration.layers is not None:
        raise InputError("stage: not available below [layers]; the rays would be refracted")
    if patterns.stepping == "single":
        raise InputError("stage: has no effect on patterns stepping 'single'; leave it out")
    points_mm = points_at_height(calibration, stage.surface_z_mm)
    start_px = projector_px(calibration, points_mm)
    frames = np.zeros(stack.shape, np.float32)
    moved_px = np.zeros(stack.shape, np.float32)
    lost = np.zeros(stack.shape, np.bool_)
    displacements_mm = stage.displacements_mm(patterns)
    for number, shown in enumerate(patterns.frames):
        there_mm = points_mm + displacements_mm[number]
        pixels = camera_px(calibration, there_mm)
        unusable, marked_dn = lost_pixels(stack[number : number + 1], sensor, scale)
        frames[number], lost[number] = _resampled(stack[number], unusable, pixels)
        frames[number] = np.where(lost[number], marked_dn, frames[number])
        if shown.axis is not None:
            along = AXES.index(shown.axis)
            moved_px[number] = (projector_px(calibration, there_mm) - start_px)[..., along]
    for axis in patterns.axes:
        _check_words(patterns, axis, moved_px)
        for fringes, span in enumerate(patterns.step_sets(axis)):
            period_px = patterns.periods_along(axis)[fringes]
            shifts = TURN * np.array(patterns.shifts(axis, fringes))
            turned = (TURN / period_px * moved_px[span]).astype(np.float64)
            frames[span] = _without_motion(frames[span], shifts, turned, ~lost[span])
    return frames


def _resampled(frame: Stack, unusable: Any, pixels: FloatArray) -> tuple[FloatImage, Any]:
    """Return a frame at other positions (row, col, column and row) px, and where it is unknown."""
    col, row = pixels[..., 0], pixels[..., 1]
    rows, cols = np.indices(frame.shape)
    levels = frame.astype(np.float32)
    if max(np.abs(col - cols).max(), np.abs(row - rows).max()) < _LEAST_MOTION_PX:
        return levels, unusable
    moved = ndimage.map_coordinates(levels, [row, col], order=3, mode="nearest")
    outside = (col < 0) | (row < 0) | (col > frame.shape[1] - 1) | (row > frame.shape[0] - 1)
    if unusable.any():
        near = ndimage.map_coordinates(unusable.astype(np.float32), [row, col], order=1)
        outside |= near > 0.0
    return np.asarray(moved, np.float32), outside


def _without_motion(
    frames: FloatImage, shifts: FloatArray, turned: FloatArray, good: Any
) -> FloatImage:
    """Return the frames (step, row, col) of one fringe set with the shifts of the sequence.

    Parameters
    ----------
    shifts : (step,) shifts of the sequence, rad
    turned : (step, row, col) additional shifts by motion, rad
    good : (step, row, col) levels that are used in the fit
    """
    flat = frames.reshape(len(frames), -1).astype(np.float64)
    nominal = np.broadcast_to(shifts[:, np.newaxis], flat.shape)
    actual = nominal + turned.reshape(flat.shape)
    fitted = fit_fringes(flat, actual, good.reshape(flat.shape))
    still = flat - fitted.levels_dn(actual) + fitted.levels_dn(nominal)
    enough = good.sum(axis=0) >= 3
    return np.where(good & enough, still.reshape(frames.shape), frames).astype(np.float32)


def _check_words(patterns: PatternSet, axis: Axis, moved_px: FloatImage) -> None:
    frames = [patterns.index(kind, axis) for kind in ("gray", "inverse")]
    period_px = patterns.period_along(axis)
    largest_px = max(float(np.abs(moved_px[span]).max(initial=0.0)) for span in frames)
    if largest_px > _MOST_WORD_SHIFT * period_px:
        raise InputError(
            f"stage: frames of code words are displaced by up to {largest_px:.3g} projector px,"
            f" allowed are {_MOST_WORD_SHIFT:g} of period_px {period_px:g}; move slower, or use a"
            " code without words"
        )
