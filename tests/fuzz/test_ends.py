"""Figures that no measurement has are recognised; the drawn cases depend on the seed only."""

import pytest

from benchmarks.fuzz_ends import absurd, drawn_case

SOUND = {"points": 5, "completeness": 1.0, "force_n": 0.0, "z_rmse_um": 0.3, "z_bias_um": -0.1}


@pytest.mark.parametrize(
    "wrong",
    [
        {"completeness": 1.01},
        {"good_share": -0.1},
        {"force_n": -1e-9},
        {"z_rmse_um": 0.0},
        {"sigma_z_median_um": 0.0},
        {"sphere_1_radius_mm": -3.0},
        {"object_radius_1_mm": float("inf")},
        {"z_p95_um": float("nan")},
        {"depth_mm": 1e8},
    ],
    ids=str,
)
def test_a_figure_that_no_measurement_has_is_absurd(wrong):
    assert absurd(SOUND) == ""
    assert next(iter(wrong)) in absurd(SOUND | wrong)


def test_a_measurement_without_a_point_has_no_error():
    assert absurd(SOUND | {"points": 0, "z_rmse_um": 0.0}) == ""


def test_a_seed_draws_the_same_case_again():
    base, settings = drawn_case(7)
    assert drawn_case(7) == (base, settings)
    assert drawn_case(8) != (base, settings)
