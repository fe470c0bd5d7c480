"""Photometric stereo compared with contact-FPP on the same press: files, figures and pages.

The sensor has few reference presses, those of tests/pipeline: rendered once for both.
"""

import csv
import json
import re
import shutil
from dataclasses import replace
from html import escape

import numpy as np
import pytest
import trimesh

from tests.browser import assert_readable
from twin.cli import run
from twin.config import load_experiment
from twin.config.methods import METHODS
from twin.manifest import MANIFEST_FILE, manifest_lines, write_manifest
from twin.pipeline.comparison import PhotometricPlan, compare
from twin.report.comparison import press_in_words, ratio_table, summary_of, write_comparison
from twin.report.measurement import summary_table, write_report
from twin.report.photometric import decoder_table, verdicts
from twin.report.photometric_figures import decoder_error_um, true_heights_mm, true_slopes
from twin.report.spheres import fit_table
from twin.results.folder import read_measurement, write_decoders
from twin.results.score import score_heights

SMALL = {
    "camera.width_px": 640,
    "camera.height_px": 480,
    "camera.pixel_pitch_um": 9.0,
    "camera.binning": 4,
    "patterns.steps": 3,
    "render.samples": 1,
    "press.solver_pitch_mm": 0.2,
    "press.relief_pitch_mm": 0.05,
}
FEW = {"photometric.presses.count": 4, "photometric.presses.smallest_diameter_mm": 5.5}
BALL = """
name = "ball"
use = "scenes/rigs/slab"
[specimen]
kind = "ball"
diameter_mm = 8.0
[press]
{load}
"""
DEEP = BALL.format(load='control = "depth"\ndepth_mm = 0.4')
HARD = BALL.format(load='control = "force"\nforce_n = 60.0')
FIGURES = {
    "sensor", "object", "images", "slopes", "relief", "heights", "sections", "errors", "ball_1",
    "fit_regions", "press",
}  # fmt: skip


@pytest.fixture(scope="module")
def compared(mi, tmp_path_factory):
    """One ball with one force by both coats. Not to be changed by tests."""
    folder = tmp_path_factory.mktemp("photometric")
    (folder / "ball.toml").write_text(DEEP)
    plan, out = PhotometricPlan(settings=FEW), folder / "out"
    compare([load_experiment(folder / "ball.toml", SMALL)], METHODS[1:], out, plan=plan)
    write_comparison(out)
    write_report(out / "ball" / "photometric_stereo")
    return out


@pytest.fixture(scope="module")
def result(compared):
    return compared / "ball" / "photometric_stereo"


@pytest.fixture(scope="module")
def gel_result(result):
    return read_measurement(result)


@pytest.fixture(scope="module")
def summaries(compared, gel_result):
    coat = read_measurement(compared / "ball" / "contact_fpp")
    return {"contact_fpp": summary_of(coat), "photometric_stereo": summary_of(gel_result)}


def figures_of(folder):
    return json.loads((folder / "result.json").read_text())["metrics"]


def test_both_coats_feel_the_same_force(compared, summaries):
    """Expected: equal force within the solver's tolerance (0.1 %); a bonded gel yields less.

    Specimen and scoring are the experiment's; gel, lamps and camera are the other sensor's.
    """
    coat, gel = (figures_of(compared / "ball" / name) for name in summaries)
    assert coat["depth_mm"] == 0.4
    assert gel["force_n"] == pytest.approx(coat["force_n"], rel=1e-3)
    assert gel["depth_mm"] < 0.6 * coat["depth_mm"]
    ours, theirs = (summary.experiment for summary in summaries.values())
    assert (ours.specimen, ours.score) == (theirs.specimen, theirs.score)
    assert ours.elastomer != theirs.elastomer
    assert press_in_words(summaries).startswith("Two elastomers, same force")


def test_each_layout_has_one_truth_mesh(compared, summaries):
    for name in summaries:
        face = trimesh.load(compared / "ball" / name / "coated_face.ply")
        peak_mm = figures_of(compared / "ball" / name)["relief_peak_mm"]
        assert face.vertices[:, 2].max() == pytest.approx(peak_mm, rel=1e-3)
        assert np.hypot(*face.vertices[face.vertices[:, 2].argmax(), :2]) < 0.2


def test_comparison_shows_both_and_needs_no_network(compared, summaries):
    page = (compared / "report.html").read_text(encoding="utf-8")
    reports = {f"ball/{name}/report.html" for name in summaries}
    assert page.count("data:image/png;base64,") == 1 + 4 * len(summaries)
    for target in re.findall(r"""(?:src|href)\s*=\s*["']([^"']{0,60})""", page):
        assert target.startswith("data:") or target in reports, target
    for text in ("photometric stereo", "contact-FPP", "same force", "vendor 2025", "look-up"):
        assert text in page


def test_ratios_are_those_of_the_stored_figures(result, summaries):
    """Expected: every decoder's mean sphere-fit RMSE over contact-FPP's; no row of the paper."""
    with (result / "decoders.csv").open() as file:
        stored = list(csv.DictReader(file))
    base_mm = summaries["contact_fpp"].figures["sphere_1_rmse_mm"]
    rows = ratio_table(summaries).rows
    assert len(rows) == 1 + len(stored) == 7
    for row, line in zip(rows[1:], stored, strict=True):
        ratio = float(line["sphere_1_rmse_mm"]) / base_mm
        assert row["ratio"] == pytest.approx(ratio, rel=1e-5)
        assert row["z_rmse_um"] == pytest.approx(float(line["z_rmse_um"]), rel=1e-5)


