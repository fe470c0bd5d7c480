"""Repeated exposures of one rendering, decoded."""

from typing import Any

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.pipeline import reconstruct
from twin.camera import expose
from twin.config import Experiment
from twin.pipeline.captures import options_of

REPEATS = 16


def repeated_heights(
    experiment: Experiment, recording: Any
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return heights and sigma, (trial, row, col), mm, and where all are valid, (row, col)."""
    white = recording.capture.patterns.index("white").start
    maps = []
    for trial in range(REPEATS):
        exposed = expose(experiment, recording.radiance.frames, white, trial)
        capture = type(recording.capture)(
            exposed.stack, recording.capture.patterns, exposed.sensor,
            recording.capture.calibration, recording.capture.bit_depth,
        )  # fmt: skip
        maps.append(reconstruct(capture, options_of(experiment.decode)).point_map)
    heights_mm = np.array([points.points_world_mm[..., 2] for points in maps])
    sigma_mm = np.array([points.sigma_z_mm for points in maps])
    return heights_mm, sigma_mm, np.all([points.valid for points in maps], axis=0)
