import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from reconstruction.errors import InputError
from tests.browser import PAPER_PX, WIDTHS, assert_page_readable, browser, printed_px
from twin.config import digest, vary
from twin.report.experiment import glance
from twin.report.measurement import write_report
from twin.results.folder import read_measurement

FIGURES = {
    "rig",
    "object",
    "frames",
    "decoding",
    "relief",
    "height_map",
    "truth_error",
    "ball_1",
    "ball_2",
    "fit_regions",
    "press",
}


@pytest.fixture(scope="module")
def tab(tmp_path_factory):
    with browser(tmp_path_factory.mktemp("profile")) as started:
        yield started


@pytest.fixture(scope="module")
def reported(finished, tmp_path_factory):
    folder = tmp_path_factory.mktemp("reported") / "result"
    shutil.copytree(finished, folder)
    progress = []
    path = write_report(folder, lambda stage, fraction: progress.append((stage, fraction)))
    assert path == folder / "report.html"
    return folder, path.read_text(encoding="utf-8"), progress


def test_every_figure_exists_and_is_in_the_page(reported):
    folder, page, _ = reported
    assert {path.stem for path in (folder / "figures").glob("*")} == FIGURES
    assert page.count("data:image/png;base64,") == len(FIGURES)
    for name in FIGURES:
        assert f'id="{name}"' in page


def test_page_needs_nothing_else(reported):
    _, page, _ = reported
    assert len(page) < 6e6
    for target in re.findall(r"""(?:src|href)\s*=\s*["']([^"']{0,40})""", page):
        assert target.startswith(("data:", "#")), target
    assert "url(" not in page
    assert "@import" not in page
    assert set(re.findall("<script[^>]*>", page)) == {
        '<script type="application/json">',  # the view's data
        "<script>",
    }
    assert not re.search(r"fetch\(|XMLHttpRequest|WebSocket|import\(|eval\(", page)


def test_page_tells_result_warnings_and_assumptions(reported, experiment):
    folder, page, _ = reported
    measured = read_measurement(folder)
    assert digest(experiment) in page
    for ball in measured.score.spheres:
        assert f"{ball.measured.radius_mm:.3f}" in page
        assert f"{ball.true_face.stats.p95_mm:.4f}" in page
    assert "paper" not in page.split("<main")[1].split("Appendix")[0]
    for warning in measured.warnings:
        assert warning.replace("'", "&#39;") in page
    foreign = ("stage", "lamps", "photometric")  # sections of other methods are not shown
    origins = [p for n, p in experiment.provenance.items() if n.partition(".")[0] not in foreign]
    assumed = [p for p in origins if p.source.startswith("assumed")]
    assert page.count('<tr class="assumed">') == len(assumed) > 0


def test_a_browser_opens_it(reported, tab):
    assert_page_readable(tab, reported[0] / "report.html")


def test_a_phone_shows_where_a_figure_continues(reported, tab):
    """Expected: each figure that is wider than the page has a hint, each table a shadow."""
    cut = "[...document.querySelectorAll('.scroll')].filter(e => e.scrollWidth > e.clientWidth)"
    tab.open((reported[0] / "report.html").as_uri(), WIDTHS[1])
    hint = "e.querySelector('img') ? getComputedStyle(e, '::before').content"
    shown = f"{hint} : getComputedStyle(e).backgroundImage"
    hints = tab.evaluate(f"{cut}.map(e => {shown})")
    tab.open((reported[0] / "report.html").as_uri(), WIDTHS[0])
    first = "getComputedStyle(document.querySelector('.scroll'), '::before')"
    assert tab.evaluate(f"{first}.content") == "none"
    assert len(hints) > 5
    assert all("scroll" in hint or "linear-gradient" in hint for hint in hints)


def test_its_first_printed_page_is_a_certificate(reported, experiment, tab):
    """Object, measurands, uncertainty, conditions, versions, on one sheet of A4."""
    page = reported[0] / "report.html"
    text = page.read_text(encoding="utf-8")
    alone = text.partition('<section class="certificate">')[2].partition("</section>")[0]
    for text in (
        "Measurands",
        "U: expanded uncertainty",
        "radius 1",
        "mitsuba",
        digest(experiment),
    ):
        assert text in alone, text
    tab.open(page.as_uri())
    shown = "getComputedStyle(document.querySelector('.certificate')).display"
    assert tab.evaluate(shown) == "none"
    assert 0 < printed_px(tab, page, ".certificate") <= PAPER_PX[1]
    assert tab.overflow() == []
    assert tab.evaluate(f"{visible('button, input, canvas, nav, summary')}.length") == 0
    headings = visible("main > section > h2")
    below = "h.parentElement.getBoundingClientRect().bottom - h.getBoundingClientRect().bottom"
    heights_px = tab.evaluate(f"{headings}.map(h => {below})")
    assert len(heights_px) > 5
    assert min(heights_px) > 20
    figures = tab.evaluate(f"{visible('figure img')}.map(f => f.getBoundingClientRect().height)")
    assert max(figures) < PAPER_PX[1] / 2


