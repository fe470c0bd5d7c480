"""Direct measurements and comparisons, from the command line to the page."""

import json
import re
import shutil

import numpy as np
import pytest

from reconstruction.arrays import Reason
from reconstruction.errors import InputError
from tests.browser import assert_readable
from twin.cli import run
from twin.config import load_experiment
from twin.pipeline import comparison
from twin.pipeline.comparison import compare, methods_named, read_outcomes
from twin.report.bare import REASON_WORDS, discussion, missing_shares, verdicts
from twin.report.comparison import comparison_table, write_comparison
from twin.report.measurement import summary_table, write_report
from twin.report.pixel_panels import error_um, scored_pixels, true_scale
from twin.report.words import percent, split_unit
from twin.results.folder import read_measurement

# 160 x 120 pixels over the whole field, three phase steps, one sample: seconds, not minutes.
SMALL = {
    "camera.width_px": 640,
    "camera.height_px": 480,
    "camera.pixel_pitch_um": 9.0,
    "camera.binning": 4,
    "patterns.steps": 3,
    "render.samples": 1,
    "render.bounce_paths": 1,
    "render.photons": 200_000,
    "press.solver_pitch_mm": 0.4,
    "press.relief_pitch_mm": 0.05,
}
SETTINGS = [text for key, value in SMALL.items() for text in ("-s", f"{key}={value}")]
FRINGES = ("direct_fpp", "contact_fpp")
BALL = """
name = "ball"
description = "one ball"
use = "scenes/rigs/slab"
[specimen]
kind = "ball"
diameter_mm = 8.0
{material}
[press]
control = "depth"
depth_mm = 0.5
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A metal ball, and a ball without a stated material."""
    folder = tmp_path_factory.mktemp("experiments")
    metal = '[specimen.material]\nuse = "materials/metals/steel"'
    (folder / "ball.toml").write_text(BALL.format(material=metal))
    (folder / "bare.toml").write_text(BALL.format(material="").replace('"ball"\n', '"bare"\n', 1))
    return folder


@pytest.fixture(scope="module")
def compared(mi, files, tmp_path_factory):
    """The ball by both methods. Not to be changed by tests."""
    out = tmp_path_factory.mktemp("comparison") / "out"
    assert run(["compare", str(files / "ball.toml"), "-o", str(out), *SETTINGS]) == 0
    return out


@pytest.fixture(scope="module")
def direct(compared):
    return read_measurement(compared / "ball" / "direct_fpp")


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_each_measurement_is_a_complete_result(compared):
    for method in FRINGES:
        folder = compared / "ball" / method
        assert {
            "result.json",
            "experiment.toml",
            "capture",
            "truth.nc",
            "reconstruction.nc",
            "points.ply",
            "report.html",
        } <= {path.name for path in folder.iterdir()}
        assert (folder / "press.nc").exists() == (method == "contact_fpp")
        assert load_experiment(folder / "experiment.toml").modality == method


def test_comparison_repeats_the_figures_of_its_parts(compared):
    result = json.loads((compared / "result.json").read_text())
    assert [case["method"] for case in result["cases"]] == list(FRINGES)
    for case in result["cases"]:
        part = json.loads((compared / case["name"] / case["method"] / "result.json").read_text())
        assert case["figures"] == part["metrics"]
        assert case["digest"] == part["digest"]
        assert case["failure"] == ""


def test_a_browser_opens_it(compared, tmp_path):
    assert_readable(compared / "report.html", tmp_path)


