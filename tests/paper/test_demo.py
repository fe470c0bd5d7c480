"""The paper's balls, nut and brick by the identified sensor: one page, redrawn with equal bytes."""

from dataclasses import replace

import pytest

from reconstruction.reading import read_json
from tests.browser import assert_readable
from twin.cli import run
from twin.paper.demo import FURTHER, is_demo, paper_table
from twin.paper.plan import COARSE, Resolution
from twin.report.measurement import page_of
from twin.results.folder import read_measurement

SMALL = {
    "camera.binning": 4,
    "camera.width_px": 968,
    "camera.height_px": 732,
    "press.cell_mm": 0.5,
    "elastomer.thickness_mm": 0.145,
    "press.depth_mm": 0.35,
}


def page_without_pictures_of_the_balls(balls):
    """The first and the last section: the others are those of every measurement (tests/report)."""
    page = page_of(balls)
    return replace(page, sections=[page.sections[0], page.sections[-1]])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("twin.paper.demo.page_of", page_without_pictures_of_the_balls)
        patch.setattr("twin.paper.plan.COARSE", Resolution({**COARSE.settings, **SMALL}, {}))
        patch.setattr("twin.paper.demo.default_count", lambda: 1)  # no processes to start
        out = tmp_path_factory.mktemp("demo") / "out"
        assert run(["demo", "-o", str(out)]) == 0
        yield out


def test_the_folder_has_all_measurements_and_their_page(folder):
    assert is_demo(folder)
    assert not is_demo(folder / FURTHER[0])
    assert read_json(folder / "result.json")["command"] == "demo"
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "True object, paper and twin" in page
    for name in FURTHER:
        assert (folder / "figures" / f"{name}_relief.png").is_file()


def test_the_table_compares_true_object_paper_and_twin(folder):
    balls = read_measurement(folder)
    further = [read_measurement(folder / name) for name in FURTHER]
    rows = {row["quantity"]: row for row in paper_table(balls, further).rows}
    # The first row is the radius of the object, with its uncertainty.
    assert next(iter(rows)) == "ball 1: radius of the object, ± U (k = 2)"
    first = rows["ball 1: radius of the coat, as the paper evaluates"]
    # Table of repeated fits: 3.835 mm, SD 0.052; the balls are 8 mm wide.
    assert first["true"] == 4.0
    assert first["paper"] == "3.835 ± 0.052"
    assert first["twin"] == balls.metrics["sphere_1_algebraic_radius_mm"]
    assert rows["ball 2: RMSE of the fit's residuals"]["paper"] == "12.0"
    assert rows["ball 2: P95 of the fit's residuals"]["paper"] == "20.9"
    for measured in further:
        row = rows[f"{measured.experiment.name}: deviation where the sheet touches it, RMS"]
        assert row["twin"] == measured.metrics["object_rms_um"] > 0.0


def test_the_report_command_draws_the_same_page(folder):
    before = (folder / "report.html").read_bytes()
    assert run(["report", str(folder)]) == 0
    assert (folder / "report.html").read_bytes() == before


def test_a_browser_opens_it(folder, tmp_path):
    assert_readable(folder / "report.html", tmp_path)
