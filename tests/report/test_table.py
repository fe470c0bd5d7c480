import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from reconstruction.errors import InputError
from twin.config import vary
from twin.report.contact import discussion, pitch_kept_mm, verdicts
from twin.report.measurement import summary_table
from twin.report.press import judge_press
from twin.report.spheres import fit_table
from twin.report.table import Column, Table
from twin.report.words import signed
from twin.results.folder import read_measurement


def _cells(line):
    return [float(cell) for cell in line.split()[-5:]]


def test_measured_rows_are_those_of_the_result_file(finished):
    figures = json.loads((finished / "result.json").read_text())["metrics"]
    lines = summary_table(read_measurement(finished)).splitlines()
    measured = [line for line in lines if line.startswith("ball") and "measured" in line]
    names = ("radius", "abs_radius_error", "rmse", "mae", "p95")
    for ball, line in enumerate(measured, start=1):
        expected = [figures[f"sphere_{ball}_{name}_mm"] for name in names]
        np.testing.assert_allclose(_cells(line), expected, atol=0.00051)
    assert len(measured) == 2


def test_rows_hold_full_precision(finished):
    figures = json.loads((finished / "result.json").read_text())["metrics"]
    scored = read_measurement(finished)
    assert [sphere.number for sphere in scored.score.spheres] == [1, 2]
    table = fit_table(scored)
    for sphere in scored.score.spheres:
        ball = sphere.number
        measured = table.row(ball=f"ball {ball}", surface="measured coat")
        true_coat = table.row(ball=f"ball {ball}", surface="true coat")
        assert measured["radius"] == pytest.approx(figures[f"sphere_{ball}_radius_mm"], rel=1e-9)
        assert measured["p95"] == pytest.approx(figures[f"sphere_{ball}_p95_mm"], rel=1e-9)
        radius_mm = figures[f"sphere_{ball}_true_face_radius_mm"]
        assert true_coat["radius"] == pytest.approx(radius_mm, rel=1e-9)


def test_table_fits_a_terminal_and_tells_the_rest(finished):
    table = summary_table(read_measurement(finished))
    figures = json.loads((finished / "result.json").read_text())["metrics"]
    assert all(len(line) <= 100 for line in table.splitlines())
    assert f"{figures['z_rmse_um']:.2f} um RMS" in table
    assert f"{figures['completeness']:.1%}" in table
    assert f"{figures['wrong_order_pixels']} wrong fringe orders" in table
    assert f"force {figures['force_n']:.3g} N" in table


def test_warnings_are_printed_themselves(finished):
    """With --no-report there is no page with the warnings, to which the terminal referred."""
    scored = read_measurement(finished)
    texts = ["the contact is 3 cells wide: " + "use finer cells, " * 9, "second"]
    table = summary_table(replace(scored, metrics={**scored.metrics, "warnings": texts}))
    words = " ".join(table.split())
    assert all(f"warning: {text}" in words for text in texts)
    assert "report" not in words
    assert all(len(line) <= 100 for line in table.splitlines())


def test_what_is_no_result_is_refused(finished, tmp_path):
    with pytest.raises(InputError, match="no finished result"):
        read_measurement(tmp_path)
    folder = tmp_path / "result"
    shutil.copytree(finished, folder)
    (folder / "truth.nc").unlink()
    with pytest.raises(InputError, match=r"truth\.nc"):
        read_measurement(folder)


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


def test_verdicts_follow_the_figures(finished):
    scored = read_measurement(finished)
    sensor, press = verdicts(scored)
    assert sensor.grade != "poor"
    wrong = replace(scored, metrics={**scored.metrics, "wrong_order_pixels": 3})
    assert verdicts(wrong)[0].grade == "poor"
    assert "3 wrong fringe orders" in verdicts(wrong)[0].reasons[0]
    assert press.grade == ("check" if scored.warnings else "good")


def test_discussion_of_a_thin_sheet_tells_of_stretch_and_not_of_the_slab(finished):
    scored = read_measurement(finished)
    sheet = {"mechanics_model": "sheet", "largest_stretch": 1.234}
    sheet |= {"thinnest_mm": 0.1567, "steepest_deg": 61.2}
    wrapped = replace(scored, metrics={**scored.metrics, **sheet})
    text = " ".join(discussion(wrapped))
    assert "largest stretch is 1.23, the smallest thickness 0.157 mm" in text
    assert "low-pass" in " ".join(discussion(scored))
    assert "low-pass filter: T(q)" not in text
    assert "shear through the thickness" in judge_press(wrapped).reasons[0]
    assert "large strain" in judge_press(scored).reasons[0]


def test_a_table_says_the_same_as_html_markdown_text_and_json():
    """Two rows of one ball: numbers by the column's digits, a dash where there is none."""
    columns = (Column("ball", "ball"), Column("by", "by"), Column("radius", "radius", 2, "mm"))
    rows = ({"ball": "ball 1", "by": "a", "radius": 4.0049}, {"ball": "ball 1", "by": "b"})
    table = Table("t", "Title", "", columns, rows, ("a note",), group="ball")
    assert [head.text for head in table.heads()] == ["ball", "by", "radius (mm)"]
    (body,) = table.bodies()
    assert [[(cell.text, cell.span) for cell in line.cells] for line in body] == [
        [("ball 1", 2), ("a", 1), ("4.00", 1)],
        [("ball 1", 0), ("b", 1), ("–", 1)],
    ]
    assert "| ball 1 | a | 4.00 |" in table.as_markdown()
    assert table.as_text().splitlines()[1] == "ball 1  a          4.00"
    assert table.as_json()["rows"][0]["radius"] == 4.0049
    with pytest.raises(KeyError, match="no row with"):
        table.row(by="c")


def test_a_coat_on_the_touching_face_is_not_a_slab_that_filters(finished):
    """The page of a gel on a window spoke of a low-pass filter and of a free span that bends."""
    scored = read_measurement(finished)
    on_window = vary(scored.experiment, {"elastomer.layout": "contact_face"})
    text = " ".join(discussion(replace(scored, experiment=on_window)))
    assert "has the shape of the ball" in text
    assert "low-pass" not in text
    assert "free span" not in text


def test_what_rounds_to_nothing_has_no_sign_of_its_own():
    assert [signed(value) for value in (-0.0001, 0.0, -0.001)] == ["+0.000", "+0.000", "−0.001"]
