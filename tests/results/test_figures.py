"""Figures of a measurement: numbers by type, and no number where there is none."""

import pytest

from reconstruction.errors import InputError
from twin.results.figures import Figures, warnings_of, why_absent

METRICS = {
    "points": 0,
    "lit_pixels": 12,
    "z_rmse_um": None,
    "force_n": 3.5,
    "mechanics_model": "sheet",
    "warnings": ["too steep"],
}


def test_words_are_no_figures():
    figures = Figures(METRICS)
    assert set(figures) == {"points", "lit_pixels", "z_rmse_um", "force_n"}
    assert (figures.known("force_n"), figures["z_rmse_um"]) == (3.5, None)
    assert warnings_of(METRICS) == ("too steep",)
    assert warnings_of({}) == ()


def test_what_does_not_exist_is_no_number():
    """None is left out of sums and sorting; `known` raises an error with the reason."""
    figures = Figures(METRICS)
    with pytest.raises(InputError, match="z_rmse_um: found none, no valid point"):
        figures.known("z_rmse_um")
    with pytest.raises(InputError, match="rod_width_mm: found none"):
        figures.known("rod_width_mm")
    with pytest.raises(TypeError):
        min([figures["z_rmse_um"], 1.0])
    assert why_absent(figures) == "no valid point"


def test_an_unknown_name_is_a_key_error_that_lists_the_names():
    figures = Figures(METRICS)
    with pytest.raises(KeyError) as caught:
        figures["z_rms_um"]
    names = "points, lit_pixels, z_rmse_um, force_n"
    expected = f"z_rms_um: no such figure, did you mean z_rmse_um; there are {names}"
    assert str(caught.value) == expected
    assert "z_rms_um" not in figures
    assert figures.get("z_rms_um") is None


def test_a_figure_of_the_object_says_what_adds_it():
    adds = r"twin\.with_compensation\(measurement\) adds"
    with pytest.raises(KeyError, match=adds):
        Figures(METRICS)["compensated_sphere_1_radius_mm"]
    with_object = Figures(METRICS | {"compensated_force_n": 1.0})
    with pytest.raises(KeyError, match="compensated_depth_mm: no such figure") as caught:
        with_object["compensated_depth_mm"]
    assert "with_compensation" not in str(caught.value)


def test_equal_numbers_are_equal_whatever_the_words():
    assert Figures(METRICS) == Figures(METRICS | {"mechanics_model": "spectral"})
    assert Figures(METRICS) != Figures(METRICS | {"force_n": 4.0})
