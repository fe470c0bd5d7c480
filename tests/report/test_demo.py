"""The demo's page: what works first, then where it ends, under names of its own."""

import shutil
from dataclasses import replace

import pytest

from tests.browser import assert_readable
from twin.cli import run
from twin.config import vary
from twin.report.demo import LIMITS_FOLDER, demo_page, is_demo, limits_in_words, write_demo
from twin.results.folder import read_measurement


@pytest.fixture(scope="module")
def demo(finished, tmp_path_factory):
    """The folder of a demo: one measurement stands for both."""
    folder = tmp_path_factory.mktemp("demo") / "out"
    shutil.copytree(finished, folder)
    shutil.copytree(finished, folder / LIMITS_FOLDER)
    assert run(["report", str(folder)]) == 0
    return folder


def test_what_works_stands_first_and_where_it_ends_behind(demo):
    both = read_measurement(demo), read_measurement(demo / LIMITS_FOLDER)
    page = demo_page(*both)
    names = [section.name for section in page.sections]
    assert names[0] == "object"
    assert names[-2:] == ["limits_object", "appendix"]
    assert len(set(names)) == len(names)
    assert page.sections[-2].title == "Where it ends: the object"


def test_both_cases_are_told_with_their_own_figures(finished):
    thin = read_measurement(finished)
    thick = replace(
        thin,
        experiment=vary(thin.experiment, {"elastomer.thickness_mm": 4.5}),
        metrics={**thin.metrics, "object_rms_um": 123.4, "object_coverage_share": 0.25},
    )
    told = limits_in_words(thin, thick)
    assert "through 4.5 mm: 25 % of the object is touched" in told
    assert "deviates there by 123 µm RMS" in told
    assert f"{thin.figures.known('object_rms_um'):.0f} µm RMS" in told.partition("Through")[2]


def test_it_is_drawn_again_the_same(demo):
    assert is_demo(demo)
    assert not is_demo(demo / LIMITS_FOLDER)
    before = (demo / "report.html").read_bytes()
    assert b"Where it ends" in before
    (demo / "again").mkdir()
    assert write_demo(demo, into=demo / "again").read_bytes() == before


def test_a_browser_opens_it(demo, tmp_path):
    assert_readable(demo / "report.html", tmp_path)