def test_a_browser_opens_it(result, tmp_path):
    assert_readable(result / "report.html", tmp_path)


def test_report_is_whole(result, gel_result):
    page = (result / "report.html").read_text(encoding="utf-8")
    assert {path.stem for path in (result / "figures").iterdir()} == FIGURES
    assert page.count("data:image/png;base64,") == len(FIGURES)
    for target in re.findall(r"""(?:src|href)\s*=\s*["']([^"']{0,40})""", page):
        assert target.startswith("data:"), target
    for table in (decoder_table(gel_result), fit_table(gel_result)):
        for line in (line for body in table.bodies() for line in body):
            assert all(escape(cell.text) in page for cell in line.cells)
    assert len(verdicts(gel_result)) == 3


def test_report_redraws_the_same_page(result, tmp_path):
    again = tmp_path / "again"
    shutil.copytree(result, again)
    (again / "report.html").unlink()
    shutil.rmtree(again / "figures")
    assert run(["report", str(again)]) == 0
    assert (again / "report.html").read_bytes() == (result / "report.html").read_bytes()


def test_console_table(result, gel_result):
    table = summary_table(read_measurement(result))
    assert all(len(line) <= 100 for line in table.splitlines())
    assert f"{gel_result.figures['z_rmse_um']:.2f} um RMS" in table
    assert "look-up table, vendor 2024" in table


def test_decoders_read_back_as_measured(result, gel_result, tmp_path):
    """The page decodes the stored image again: the same figures as in the measurement."""
    write_decoders(tmp_path / "again.csv", gel_result.colours.decoded)
    assert (tmp_path / "again.csv").read_bytes() == (result / "decoders.csv").read_bytes()
    assert gel_result.colours.own.errors.z_rmse_um == pytest.approx(
        gel_result.figures["z_rmse_um"], rel=1e-9
    )


def test_error_map_is_what_is_scored(gel_result):
    for decoder in gel_result.colours.decoded:
        errors = decoder_error_um(gel_result, decoder).compressed()
        assert len(errors) == decoder.errors.points
        assert np.sqrt(np.mean(errors**2)) == pytest.approx(decoder.errors.z_rmse_um, rel=1e-5)


def test_true_slopes_are_those_of_the_true_heights(gel_result):
    """Setup: slopes from the stored normals against differences of the stored heights.

    Expected: alike in size and sign within the contact. 0.03: the pixels of the truth are bent by
    refraction by up to 1 %, and differences over two pixels (127 um) smooth slopes of up to 0.4 and
    those of a texture of 1.4 um and 0.1 mm: 0.02 RMS, of which they miss a third.
    """
    z_mm, pitch_mm = true_heights_mm(gel_result).data, gel_result.colours.calibration.pitch_mm
    down, right = np.gradient(z_mm, pitch_mm)
    inside = np.hypot(*np.indices(z_mm.shape) - np.array([119.5, 159.5])[:, None, None]) < 12
    slopes = true_slopes(gel_result)
    for actual, expected in ((slopes[0], down), (slopes[1], right)):
        assert np.abs(actual - expected)[inside].max() < 0.03
        assert np.abs(expected[inside]).max() > 0.1


@pytest.mark.parametrize("scale", [0.6, 1.0, 1.3])
def test_height_scale_is_that_of_the_heights(gel_result, scale):
    """Setup: the true heights, scaled and shifted, as if measured."""
    heights_mm = scale * gel_result.truth.points_world_mm[..., 2] + 0.05
    heights = replace(gel_result.colours.heights, height_mm=heights_mm)
    scored = score_heights(gel_result.experiment, heights, gel_result.truth).against_truth
    assert scored.height_scale == pytest.approx(scale, rel=1e-5)


def test_points_of_the_view_are_the_heights(gel_result):
    points = gel_result.points
    np.testing.assert_array_equal(points.valid, gel_result.colours.own.heights.valid)
    np.testing.assert_allclose(points.world_mm[..., 2], gel_result.colours.own.heights.height_mm)
    assert points.sigma_z_mm is None


def test_a_report_without_its_image_is_refused(result, tmp_path, capsys):
    broken = tmp_path / "broken"
    shutil.copytree(result, broken)
    write_manifest(broken / MANIFEST_FILE, "result", manifest_lines(broken))
    (broken / "image.png").unlink()
    assert run(["report", str(broken)]) == 2
    assert "image.png: cannot be read: No such file" in capsys.readouterr().err


def test_a_load_that_one_layout_cannot_take_is_told(mi, tmp_path, summaries):
    """Setup: 60 N on an 8 mm ball, more than the 4.25 mm gel can give way to.

    Expected: the cell states the required depth, the page that the presses cannot be compared.
    """
    experiment = tmp_path / "ball.toml"
    experiment.write_text(HARD)
    few = [text for key, value in FEW.items() for text in ("--photometric-set", f"{key}={value}")]
    command = ["compare", str(experiment), "-o", str(tmp_path / "out"), *few]
    assert run([*command, "--methods", "photometric_stereo", "--match", "force"]) == 2
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Could not be measured: press" in page
    missing = summaries | {"photometric_stereo": None}
    assert "cannot be compared" in press_in_words(missing)
