"""Hardness to modulus against the published formulas' tabulated values."""

import tomllib

import pytest
from pydantic import ValidationError

from reconstruction.errors import InputError
from twin.assets import asset_path
from twin.config.models import Elastomer, Press
from twin.mechanics import (
    calibrate_modulus,
    estimate_modulus,
    estimate_modulus_00,
    press,
    young_modulus,
)
from twin.mechanics.hardness import (
    bs_903_modulus_kpa,
    gent_modulus_kpa,
    qi_modulus_kpa,
    sneddon_modulus_kpa,
)
from twin.specimens.kinds.ball import Ball


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


@pytest.mark.parametrize(("shore_00", "kpa"), [(10, 54), (30, 121), (50, 265)])
def test_shore_00_is_sneddons_sphere(shore_00: int, kpa: int) -> None:
    assert sneddon_modulus_kpa(shore_00) == pytest.approx(kpa, abs=0.6)


def test_shore_00_range_holds_the_data_sheets() -> None:
    # Ecoflex 00-30 and 00-50, 3 / 1.75 of the 100 % modulus: the second is below.
    estimate = estimate_modulus_00(30)
    assert estimate.low_kpa < 118 < estimate.high_kpa
    assert estimate.low_kpa < estimate.best_kpa < estimate.high_kpa
    assert estimate_modulus_00(50).low_kpa < 0.62 * estimate_modulus_00(50).best_kpa


@pytest.mark.parametrize(("shore_a", "kpa"), [(40, 1355), (60, 3489)])
def test_bs_903_where_it_holds(shore_a: int, kpa: int) -> None:
    assert bs_903_modulus_kpa(shore_a) == pytest.approx(kpa, rel=1e-3)


def test_bs_903_is_refused_below_its_range() -> None:
    with pytest.raises(InputError, match="Shore A 20, allowed: 40 to 95"):
        bs_903_modulus_kpa(20)


@pytest.mark.parametrize("mix", ["silicone_a", "silicone_b", "silicone_c"])
def test_the_papers_mixes_have_a_modulus_with_a_wide_range(mix: str) -> None:
    path = asset_path("materials", f"elastomers/{mix}")
    table = tomllib.loads(path.read_text())
    for quantity in (table["shore_a"], table["poisson_ratio"], table["density_kg_m3"]):
        low, high = quantity["range"]
        assert low <= quantity["value"] <= high
        assert quantity["source"]
    estimate = estimate_modulus(table["shore_a"]["value"])
    assert estimate.high_kpa > 1.5 * estimate.low_kpa


def test_one_press_calibrates_the_modulus() -> None:
    slab = Elastomer(
        thickness_mm=4, length_x_mm=20, length_y_mm=20, shore_00=30, poisson_ratio=0.49
    )
    load = Press(control="depth", depth_mm=0.6, solver_pitch_mm=0.25, relief_pitch_mm=0.05)
    guessed = press(Ball(), slab, load)
    assert guessed.young_modulus_kpa == pytest.approx(121, abs=1)
    actual = slab.model_copy(update={"young_modulus_kpa": 205.0})
    measured = press(Ball(), actual, load).force_n
    result = calibrate_modulus(measured, guessed)
    assert result.best_kpa == pytest.approx(205, rel=1e-6)
    assert 0.85 * 205 < result.low_kpa < result.best_kpa < result.high_kpa < 1.15 * 205
    with pytest.raises(InputError, match="allowed: more than 0"):
        calibrate_modulus(0.0, guessed)


def test_an_elastomer_needs_exactly_one_way_to_its_modulus() -> None:
    size = {"thickness_mm": 4, "length_x_mm": 20, "length_y_mm": 20, "poisson_ratio": 0.49}
    with pytest.raises(ValidationError, match="needs shore_a, shore_00 or young_modulus_kpa"):
        Elastomer.model_validate(size)
    with pytest.raises(ValidationError, match="not both"):
        Elastomer.model_validate(size | {"shore_a": 10, "shore_00": 40})
