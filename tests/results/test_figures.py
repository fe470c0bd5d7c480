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
    """None adds to nothing, sorts nowhere, and who insists is told why there is none."""
    figures = Figures(METRICS)
    with pytest.raises(InputError, match="z_rmse_um: found none, no valid point"):
        figures.known("z_rmse_um")
    with pytest.raises(InputError, match="rod_width_mm: found none"):
        figures.known("rod_width_mm")
    with pytest.raises(TypeError):
        min([figures["z_rmse_um"], 1.0])
    assert why_absent(figures) == "no valid point"


def test_equal_numbers_are_equal_whatever_the_words():
    assert Figures(METRICS) == Figures(METRICS | {"mechanics_model": "spectral"})
    assert Figures(METRICS) != Figures(METRICS | {"force_n": 4.0})
