"""Figures that follow from a case's description and its result, against their closed forms."""

import math

import pytest

from twin.config import load_experiment, vary
from twin.mechanics.contact_transfer import Ridges
from twin.study.derived import with_derived

BALL = {"specimen": {"kind": "ball", "diameter_mm": 8.0}, "elastomer.thickness_mm": 3.0}
GRATING = {"specimen": {"kind": "grating", "pitch_mm": 7.19, "groove_mm": 0.2}}


@pytest.fixture(scope="module")
def paper():
    return load_experiment("examples/slab_balls")


def test_of_a_press(paper):
    ball = vary(paper, BALL)
    figures = {"depth_mm": 0.6, "force_n": 0.3, "sphere_1_true_face_radius_mm": 80.0}
    result = with_derived(ball, figures)
    assert result["depth_over_thickness"] == pytest.approx(0.2)
    assert result["force_per_depth_n_per_mm"] == pytest.approx(0.5)
    assert result["radius_bias_mm"] == pytest.approx(76.0)
    assert result["half_contrast_pitch_mm"] == pytest.approx(2.40 * 3, rel=0.01)
    assert result["tenth_contrast_pitch_mm"] == pytest.approx(1.32 * 3, rel=0.01)
    assert "groove_contrast_kept" not in result


def test_of_grooves(paper):
    """At the pitch of half contrast half is kept; a sine of that height over an RMS error."""
    groove = vary(paper, GRATING | {"elastomer.thickness_mm": 3.0})
    result = with_derived(groove, {"z_rmse_um": 0.5})
    assert result["groove_contrast_kept"] == pytest.approx(0.5, abs=1e-3)
    assert result["groove_over_error"] == pytest.approx(50 / math.sqrt(2) / 0.5, rel=2e-3)
    assert "groove_over_error" not in with_derived(groove, {"z_rmse_um": 0.0})
    assert "depth_over_thickness" not in result


def test_a_gel_on_a_window_has_full_contrast(paper):
    gel = vary(load_experiment("examples/gelsight_ball"), GRATING)
    result = with_derived(gel, {})
    assert result["groove_contrast_kept"] == 1.0
    assert result["half_contrast_pitch_mm"] == 0.0


def test_of_a_thin_sheet_pressure_and_hardness_count(paper):
    """Groove contrast of a grating, and the pitch with 50 % contrast, are those of `Ridges`."""
    thin = {"elastomer.thickness_mm": {"value": 0.2, "source": "test"}}
    groove = vary(paper, GRATING | thin | {"press.back_pressure_kpa": 3.0})
    fine = vary(groove, {"specimen.pitch_mm": 1.0})
    figures = {"mechanics_model": "sheet", "z_rmse_um": 1.0}
    result = with_derived(fine, figures)
    ridges = Ridges(fine.elastomer, 3.0, 0.2)
    assert result["groove_contrast_kept"] == ridges.shown(1.0)
    assert 0.1 < result["groove_contrast_kept"] < 0.3
    assert ridges.shown(result["half_contrast_pitch_mm"]) == pytest.approx(0.5, abs=1e-3)
    free = with_derived(vary(fine, {"press.back_pressure_kpa": 0.0}), figures)
    assert "half_contrast_pitch_mm" not in free
    assert "groove_contrast_kept" not in free


def test_only_the_wanted_figures_are_derived(paper):
    figures = {"depth_mm": 0.3, "force_n": 1.5}
    every, some = (with_derived(paper, figures, *a) for a in ((), (["depth_over_thickness"],)))
    assert some == {n: every[n] for n in ("depth_mm", "force_n", "depth_over_thickness")}
    assert every["force_per_depth_n_per_mm"] == pytest.approx(5.0)
