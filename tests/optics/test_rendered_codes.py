"""Every code of the fringe order is rendered and decoded with one definition."""

import numpy as np
import pytest

from reconstruction.decoding import PhaseReference
from reconstruction.decoding.decode import DecodeOptions, decode
from reconstruction.rig.sensor import SensorNoise
from twin.config import load_experiment
from twin.optics.light import pattern_set
from twin.optics.rig import true_calibration
from twin.pipeline import render

SMALL = {
    "camera.width_px": 120,
    "camera.height_px": 92,
    "camera.binning": 2,
    "camera.pixel_pitch_um": {"value": 72.0, "source": "test"},
    "coating.flake_fraction": 0.0,
    "patterns.steps": 4,
    "projector.gamma": 1.0,
}


@pytest.mark.parametrize(
    "change",
    [
        {"patterns.code": "shifted_gray"},
        {"patterns.code": "hierarchical", "patterns.further_periods_px": [1500.0, 150.0]},
        {"patterns.code": "quaternary_gray"},
        {"patterns.code": "spatial", "patterns.period_px": 36.0},
        {
            "patterns.code": "micro",
            "patterns.period_px": 18.0,
            "patterns.further_periods_px": [15.5, 15.76, 16.45, 20.4, 20.72],
        },
    ],
    ids=lambda change: change["patterns.code"],
)
def test_rendered_code_gives_the_true_projector_coordinate(mi, plane, change):
    """Setup: flat face, noise-free. Expected: the coordinate of each point, within 0.1 px.

    Why 0.1: one value is decoded from four rays of a pixel that covers 2 to 3 projector pixels.
    """
    experiment = load_experiment("examples/slab_balls", SMALL | change)
    patterns = pattern_set(experiment.projector, experiment.patterns)
    stack = render(experiment, plane)
    calibration = true_calibration(experiment)
    T_proj_from_world = np.linalg.inv(calibration.T_world_from_proj)
    points = stack.truth.points_world_mm @ T_proj_from_world[:3, :3].T + T_proj_from_world[:3, 3]
    projector_px = calibration.projector.project(points)
    frames = np.stack(list(stack.frames))
    frames = (200.0 / frames.max() * frames).astype(np.float32)
    sensor = SensorNoise(0.0, 0.0, 0.0, 255.0)
    middle = projector_px[46 // 2, 60 // 2]
    reference = PhaseReference(((30.0, 23.0, *middle),)) if patterns.code == "spatial" else None
    options = DecodeOptions(filter_taps=0, reference=reference)
    decoded = decode(frames, patterns, sensor, options)
    assert decoded.valid.mean() > 0.9
    error = (decoded.column.coordinate_px - projector_px[..., 0])[decoded.valid]
    assert np.max(np.abs(error)) < 0.1
    error = (decoded.row.coordinate_px - projector_px[..., 1])[decoded.valid]
    assert np.max(np.abs(error)) < 0.1
