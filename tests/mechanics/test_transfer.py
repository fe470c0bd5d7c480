"""Transfer functions of the layer against their closed forms."""

import numpy as np
import pytest

from twin.mechanics import PressError, opposite_transfer
from twin.mechanics.transfer import SMALLEST_Q, solve_transfer, tabulate

Q = np.geomspace(SMALLEST_Q, 40, 400)
RATIOS = [0.3, 0.45, 0.49, 0.4999, 0.5]


@pytest.mark.parametrize("nu", RATIOS)
def test_bonded_layer_is_the_closed_form(nu: float) -> None:
    kappa = 3 - 4 * nu
    above = 2 * kappa * np.sinh(2 * Q) - 4 * Q
    below = 2 * kappa * np.cosh(2 * Q) + 4 * Q**2 + 1 + kappa**2
    result = solve_transfer(Q, nu, "bonded")
    np.testing.assert_allclose(result.normal_t, above / below, rtol=1e-6)
    for held in (result.normal_b, result.tangential_b):
        np.testing.assert_allclose(held, 0, atol=1e-12)


@pytest.mark.parametrize("nu", RATIOS)
def test_free_layer_is_the_closed_form_on_both_faces(nu: float) -> None:
    even = (np.cosh(Q) - 1) / (np.sinh(Q) + Q)
    odd = (np.cosh(Q) + 1) / (np.sinh(Q) - Q)
    result = solve_transfer(Q, nu, "free")
    np.testing.assert_allclose(result.normal_t, (odd + even) / 2, rtol=1e-6)
    np.testing.assert_allclose(result.normal_b / result.normal_t, opposite_transfer(Q), rtol=1e-6)


def test_short_waves_see_a_half_space_in_all_components() -> None:
    # Boussinesq: the tangential amplitude is (1 - 2 nu) / (2 (1 - nu)) of the normal one.
    result = solve_transfer(np.array([30.0]), 0.3, "free")
    assert result.normal_t[0] == pytest.approx(1, abs=1e-12)
    assert abs(result.tangential_t[0]) == pytest.approx(0.4 / 1.4, abs=1e-12)


def test_long_waves_bend_a_kirchhoff_plate() -> None:
    # 12 p / (E* h^3 k^4) means Phi = 6 / q^3.
    result = solve_transfer(np.array([SMALLEST_Q]), 0.49, "free")
    assert result.normal_t[0] * SMALLEST_Q**3 / 6 == pytest.approx(1, abs=1e-4)


def test_opposite_face_keeps_what_the_closed_form_says() -> None:
    pitch_over_thickness = np.array([4.57, 2.40, 1.32, 0.85])
    transferred = opposite_transfer(2 * np.pi / pitch_over_thickness)
    # Pitches are rounded to three digits.
    np.testing.assert_allclose(transferred, [0.90, 0.50, 0.10, 0.01], rtol=0.04)


def test_opposite_transfer_is_finite_everywhere() -> None:
    transferred = opposite_transfer(np.array([0.0, 1e-8, 1e-3, 1.0, 50.0, 1e4]))
    np.testing.assert_allclose(transferred[:3], 1, atol=1e-6)
    assert transferred[3] == pytest.approx(
        (np.sinh(1) + np.cosh(1)) / (np.sinh(1) * np.cosh(1) + 1)
    )
    assert np.all(np.diff(transferred) <= 1e-7)
    assert transferred[-1] == 0


@pytest.mark.parametrize("base", ["bonded", "free"])
def test_table_equals_the_solve(base: str) -> None:
    grid = np.random.default_rng(3).uniform(0.05, 44, (40, 50))
    solved = solve_transfer(grid.ravel(), 0.49, base)
    table = tabulate(float(grid.min()), 0.49, base)
    np.testing.assert_allclose(table(grid, "normal_t").ravel(), solved.normal_t, rtol=1e-7)
    np.testing.assert_allclose(table(grid, "normal_b").ravel(), solved.normal_b, rtol=0, atol=1e-7)


def test_a_film_is_refused() -> None:
    with pytest.raises(PressError, match="more than 300 times the thickness"):
        tabulate(1e-3, 0.49, "free")
