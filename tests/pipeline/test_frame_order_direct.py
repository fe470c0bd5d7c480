"""Bare specimens are difficult captures, not wrong ones: their order is not called wrong."""

import numpy as np
import pytest

from reconstruction.capture.frame_order import check_order
from reconstruction.errors import CaptureError
from twin.config import load_experiment
from twin.pipeline.fringes import expose_capture, take
from twin.pipeline.progress import Stopwatch

SMALL = {"camera.binning": 4, "camera.width_px": 640, "camera.height_px": 480}
SMALL |= {"render.photons": 200_000, "render.bounce_paths": 1}
SMALL |= {"modality": "direct_fpp", "patterns.steps": 8, "patterns.period_px": 16.0}


def test_bare_specimen_passes_at_any_exposure(mi):
    """Setup: a polished ball (glints, dark flanks, light between ball and stage), exposed as a user
    would, eight times longer (clipped) and ten times shorter (dark).

    Expected: no alarm, with and without calibration; and the same images with two frames exchanged
    are still rejected at the normal exposure, or the check would be without effect.
    """
    _, recording = take(load_experiment("examples/slab_ball", SMALL))
    for factor in (1.0, 8.0, 0.1):
        exposure = {"camera.exposure_ms": factor * recording.exposure_ms}
        experiment = load_experiment("examples/slab_ball", SMALL | exposure)
        capture = expose_capture(experiment, recording.radiance, Stopwatch(), 1).capture
        clipped = np.mean(capture.stack.max(axis=0) >= capture.sensor.clipped_from_dn)
        assert (clipped > 0.02) == (factor == 8.0)
        for calibration in (capture.calibration, None):
            check_order(capture.stack, capture.patterns, capture.sensor, calibration)
    capture = recording.capture
    wrong = capture.stack[[0, 1, 2, 4, 3, *range(5, len(capture.stack))]]
    with pytest.raises(CaptureError, match=r"frames 3 .* and 4 .* look exchanged"):
        check_order(wrong, capture.patterns, capture.sensor)
