"""Explanations: their notes follow from their rows."""

import pytest

from twin.config import load_experiment
from twin.paper.explanations import (
    decoder_table,
    height_scale_table,
    layout_table,
    nut_table,
    region_table,
    rod_layout_table,
    scale_table,
    varied,
)
from twin.paper.trials import Trial

COARSE = {"press.solver_pitch_mm": 0.15, "press.relief_pitch_mm": 0.05}


@pytest.fixture(scope="module")
def balls():
    return load_experiment("paper/two_balls", COARSE)


def test_scaled_heights_against_the_curvature_at_the_apex():
    """A narrow cap z = s sqrt(R^2 - r^2) has the radius R / s."""
    table = height_scale_table(0.2)
    for row in table.rows:
        scale = float(str(row["value"]).split()[0])
        assert row["radius"] == pytest.approx(4.0 / scale, rel=2e-3)


def test_lengths_scale_the_radius(balls):
    table = scale_table(balls)
    assert table.row(value="1.1 x")["radius"] == pytest.approx(
        1.1 * float(table.row(value="1 x")["radius"])
    )


def test_notes_state_what_the_rows_say(balls):
    region = region_table(balls)
    change = region.rows[-1]["radius"] - region.rows[0]["radius"]
    assert f"{change:+.1f} mm" in region.notes[0]
    layout = layout_table(balls)
    assert f"{layout.rows[1]['radius']:.2f} mm" in layout.notes[0]


def test_what_cannot_be_pressed_is_a_row_with_its_reason(balls):
    """A travel beyond the slab's thickness is no reason to lose the other rows."""
    table = varied(balls, "travel", "press.depth_mm", (0.5, 50.0), "mm")
    assert "radius" not in table.rows[1]
    assert "depth_mm" in str(table.rows[1]["note"])
    assert "mm; the paper reports" in table.notes[0]


def test_rods_on_either_face():
    rods = {"rods_a": load_experiment("paper/rods_a", COARSE)}
    table = rod_layout_table(rods)
    assert table.row(value="rods_a, clear face touched")["width"] > 5.0
    assert table.row(value="rods_a, coat touched")["width"] < 2.5
    assert "coat touched" in table.notes[0]


def test_decoders_are_averaged_over_balls_and_trials():
    """Two balls of 10 and 30 um in trial 1; trial 0 is no repetition."""
    name = "table_sdk_2024_sphere_{}_{}_mm"
    figures = {name.format(ball, "rmse"): 0.02 * ball - 0.01 for ball in (1, 2)}
    figures |= {name.format(ball, "radius"): 3.0 for ball in (1, 2)}
    wrong = dict.fromkeys(figures, 9.0)
    table = decoder_table([Trial(0, wrong), Trial(1, figures)])
    (row,) = table.rows
    assert row["decoder"] == "look-up table, sdk_2024"
    assert row["rmse_um"] == pytest.approx(20.0)
    assert table.notes[0].endswith(
        "the paper reports 139 um: no decoder comes within a factor of two."
    )


def test_the_nut_says_where_the_bar_is_met():
    mixed = nut_table({"0.05": [0.5, 0.6], "0.2": [0.8, 0.9]})
    assert "50% to 80%" in mixed.notes[0]
    assert "is met not at all of them" in mixed.notes[0]
    assert "is met at none of them" in nut_table({"0.1": [0.7, 0.8]}).notes[0]
