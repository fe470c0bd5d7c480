"""A sample of a photometric sensor: image, truth and decoded heights."""

import numpy as np

from reconstruction.evaluate.baselines import BASELINES
from reconstruction.evaluate.predictions import PredictionScore
from reconstruction.evaluate.samples import LabelledSample
from twin.config import load_experiment
from twin.dataset.quantities import SAMPLE_QUANTITIES, check_held
from twin.dataset.taking import take_sample
from twin.pipeline import Memory

# As tests/pipeline/reference.py: a calibration that is quick, not accurate.
FEW = {
    "photometric.presses.count": 5,
    "photometric.presses.backgrounds": 2,
    "photometric.presses.smallest_diameter_mm": 5.5,
}
HELD = (
    "image", "background", "depth_mm", "normal_world", "point_world_mm", "label", "lit", "contact",
    "pressure_kpa", "decoded_depth_mm", "decoded_normal_world", "decoded_reason",
)  # fmt: skip


def test_a_ball_under_a_photometric_sensor() -> None:
    """Expected: the decoded depth is in the camera frame of the true one, and normals agree."""
    experiment = load_experiment("examples/gelsight_ball", FEW)
    check_held(HELD, experiment)
    taken, figures = take_sample(experiment, Memory(), 1, decode=True)
    arrays = {name: SAMPLE_QUANTITIES[name].values(taken) for name in HELD}
    assert arrays["image"].shape == arrays["background"].shape == (240, 320, 3)
    assert figures["force_n"] > 0
    assert all(np.isfinite(values).all() for values in arrays.values())
    # The camera looks along -z from its standoff: depth + z of a point is the standoff.
    shown = arrays["label"] == 2
    sum_mm = arrays["depth_mm"] + arrays["point_world_mm"][..., 2]
    assert np.ptp(sum_mm[shown]) < 1e-4
    sample = LabelledSample("0", {"object": "ball"}, arrays)
    names = ("depth_mm", "normal_world")
    score = PredictionScore(names)
    score.add(sample, {name: BASELINES["decoded"].predict(sample, name) for name in names})
    result = score.figures()
    assert result["depth_completeness"] > 0.9
    assert result["depth_rms_um"] < 150.0  # the ball is pressed 700 um deep
    assert result["normal_rms_deg"] < 12.0
    flipped = arrays["decoded_normal_world"] * np.array([-1.0, 1.0, 1.0])
    other = PredictionScore(("normal_world",))
    other.add(sample, {"normal_world": flipped})
    assert other.figures()["normal_rms_deg"] > 1.2 * result["normal_rms_deg"]
