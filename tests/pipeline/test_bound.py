"""What is predicted from the trace, against the spread of many measurements."""

import numpy as np
import pytest

from tests.pipeline.conftest import CENTRE
from twin.config import load_experiment, vary
from twin.pipeline import Memory, measure
from twin.pipeline.bound import bounds_alone, predicted
from twin.pipeline.press import press
from twin.results.bound import bound_names, is_bound_name

SMALL = CENTRE | {"camera.binning": 4, "press.relief_pitch_mm": 0.05, "press.solver_pitch_mm": 0.16}
TRIALS = 60


@pytest.fixture(scope="module")
def balls():
    return load_experiment("examples/slab_balls", SMALL)


def heights_and_radii(experiment, trials):
    memory, heights, figures = Memory(), [], []
    for trial in range(trials):
        done = measure(experiment, memory=memory, trial=trial)
        heights.append(done.fringes.reconstruction.point_map.points_world_mm[..., 2])
        figures.append(done.metrics)
    return np.array(heights, np.float64), figures


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"patterns.steps": 5, "patterns.period_px": 12.0, "decode.use": "both"},
    ],
    ids=["default", "five steps, both axes"],
)
def test_predicted_sigma_is_the_spread_of_measurements(balls, changes):
    """60 measurements with noise of its own each, pixel by pixel and for the fitted radii.

    Expected: spread over prediction is 1, per pixel 9 % by the number of trials, 3 % in the mean;
    where the filter gives relief back in part it fluctuates with the noise and spreads a little
    more. Radii: 9 % each, 5 % in the mean of four; `./run bench bound` takes many more.
    """
    experiment = vary(balls, changes)
    heights, figures = heights_and_radii(experiment, TRIALS)
    memory = Memory()
    prediction, _ = predicted(experiment, press(experiment, memory), memory)
    both = prediction.valid & np.all(heights != 0.0, axis=0)
    assert both.mean() > 0.98 * prediction.valid.mean()
    ratio = heights.std(axis=0, ddof=1)[both] / prediction.filtered_mm[both]
    assert ratio.mean() == pytest.approx(1.0, abs=0.06)
    assert ratio.std() < 0.15
    bounds, over, under = bounds_alone(experiment, memory)[1], [], []
    for name in ("object_radius_1", "object_radius_2", "sphere_1_radius", "sphere_2_radius"):
        spread_um = 1e3 * np.std([one[f"{name}_mm"] for one in figures], ddof=1)
        over.append(np.log(bounds[f"{name}_spread_um"] / spread_um))
        under.append(np.log(bounds[f"{name}_crb_um"] / spread_um))
    assert np.mean(over) == pytest.approx(0.0, abs=0.15)
    assert np.mean(under) == pytest.approx(0.0, abs=0.18)


def test_bounds_beside_and_alone_are_the_same(balls):
    """The figures do not depend on whether anything was measured; all are named beforehand."""
    beside = measure(balls, bound=True).metrics
    alone = bounds_alone(balls, Memory())[1]
    found = {name: value for name, value in beside.items() if is_bound_name(name)}
    assert found == {name: value for name, value in alone.items() if is_bound_name(name)}
    assert set(found) == bound_names(balls)
    assert beside["exposure_ms"] == pytest.approx(alone["exposure_ms"], rel=1e-3)
    assert not any(is_bound_name(name) for name in measure(balls).metrics)


def test_more_light_and_shorter_fringes_bound_lower(balls):
    """In shot noise the bound falls with the root of the light, and in proportion to the period."""

    def bound(**changes):
        changed = {name.replace("__", "."): value for name, value in changes.items()}
        return bounds_alone(vary(balls, changed), Memory())[1]["crb_radius_um"]

    dim = bound(camera__exposure_ms=40.0)
    assert dim / bound(camera__exposure_ms=80.0) == pytest.approx(np.sqrt(2.0), rel=0.03)
    assert bound(camera__exposure_ms=40.0, patterns__period_px=9.0) < 0.6 * dim