def visible(selector: str) -> str:
    """Return the expression of the elements that take room on the page."""
    return (
        f"[...document.querySelectorAll('{selector}')]"
        ".filter(one => one.getBoundingClientRect().height > 0)"
    )


def test_progress_grows_to_one(reported):
    _, _, progress = reported
    assert {stage for stage, _ in progress} == {"report"}
    fractions = [fraction for _, fraction in progress]
    assert fractions == sorted(fractions)
    assert (fractions[0], fractions[-1]) == (0.0, 1.0)


@pytest.mark.parametrize(
    "name",
    [
        "result.json",
        "experiment.toml",
        "press.nc",
        "capture/stack.nc",
        "capture/capture.toml",
        "truth.nc",
        "reconstruction.nc",
    ],
)
@pytest.mark.parametrize("harm", ["missing", "truncated"])
def test_damaged_result_is_refused_in_one_line(finished, tmp_path, name, harm):
    folder = tmp_path / "result"
    shutil.copytree(finished, folder)
    victim = folder / name
    if harm == "missing":
        victim.unlink()
    else:
        content = victim.read_bytes()[: victim.stat().st_size // 2]
        if name == "experiment.toml":  # without its later tables the file may be valid
            content = content[: content.rindex(b" = ") + 3]
        victim.write_bytes(content)
    with pytest.raises(InputError) as refusal:
        write_report(folder)
    assert str(folder) in str(refusal.value)
    assert "\n" not in str(refusal.value)
    assert not (folder / "report.html").exists()


def test_result_of_another_command_is_refused(finished, tmp_path):
    folder = tmp_path / "result"
    shutil.copytree(finished, folder)
    text = (folder / "result.json").read_text()
    (folder / "result.json").write_text(text.replace('"measure"', '"press"'))
    with pytest.raises(InputError, match=r"result of command 'press'; .* measure, demo"):
        write_report(folder)


def test_folder_that_is_no_result_is_refused(tmp_path):
    for folder in (tmp_path, tmp_path / "absent"):
        with pytest.raises(InputError, match="no finished result"):
            write_report(folder)


def test_nothing_here_measures():
    """Reports import no module that presses, renders or reconstructs, only those for results."""
    read = {
        "board_calibration",
        "colour_images",
        "colour_presses",
        "comparison",
        "compensation",
        "progress",
        "scan_record",
    }
    for path in (Path(__file__).parents[2] / "twin" / "report").glob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert set(re.findall(r"from twin\.pipeline\.(\w+)", text)) <= read, path.name
        assert "import twin.pipeline" not in text
        assert "from twin.pipeline import" not in text


def test_needs_no_renderer():
    code = "import sys, twin.report; sys.exit(any(m in sys.modules for m in ('mitsuba', 'drjit')))"
    root = Path(__file__).parents[2]
    assert subprocess.run([sys.executable, "-c", code], cwd=root, check=False).returncode == 0


@pytest.mark.parametrize(
    ("patterns", "text"),
    [
        ({"code": "complementary_gray"}, ", complementary Gray code, white"),
        ({"code": "gray"}, ", Gray code, white"),
        ({"code": "shifted_gray"}, ", shifted Gray code, white"),
        ({"code": "hierarchical", "further_periods_px": [120.0, 1920.0]},
         ", hierarchical periods of 120, 1920 px, white"),
        ({"code": "heterodyne", "further_periods_px": [18.25]},
         ", heterodyne periods of 18.25 px, white"),
    ],
)  # fmt: skip
def test_glance_names_the_code(finished, patterns, text):
    scored = read_measurement(finished)
    changed = vary(scored.experiment, {f"patterns.{key}": value for key, value in patterns.items()})
    line = glance(replace(scored, experiment=changed)).row(part="patterns")
    assert text in line["description"]


def test_glance_writes_long_durations_in_seconds_and_depths_without_exponent(finished):
    measured = read_measurement(finished)
    deep = vary(measured.experiment, {"camera.f_number": 64.0, "camera.pose.standoff_mm": 600.0})
    layout = glance(replace(measured, experiment=deep)).row(part="layout")["description"]
    assert re.search(r"depth of field \d{2,3}(\.\d)? mm", layout), layout
    for duration_ms, text in ((17_400.0, "17.4 s"), (9_876.0, "9876 ms")):
        metrics = measured.metrics | {"sequence_ms": duration_ms}
        exposure = glance(replace(measured, metrics=metrics)).row(part="exposure")
        assert f", {text} for all frames" in exposure["description"]
