"""Hardness to modulus against the published formulas' tabulated values."""

import pytest

from reconstruction.errors import InputError
from twin.config.models import Elastomer
from twin.mechanics import estimate_modulus, young_modulus
from twin.mechanics.hardness import gent_modulus_kpa, qi_modulus_kpa


@pytest.mark.parametrize(
    ("shore_a", "gent_kpa", "qi_kpa"),
    [(5, 278, 300), (10, 413, 393), (15, 563, 515), (20, 732, 676), (30, 1140, 1160)],
)
def test_formulas_give_the_tabulated_moduli(shore_a: int, gent_kpa: int, qi_kpa: int) -> None:
    # 0.4 %: the table is rounded to three digits.
    assert gent_modulus_kpa(shore_a) == pytest.approx(gent_kpa, rel=4e-3)
    assert qi_modulus_kpa(shore_a) == pytest.approx(qi_kpa, rel=4e-3)


@pytest.mark.parametrize("shore_a", [0, 5, 10, 20, 40, 60, 80, 95])
def test_best_lies_within_the_range_and_grows(shore_a: int) -> None:
    estimate = estimate_modulus(shore_a)
    assert estimate.low_kpa < estimate.best_kpa <= estimate.high_kpa
    assert estimate.extrapolated == (not 20 <= shore_a <= 80)
    if shore_a > 0:
        assert estimate.best_kpa > estimate_modulus(shore_a - 1).best_kpa


def test_soft_range_holds_the_data_sheets_of_cast_silicones() -> None:
    # Dragon Skin 10 and Solaris (15 A), 3 / 1.75 of the 100 % modulus.
    for shore_a, sheet_kpa in ((10, 260), (15, 300)):
        estimate = estimate_modulus(shore_a)
        assert estimate.low_kpa <= sheet_kpa <= estimate.high_kpa


def test_given_modulus_wins() -> None:
    elastomer = Elastomer(
        thickness_mm=2,
        length_x_mm=20,
        length_y_mm=20,
        shore_a=30,
        young_modulus_kpa=123.0,
        poisson_ratio=0.49,
    )
    assert young_modulus(elastomer).best_kpa == 123.0
    free = elastomer.model_copy(update={"young_modulus_kpa": None})
    assert young_modulus(free) == estimate_modulus(30)


@pytest.mark.parametrize("shore_a", [-1.0, 96.0, float("nan")])
def test_impossible_hardness_is_refused(shore_a: float) -> None:
    with pytest.raises(InputError, match="allowed: 0 to 95"):
        estimate_modulus(shore_a)
