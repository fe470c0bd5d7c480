"""Every kind of sequence that the decoder reads is simulated and measured.

Setup: two balls under a slab, 120 x 80 pixels, filter off, all sequences on one press.
Oracle: the errors are those that the decoder predicts. Words without fringes have the error of
their step, whose RMS is step / sqrt(12) and which the prediction includes.
"""

import numpy as np
import pytest

from tests.pipeline.reference import COARSE
from twin.config import load_experiment
from twin.pipeline import Memory, measure

SMALL = COARSE | {
    "camera.binning": 4,
    "camera.width_px": 480,
    "camera.height_px": 320,
    "patterns.steps": 4,
    "decode.filter_taps": 0,
}
WORDS = {"code": "gray", "steps": 0, "period_px": 2.0}
SEQUENCES = {
    "columns only": ({"axes": ["column"]}, 14),
    "binary words": ({"code": "gray", "word": "binary"}, 23),
    "exclusive-or words": ({"code": "gray", "word": "xor_04"}, 23),
    "inverse frames": ({"code": "gray", "inverse": True, "uniform": False}, 34),
    "words without fringes": (WORDS, 21),
    "inverse pairs without fringes": (WORDS | {"inverse": True, "uniform": False}, 38),
    "one fringe": ({"code": "gray", "period_px": 1280.0, "uniform": False}, 8),
    "fringes only": (
        {"code": "hierarchical", "further_periods_px": [80, 400, 1400], "uniform": False},
        32,
    ),
    "heterodyne only": (
        {"code": "heterodyne", "further_periods_px": [18.25], "uniform": False},
        16,
    ),
    "other shifts and levels": (
        {"first_shifts_deg": [90, -45], "low_level": 30, "high_level": 220},
        25,
    ),
}


@pytest.fixture(scope="module")
def measured(mi):
    """Measure with changed patterns, on one press."""
    memory = Memory()

    def with_patterns(patterns, **settings):
        changes = {f"patterns.{key}": value for key, value in patterns.items()}
        experiment = load_experiment("examples/slab_balls", SMALL | changes | settings)
        return measure(experiment, memory=memory)

    return with_patterns


@pytest.mark.parametrize(("patterns", "frames"), SEQUENCES.values(), ids=SEQUENCES)
def test_a_sequence_is_measured_with_its_predicted_error(measured, patterns, frames):
    figures = measured(patterns).figures
    assert figures["frames"] == frames
    assert figures["completeness"] > 0.97
    assert figures["wrong_order_pixels"] == 0
    # Relief within a pixel adds 2.5 um to the noise.
    predicted_um = np.hypot(figures["sigma_z_median_um"], 2.5)
    assert 0.3 * predicted_um < figures["z_rmse_um"] < 1.5 * predicted_um


def test_rows_carry_the_depth_of_a_projector_above(measured):
    turned = {"projector.pose.azimuth_deg": 90.0}
    done = measured({"axes": ["row"]}, **turned)
    assert done.figures["z_rmse_um"] < 4.0
    assert done.metrics["warnings"] == []
    unsuitable = measured({"axes": ["row"]})
    assert unsuitable.figures["z_rmse_um"] > 1000.0
    assert 'set patterns.axes = ["column"]' in unsuitable.metrics["warnings"][0]


def test_without_a_white_frame_the_brightest_frame_sets_the_exposure(measured):
    """The middle of the image, the dark half of the first bit, is exposed as with a white frame."""
    bits = WORDS | {"inverse": True}
    with_white, without = measured(bits), measured(bits | {"uniform": False})
    ratio = without.figures["exposure_ms"] / with_white.figures["exposure_ms"]
    assert ratio == pytest.approx(1.0, rel=0.03)  # at the edges of bits no frame is white
    frames, exposure_ms = without.figures["frames"], without.figures["exposure_ms"]
    assert without.figures["sequence_ms"] == pytest.approx(frames * exposure_ms)
