import json
import shutil
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from reconstruction.errors import InputError
from twin.assets import asset_path
from twin.config import vary
from twin.report import summary_table
from twin.report.discussion import discussion, pitch_kept_mm
from twin.report.paper import CONTACT_FPP, GELSIGHT, paper_row
from twin.report.table import ball_rows
from twin.report.verdict import judge_press, verdicts
from twin.results.folder import read_measurement


def _cells(line):
    return [float(cell) for cell in line.split()[-5:]]


def test_measured_rows_are_those_of_the_result_file(finished):
    figures = json.loads((finished / "result.json").read_text())["metrics"]
    lines = summary_table(finished).splitlines()
    measured = [line for line in lines if "measured" in line]
    names = ("radius", "abs_radius_error", "rmse", "mae", "p95")
    for ball, line in enumerate(measured, start=1):
        expected = [figures[f"sphere_{ball}_{name}_mm"] for name in names]
        np.testing.assert_allclose(_cells(line), expected, atol=0.00051)
    assert len(measured) == 2


def test_rows_hold_full_precision(finished):
    figures = json.loads((finished / "result.json").read_text())["metrics"]
    scored = read_measurement(finished)
    assert [sphere.number for sphere in scored.score.spheres] == [1, 2]
    for sphere in scored.score.spheres:
        ball = sphere.number
        measured, true_face = ball_rows(scored, sphere)[:2]
        assert measured.values_mm[0] == pytest.approx(figures[f"sphere_{ball}_radius_mm"], rel=1e-9)
        assert measured.values_mm[4] == pytest.approx(figures[f"sphere_{ball}_p95_mm"], rel=1e-9)
        assert true_face.values_mm[0] == pytest.approx(
            figures[f"sphere_{ball}_true_face_radius_mm"], rel=1e-9
        )


def test_table_fits_a_terminal_and_tells_the_rest(finished):
    table = summary_table(finished)
    figures = json.loads((finished / "result.json").read_text())["metrics"]
    assert all(len(line) <= 100 for line in table.splitlines())
    assert f"{figures['z_rmse_um']:.2f} um RMS" in table
    assert f"{figures['completeness']:.1%}" in table
    assert f"{figures['wrong_order_pixels']} wrong fringe orders" in table
    assert f"force {figures['force_n']:.3g} N" in table


def test_paper_rows_come_from_the_shipped_copy(experiment):
    targets = tomllib.loads(asset_path("scenes", "paper/targets").read_text())
    for published in targets["sphere_fit"]:
        row = paper_row(experiment, published["method"], published["sphere"])
        assert row is not None
        assert row.radius_mm == published["radius"]
        # The table's own arithmetic: |error| is the distance to the 4 mm ball.
        assert row.abs_radius_error_mm == pytest.approx(abs(row.radius_mm - 4.0), abs=6e-4)


def test_paper_is_left_out_for_other_specimens(experiment):
    smaller = vary(experiment, {"specimen.diameter_mm": 6.0})
    assert paper_row(smaller, CONTACT_FPP, 1) is None
    assert paper_row(experiment, GELSIGHT, 3) is None


def test_summary_refuses_what_is_no_result(finished, tmp_path):
    with pytest.raises(InputError, match="no finished result"):
        summary_table(tmp_path)
    folder = tmp_path / "result"
    shutil.copytree(finished, folder)
    (folder / "truth.nc").unlink()
    with pytest.raises(InputError, match=r"truth\.nc"):
        summary_table(folder)


@pytest.mark.parametrize(("share", "pitch_over_thickness"), [(0.5, 2.40), (0.1, 1.32), (0.9, 4.57)])
def test_kept_pitch_is_that_of_the_free_slab(share, pitch_over_thickness):
    """T(q) of notes/mechanics.md: pitches at 90, 50 and 10 % contrast, in thicknesses."""
    assert pitch_kept_mm(share, 2.0) / 2.0 == pytest.approx(pitch_over_thickness, abs=0.006)


def test_discussion_splits_the_radius_error(finished):
    scored = read_measurement(finished)
    text = " ".join(discussion(scored)).replace("−", "-")
    for ball in scored.score.spheres:
        assert f"{ball.true_face.radius_mm - ball.nominal.radius_mm:+.3f} mm" in text
        assert f"{ball.measured.radius_mm - ball.true_face.radius_mm:+.3f} mm" in text
    assert "cannot come from the elastomer" in text


def test_verdicts_follow_the_figures(finished):
    scored = read_measurement(finished)
    sensor, shape, press = verdicts(scored)
    assert sensor.grade != "poor"
    scored.figures["wrong_order_pixels"] = 3
    assert verdicts(scored)[0].grade == "poor"
    assert "3 wrong fringe orders" in verdicts(scored)[0].reasons[0]
    assert press.grade == ("check" if scored.figures["warnings"] else "good")
    assert "mm" in shape.headline


def test_discussion_of_a_thin_sheet_tells_of_stretch_and_not_of_the_slab(finished):
    scored = read_measurement(finished)
    sheet = {"mechanics_model": "sheet", "largest_stretch": 1.234}
    sheet |= {"thinnest_mm": 0.1567, "steepest_deg": 61.2}
    wrapped = replace(scored, figures=scored.figures | sheet)
    text = " ".join(discussion(wrapped))
    assert "stretched up to 1.23 times, 0.157 mm thick where it is thinnest" in text
    assert "low-pass" in " ".join(discussion(scored))
    assert "low-pass filter: T(q)" not in text
    assert "shear through the thickness" in judge_press(wrapped.figures).reasons[0]
    assert "large strain" in judge_press(scored.figures).reasons[0]
