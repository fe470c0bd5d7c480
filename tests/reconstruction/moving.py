"""Synthetic captures of a surface in motion: the coordinate of a pixel changes by frame."""

import numpy as np

from reconstruction.patterns import PatternSet

PHASE = 2.0 * np.pi


def moving_frames(
    patterns: PatternSet, column_px: np.ndarray, rate_px: float, mean_dn=120.0, amplitude_dn=100.0
) -> np.ndarray:
    """Return float32 frames; `column_px` is the coordinate in the middle of the phase frames.

    Other frames than phase frames are those at rest. One axis, one period.
    """
    middle, frames = 0.5 * (patterns.steps - 1), []
    for number, frame in enumerate(patterns.frames):
        if frame.kind == "phase":
            period_px, shift = patterns.phase_of(frame)
            x_px = column_px + rate_px * (number - middle)
            frames.append(mean_dn + amplitude_dn * np.cos(PHASE * (x_px / period_px + shift)))
        else:
            levels = patterns.profile(frame) / 127.5 - 1.0
            frames.append(mean_dn + amplitude_dn * levels[np.rint(column_px).astype(int)])
    return np.stack(frames).astype(np.float32)


def ramp(rows: int, cols: int, per_px: float = 1.8) -> np.ndarray:
    """Return slanted projector columns (row, col) from 200 px on."""
    row, col = np.mgrid[0:rows, 0:cols].astype(float)
    return 200.0 + per_px * col + 0.2 * row
