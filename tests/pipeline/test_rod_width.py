"""Width of a rod's section from points."""

import numpy as np
import pytest

from reconstruction.errors import FitError
from twin.config import load_experiment
from twin.results.rods import rod_figures, section_of


def crest(width_mm, sag_mm=0.2, pitch_mm=0.02, first_mm=0.0):
    """A trapezoid with flanks of 0.5 mm on ground that rises again beyond its valleys."""
    x, y = np.meshgrid(np.arange(-9 + first_mm, 9, pitch_mm), np.arange(-2, 2, 0.1))
    ramp = np.clip((width_mm / 2 + 0.25 - np.abs(x)) / 0.5, 0, 1)
    rim = sag_mm * np.clip(np.abs(x) - 7, 0, None) / 2
    return np.column_stack([x.ravel(), y.ravel(), (ramp + rim).ravel()])


@pytest.mark.parametrize("width_mm", [1.99, 4.81, 7.23])
def test_width_at_half_height(width_mm):
    """Flanks cross half height at exactly the width; positions are binned by 0.05 mm."""
    assert section_of(crest(width_mm), 2.0, (0.0, 0.0)).width().width_mm == pytest.approx(
        width_mm, abs=0.01
    )


def test_the_section_follows_the_rod():
    moved = crest(3.0) + np.array([0.7, -0.3, 5.0])
    bar = section_of(moved, 2.0, (0.7, -0.3)).width()
    assert bar.width_mm == pytest.approx(3.0, abs=0.01)
    assert bar.height_mm == pytest.approx(1.0, abs=0.02)


def test_no_crest_is_refused():
    x, y = np.meshgrid(np.arange(-9, 9, 0.02), np.arange(-2, 2, 0.1))
    slope = np.column_stack([x.ravel(), y.ravel(), x.ravel()])
    with pytest.raises(FitError):
        section_of(slope, 2.0, (0.0, 0.0)).width()


def test_the_slope_breaks_at_the_upper_edges():
    """Flanks of 0.5 mm: the top is half a millimetre narrower than the width at half height."""
    section = section_of(crest(4.81), 2.0, (0.0, 0.0))
    assert section.break_width().width_mm == pytest.approx(4.81 - 0.5, abs=0.3)
    assert section.slope_change_width().width_mm == pytest.approx(4.81 - 0.5, abs=0.1)


def wrapped(pitch_mm, first_mm):
    """A sheet over a bar of 2 mm: flanks of 2 mm, bent over 0.3 mm at the edge."""
    x, y = np.meshgrid(np.arange(-6 + first_mm, 6, pitch_mm), np.arange(-2, 2, 0.1))
    z = -0.5 * 0.15 * np.logaddexp(0, (np.abs(x) - 1) / 0.15) + 0.1 * np.clip(np.abs(x) - 4, 0, 9)
    return np.column_stack([x.ravel(), y.ravel(), z.ravel()])


@pytest.mark.parametrize("pitch_mm", [0.017, 0.034, 0.041, 0.063])
def test_where_the_slope_breaks_does_not_depend_on_the_pixels(pitch_mm):
    """Columns of any pitch and phase against fine ones."""
    fine = section_of(wrapped(0.002, 0.0), 2.0, (0.0, 0.0)).break_width().width_mm
    widths = [
        section_of(wrapped(pitch_mm, share * pitch_mm), 2.0, (0.0, 0.0)).break_width().width_mm
        for share in np.arange(0.0, 1.0, 0.1)
    ]
    np.testing.assert_allclose(widths, fine, atol=0.01)


def test_a_single_bar_is_read_like_a_rod():
    bar = load_experiment("paper/bars_b")
    assert rod_figures(bar, crest(4.81))["rod_width_mm"] == pytest.approx(4.81, abs=0.01)
    assert rod_figures(load_experiment("paper/bars"), crest(4.81)) == {}
