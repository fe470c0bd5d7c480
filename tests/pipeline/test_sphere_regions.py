"""Sphere figures over several regions and by both fits, from one measurement."""

import numpy as np
import pytest

from twin.config import load_experiment, vary
from twin.pipeline import measure

SMALL = {
    "camera.binning": 4,
    "patterns.steps": 4,
    "press.relief_pitch_mm": 0.05,
    "press.solver_pitch_mm": 0.16,
}


@pytest.fixture(scope="module")
def figures(mi):
    regions = {"score.regions_mm": [1.5, 0.8, 4.0]}
    return measure(load_experiment("examples/slab_balls", SMALL | regions)).figures


@pytest.mark.parametrize(
    "name", ["radius_mm", "algebraic_radius_mm", "rmse_mm", "algebraic_p95_mm"]
)
def test_the_scored_region_is_one_of_them(figures, name):
    """score.roi_radius_mm is 1.5 mm in the paper's rig: requested twice, it gives the same."""
    assert figures[f"sphere_1_within_1p5_{name}"] == figures[f"sphere_1_{name}"]


def test_points_grow_with_the_region(figures):
    """As the area of the plan, as far as the ball's footprint reaches."""
    points = [figures[f"sphere_2_within_{r}_points"] for r in ("0p8", "1p5")]
    assert points[1] / points[0] == pytest.approx((1.5 / 0.8) ** 2, rel=0.05)
    assert figures["sphere_2_within_4_points"] > 5 * points[1]


def test_the_least_squares_sphere_leaves_least(figures):
    for region in ("within_0p8_", "within_4_", ""):
        least = figures[f"sphere_1_{region}rmse_mm"]
        assert least <= figures[f"sphere_1_{region}algebraic_rmse_mm"]


def test_without_further_regions_an_experiment_keeps_its_digest():
    base = load_experiment("examples/slab_balls")
    assert "regions_mm" not in base.score.model_dump()
    assert "regions_mm" in vary(base, {"score.regions_mm": [1.2]}).score.model_dump()
    assert np.isclose(base.score.roi_radius_mm, 1.5)
