"""The page of the reproduction: complete, self-contained, and readable in a browser."""

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from imageio.v3 import imwrite

from tests.browser import assert_readable
from tests.paper.test_tables import colour_trials, fringe_trials
from twin.config import load_experiment
from twin.paper.claims import claims_of, claims_table
from twin.paper.identified import decisions_table, fields_table
from twin.paper.page import SECTIONS, Contents, write_paper_page
from twin.paper.plan import CONTACT_FPP, GELSIGHT
from twin.paper.rod_table import hardness_table
from twin.paper.sphere_tables import repeated_fit_table, sphere_fit_table, uncertainty_table
from twin.paper.trials import inputs

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser")


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Path:
    """A page with the tables on the balls, the claims and one picture."""
    folder = tmp_path_factory.mktemp("page")
    trials = {GELSIGHT: colour_trials(0.05), CONTACT_FPP: fringe_trials()}
    makers = (sphere_fit_table, repeated_fit_table, uncertainty_table)
    tables = {table.name: table for table in (*(make(trials) for make in makers), hardness_table())}
    tables["claims"] = claims_table(claims_of(tables))
    tables["identified_fields"] = fields_table()
    tables["identified_decisions"] = replace(decisions_table(), rows=())
    (folder / "figures").mkdir()
    picture = folder / "figures" / "hardness.png"
    imwrite(picture, np.full((40, 60, 3), 200, np.uint8))
    experiment = load_experiment("paper/two_balls")
    contents = Contents(tables, {"hardness"}, experiment, inputs(), 6)
    return write_paper_page(folder, contents)


def test_the_page_is_self_contained(page):
    text = page.read_text(encoding="utf-8")
    assert not re.findall(r'(?:src|href)="(?!data:|#)', text)
    assert "url(" not in text
    assert "<script" not in text


def test_the_page_has_the_papers_and_the_twins_numbers(page):
    """Mean radius of the paper's contact-FPP, ball 1, and of five known trials (4.002)."""
    text = page.read_text(encoding="utf-8")
    assert "3.835" in text
    assert "4.002" in text


def test_a_table_without_rows_is_left_out(page):
    text = page.read_text(encoding="utf-8")
    assert fields_table().title in text
    assert decisions_table().title not in text


def test_a_missed_target_is_reported_in_words(page):
    """Not by the colour of its card only."""
    assert "<li>missed: GelSight: RMSE of the sphere fit" in page.read_text(encoding="utf-8")


def test_the_badge_states_how_many_figures_were_fitted(page):
    text = page.read_text(encoding="utf-8")
    met = re.search(r"(\d+) of \d+ figures meet their targets, (.*) assumed limits", text)
    assert met is not None
    assert met[2].startswith("1 of them fitted and ")
    assert "assumed limits, 0 steered a choice" in text
    reasons = re.findall(r"<li>(\d+) of \d+ (?:compared|limits)", text)
    assert int(met[1]) == sum(map(int, reasons))
    assert "<li>1 of 5 compared with rows from which the sensor was identified (fitted)" in text


def test_assumptions_are_marked_with_their_source(page):
    text = page.read_text(encoding="utf-8")
    assert '<tr class="assumed"><th scope="row" class="code">projector.pose.polar_deg' in text
    assert "identified: paper, from the rows" in text
    assert " joint samples, " in text
    assert "placed by hand against a mark on the stage" in text


def test_values_that_were_chosen_for_one_table_are_named(page):
    """Pose of the camera, GelSight's region; and the problem that is not solved yet."""
    text = page.read_text(encoding="utf-8")
    assert "Two of its values were chosen for one table each" in text
    assert "chosen so that the bare nut fails as the text states (280)" in text
    assert "twin identify paper/identify_next -o DIR" in text


def test_every_table_has_one_section():
    """Every table of a complete run is on the page."""
    placed = [name for section in SECTIONS for name in section.tables]
    assert len(placed) == len(set(placed))
    assert {"claims", "rods", "sphere_fit", "repeated_fit", "uncertainty"} <= set(placed)


@pytest.fixture(scope="module")
def browse(tmp_path_factory):
    """Run the browser on an address; skip where there is none, or none that starts here."""
    profile = tmp_path_factory.mktemp("profile")

    def run(target: str, address: str, width: int = 1200) -> str:
        line = [
            BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
            "--disable-background-networking", "--enable-logging=stderr",
            f"--user-data-dir={profile}", f"--window-size={width},1000", target, address,
        ]  # fmt: skip
        done = subprocess.run(line, capture_output=True, text=True, timeout=120, check=True)
        return done.stderr

    if BROWSER is None:
        pytest.skip("no chromium on this machine")
    try:
        run(f"--screenshot={profile / 'blank.png'}", "about:blank")
    except (OSError, subprocess.SubprocessError) as error:
        pytest.skip(f"chromium does not start here: {error}")
    return run


@pytest.mark.parametrize("width", [1200, 390])
def test_a_browser_opens_and_prints_it(page, tmp_path, browse, width):
    """No error on the console, at desktop and phone width; the print has pages."""
    pdf, shot = tmp_path / "page.pdf", tmp_path / "page.png"
    for target in (f"--screenshot={shot}", f"--print-to-pdf={pdf}"):
        assert "CONSOLE" not in browse(target, page.as_uri(), width)
    assert shot.stat().st_size > 10_000
    assert pdf.read_bytes()[:5] == b"%PDF-"


def test_no_element_exceeds_the_page_at_any_width(page, tmp_path):
    assert_readable(page, tmp_path)