def test_page_shows_every_method_and_needs_no_network(compared):
    page = (compared / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 1 + 4 * len(FRINGES)
    for target in re.findall(r"""(?:src|href)\s*=\s*["']([^"']{0,60})""", page):
        assert target.startswith("data:") or (compared / target).is_file(), target
    assert "url(" not in page
    assert "<script" not in page
    for method in FRINGES:
        figures = json.loads((compared / "ball" / method / "result.json").read_text())["metrics"]
        assert percent(figures["good_share"]) in page
        assert f"{figures['z_rmse_um']:.2f}" in page


def test_both_methods_are_put_on_the_object_itself(compared):
    """All methods are compared with the surface of the ball, in addition to their own scored
    surface, with the share of the ball that has points. The ball's radius is a separate row.
    """
    page = (compared / "report.html").read_text(encoding="utf-8")
    for row in ("object: deviation, RMS", "object: form", "radius 1: deviation (µm)"):
        assert row in page
    table = comparison_table(read_outcomes(compared))
    assert "object RMS um" in table
    for method in FRINGES:
        figures = json.loads((compared / "ball" / method / "result.json").read_text())["metrics"]
        assert f"{figures['object_rms_um']:.2f}" in page
        assert f"{figures['object_rms_um']:.2f}" in table
        assert percent(figures["object_coverage_share"]) in page


def test_the_coat_is_measured_better_than_the_metal(compared):
    """Purpose of the project: a bare steel ball has reflections and shadows, its coat is matte.

    The share was below 0.5 while the filter masked four pixels around every gap in the fringes.
    """
    cases = json.loads((compared / "result.json").read_text())["cases"]
    good = {case["method"]: case["figures"]["good_share"] for case in cases}
    assert good["direct_fpp"] < 0.6
    assert good["contact_fpp"] > 0.8


def test_direct_report_tells_what_is_missing(compared, direct):
    folder = compared / "ball" / "direct_fpp"
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert {path.stem for path in (folder / "figures").iterdir()} == {
        "seen",
        "object",
        "frames",
        "decoding",
    }
    for text in (
        "virtual measurement by direct FPP",
        percent(direct.figures["good_share"]),
        "of the specimen",
    ):
        assert text in page
    assert "coated face" not in page
    assert "conductor: ior" in page
    assert split_unit("absorption_per_mm") == ("absorption", "1/mm")
    first = next(iter(missing_shares(direct)))
    assert REASON_WORDS[first] in page
    assert "elastomer" not in page.split("Appendix")[0]


def test_every_pixel_of_the_specimen_has_a_point_or_a_reason(direct):
    missing = missing_shares(direct)
    assert Reason.VALID not in missing
    total = sum(missing.values()) + direct.figures["completeness"]
    assert total == pytest.approx(1.0, abs=1e-12)


def test_error_map_is_what_is_scored(direct):
    errors = error_um(direct)
    assert errors.count() == direct.figures["points"]
    assert np.sqrt(np.mean(errors.compressed() ** 2)) == pytest.approx(
        direct.figures["z_rmse_um"], rel=1e-4
    )
    assert not errors[~scored_pixels(direct)].count()


def test_heights_are_scaled_by_the_truth_not_by_wrong_points(direct):
    """Truth: from the stage 8 mm below the ball's apex up to that apex at z = 0."""
    low_mm, high_mm = true_scale(direct).ends_mm
    assert low_mm == -10.0
    assert high_mm == pytest.approx(0.0, abs=1e-3)


def test_console_and_verdicts_of_a_direct_measurement(compared, direct):
    table = summary_table(read_measurement(compared / "ball" / "direct_fpp"))
    assert f"{percent(direct.figures['good_share'])} of the specimen's visible area" in table
    assert all(len(line) <= 100 for line in table.splitlines())
    assert "true surface" in table or direct.score.unfitted
    assert "paper" not in table
    coverage, missing = verdicts(direct)
    assert coverage.grade == "check"
    assert percent(direct.figures["good_share"]) in coverage.headline
    assert missing.reasons
    assert percent(direct.figures["good_share"]) in discussion(direct)[0]


def test_report_redraws_the_same_bytes(compared, tmp_path):
    again = tmp_path / "again"
    shutil.copytree(compared, again)
    before = contents(again)
    assert run(["report", str(again / "ball" / "direct_fpp")]) == 0
    assert run(["report", str(again)]) == 0
    assert contents(again) == before
    with pytest.raises(InputError, match="result of command 'compare'"):
        write_report(again)
    with pytest.raises(InputError, match="no comparison"):
        write_comparison(again / "ball" / "direct_fpp")


def test_finished_measurements_are_kept_and_failures_stay_in_their_cell(
    compared, files, tmp_path, monkeypatch, capsys
):
    """The ball's result exists, so it must not be measured; the bare ball has no material."""
    out = tmp_path / "out"
    shutil.copytree(compared, out)
    before = contents(out / "ball")
    names = [str(files / "ball.toml"), str(files / "bare.toml")]
    command = ["compare", *names, "-o", str(out), "--methods", "direct_fpp", *SETTINGS]
    assert run(command) == 0
    assert contents(out / "ball") == before
    assert not (out / "bare").exists() or not list((out / "bare").iterdir())
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "Could not be measured: specimen.material: found none" in page
    assert re.search(r"bare, direct_fpp: specimen\.material", capsys.readouterr().out)


def test_another_experiment_of_that_name_is_measured_anew(compared, tmp_path, monkeypatch):
    out, requests = tmp_path / "out", []
    shutil.copytree(compared, out)

    def refuse(folder, command, case, watch, memory):
        requests.append(case.modality)
        raise InputError("measured\nagain")

    monkeypatch.setattr(comparison, "measure_into", refuse)
    same = load_experiment(compared / "ball" / "direct_fpp" / "experiment.toml")
    assert all(outcome.reused and not outcome.failure for outcome in compare([same], FRINGES, out))
    assert requests == []
    noisier = same.model_copy(update={"seed": same.seed + 1})
    outcomes = compare([noisier], FRINGES, out)
    assert requests == list(FRINGES)
    assert {outcome.failure for outcome in outcomes} == {"measured again"}


def test_nothing_measured_is_a_failure(files, tmp_path, mi):
    out = tmp_path / "out"
    command = ["compare", str(files / "bare.toml"), "-o", str(out), "--methods", "direct_fpp"]
    assert run(command) == 2
    assert "Could not be measured" in (out / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [("touch", "found touch"), ("direct_fpp,direct_fpp", "twice"), ("", "allowed direct_fpp")],
)
def test_methods_are_named_exactly(text, complaint):
    with pytest.raises(InputError, match=complaint):
        methods_named(text)
    assert methods_named("contact_fpp, direct_fpp") == ("contact_fpp", "direct_fpp")


def test_folders_and_names_of_others_are_refused(compared, direct, tmp_path):
    experiment = direct.experiment
    with pytest.raises(InputError, match="found ball in more than one"):
        compare([experiment, experiment], FRINGES, tmp_path)
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match=r"no earlier run of twin compare \(.*found thesis.tex\)"):
        compare([experiment], FRINGES, tmp_path)
    with pytest.raises(InputError, match="no earlier run of twin compare"):
        compare([experiment], FRINGES, compared / "ball" / "direct_fpp")
    assert run(["compare", "-o", str(tmp_path)]) == 2


@pytest.mark.parametrize(
    ("share", "words"),
    [
        (0.0, "0 %"),
        (1.0, "100 %"),
        (0.124, "12 %"),
        (0.004, "0.40 %"),
        (0.9999, "99.99 %"),
        (1e-5, "< 0.01 %"),
    ],
)
def test_small_and_large_shares_are_not_rounded_away(share, words):
    assert percent(share) == words
