"""Tables on the differences to the paper: their notes agree with their rows."""

import pytest

from twin.config import load_experiment, vary
from twin.paper.explanations import decoder_table, height_scale_table, nut_table, region_table
from twin.paper.trials import Trial

COARSE = {"press.solver_pitch_mm": 0.15, "press.relief_pitch_mm": 0.05}


@pytest.fixture(scope="module")
def balls():
    return load_experiment("examples/slab_balls", COARSE)


def test_scaled_heights_against_the_curvature_at_the_apex():
    """A narrow cap z = s sqrt(R^2 - r^2) has the radius R / s."""
    table = height_scale_table(0.2)
    for row in table.rows:
        scale = float(str(row["value"]).split()[0])
        assert row["radius"] == pytest.approx(4.0 / scale, rel=2e-3)


def test_the_region_changes_both_fits_by_the_texture(balls):
    """Texture reduces the algebraic radius by 12 sigma^2 / S^2: within 0.8 mm, not within 4 mm."""
    gaps = []
    for texture in (None, {"rms_um": 13.0, "correlation_mm": 0.2}):
        table = region_table(vary(balls, {"coating.texture": texture}))
        gaps.append([row["geometric"] - row["algebraic"] for row in table.rows])
    added = [rough - smooth for smooth, rough in zip(*gaps, strict=True)]
    assert added[0] > 2 * added[2] > 0
    assert abs(added[-1]) < 0.05 * added[0]
    note = f"{gaps[1][0]:.2f} mm smaller within 0.8 mm"
    assert note in table.notes[0]


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
        "the paper reports 139 um: no decoder is within a factor of two."
    )


def test_the_note_on_the_nut_lists_shares_by_the_cameras_tilt():
    shares = {(0.0, 0.05): [0.8, 0.9], (0.0, 0.2): [0.9, 0.9], (12.5, 0.05): [0.4, 0.5]}
    table = nut_table(shares)
    assert "80% to 90% at 0 deg; 40% to 40% at 12.5 deg" in table.notes[0]
    assert table.row(tilt=12.5)["good"] == 0.4
