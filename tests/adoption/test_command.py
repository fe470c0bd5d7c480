"""`twin adopt` on the worked example of docs/real_rig.md with its known rig."""

import contextlib
import csv
import io
import json
import re
import shutil
import tomllib
from pathlib import Path

import pytest

import twin
from reconstruction.capture.folder import read_capture
from reconstruction.errors import InputError
from twin.adoption.elastomer import KnownBallPress, elastomer_fields
from twin.adoption.rendered import _require_albedo
from twin.cli import run
from twin.config import load_experiment

EXAMPLE = Path(__file__).parents[2] / "docs" / "example_capture"


@pytest.fixture(scope="module")
def adopted(tmp_path_factory):
    out = tmp_path_factory.mktemp("adopt") / "rig"
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        assert run(["adopt", str(EXAMPLE), "-o", str(out), "--no-report"]) == 0
    (out.parent / "printed.txt").write_text(printed.getvalue(), encoding="utf-8")
    return out


def test_the_example_gives_its_rig(adopted):
    """docs/make_example_capture.py: gamma 1, blur 0.7 px, gain 6.22e-4 DN/e- of binned pixels.

    8 bits: a level is 1,600 electrons, so rounding hides the read noise. The gain is as accurate
    as a pixel noise of some 0.1 levels permits.
    """
    metrics = json.loads((adopted / "result.json").read_text())["metrics"]
    assert (
        abs(metrics["projector_gamma"] - 1.0) < 3.0 * metrics["projector_gamma_uncertainty"] + 0.01
    )
    assert metrics["projector_blur_px"] == pytest.approx(0.7, abs=0.05)
    assert metrics["camera_misfit_px"] < 0.01
    assert metrics["fields_found"] > 20
    assert metrics["fields_assumed"] > 10


def test_files_are_a_contract(adopted):
    result = json.loads((adopted / "result.json").read_text())
    assert result["command"] == "adopt"
    assert len(result["digest"]) == 16
    rig = tomllib.loads((adopted / "rig.toml").read_text())
    assert rig["projector"]["gamma"]["source"].startswith("measured")
    assert rig["coating"]["base_albedo"]["source"].startswith("assumed")
    assert load_experiment(adopted / "experiment.toml").name == "adopted"
    response = tomllib.loads((adopted / "response.toml").read_text())["response"]
    assert response["gamma"] == pytest.approx(rig["projector"]["gamma"]["value"], rel=1e-6)


def test_the_terminal_prints_ten_lines_and_the_files_have_the_rest(adopted):
    """Expected: estimates with interval, counts that agree with result.json, and the next step."""
    text = (adopted.parent / "printed.txt").read_text(encoding="utf-8")
    assert 4 < len(text.splitlines()) <= 10
    assert re.search(r"^projector\.gamma = 0\.99\d+ \(95 %: 0\.99\d+ to ", text, re.M)
    assert "a press of a known ball (--ball)" in text
    rows = list(csv.DictReader((adopted / "fields.csv").read_text("utf-8").splitlines()))
    rig = tomllib.loads((adopted / "rig.toml").read_text())
    by_path = {row["field"]: row for row in rows}
    gamma = by_path["projector.gamma"]
    assert float(gamma["value"]) == pytest.approx(rig["projector"]["gamma"]["value"], rel=1e-6)
    assert float(gamma["low"]) < float(gamma["value"]) < float(gamma["high"])
    metrics = json.loads((adopted / "result.json").read_text())["metrics"]
    assert len(rows) == metrics["fields_found"] + metrics["fields_assumed"]
    devices = ("camera.", "projector.", "coating.", "elastomer.")
    assumed = sum(r["source"].startswith("assumed") for r in rows if r["field"].startswith(devices))
    assert f"{assumed} assumed" in text


def test_the_response_is_taken_by_a_capture(adopted, tmp_path, capsys):
    """response.toml, appended to capture.toml, is the response that the decoder uses."""
    capture = tmp_path / "capture"
    shutil.copytree(EXAMPLE, capture)
    text = (capture / "capture.toml").read_text() + (adopted / "response.toml").read_text()
    (capture / "capture.toml").write_text(text)
    assert run(["decode", str(capture), "-o", str(tmp_path / "with")]) == 0
    assert run(["decode", str(EXAMPLE), "-o", str(tmp_path / "without")]) == 0
    digests = {
        json.loads((tmp_path / name / "result.json").read_text())["digest"]
        for name in ("with", "without")
    }
    assert len(digests) == 2
    broken = text.replace("gamma =", "gama =")
    (capture / "capture.toml").write_text(broken)
    capsys.readouterr()
    assert run(["decode", str(capture), "-o", str(tmp_path / "no")]) == 2
    assert "did you mean gamma?" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "no capture"),
        (["nowhere"], "capture.toml"),
        ([str(EXAMPLE), "--dark", "nowhere"], "no images"),
        ([str(EXAMPLE), "--reference", str(EXAMPLE)], "go together"),
        ([str(EXAMPLE), "--like", "rigs/none"], "none"),
        ([str(EXAMPLE), "--reference", str(EXAMPLE), "--reference-albedo", "7"], "albedo"),
        ([str(EXAMPLE), "--ball", str(EXAMPLE)], "give all three"),
        ([str(EXAMPLE), "--ball-diameter-mm", "-1"], "give all three"),
    ],
)
def test_bad_input_gives_a_single_line(tmp_path, capsys, arguments, message):
    out = tmp_path / "out"
    assert run(["adopt", *arguments, "-o", str(out), "--no-report"]) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert message in line
    assert not out.exists()


def test_lit_dark_frames_give_a_single_line(tmp_path, capsys):
    """The white frame as dark frame: a black level of half the scale would exclude all light."""
    dark = tmp_path / "dark"
    dark.mkdir()
    white = sorted(EXAMPLE.glob("*white*"))[0]
    for number in range(2):
        shutil.copy(white, dark / f"{number}{white.suffix}")
    out = tmp_path / "out"
    assert run(["adopt", str(EXAMPLE), "--dark", str(dark), "-o", str(out), "--no-report"]) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert re.search(
        r"dark frames have a mean of [\d.]+ DN, allowed up to [\d.]+ DN, .*cover", line
    )
    assert not out.exists()


@pytest.mark.parametrize("albedo", [-0.1, 0.0, 1.0, 1.7, float("nan")])
def test_an_impossible_albedo_is_rejected(albedo):
    with pytest.raises(InputError, match=r"allowed 0 to 1, with a reference of 0\.5; record both"):
        _require_albedo(albedo, 0.5)


LAYER = """[elastomer]
use = "materials/elastomers/thin_silicone_c"
thickness_mm = 0.21
length_x_mm = 24.0
length_y_mm = 20.0
[press]
back_pressure_kpa = 3.0
[sigma]
back_pressure_kpa = 0.03
"""


def test_a_pressed_ball_gives_the_elastomer(tmp_path):
    """True: 0.2 mm and 413 kPa, as in `examples/wrapped_balls`; given: 0.21 mm.

    One capture is both the rig's and the press; its pixels have the noise estimated from it.
    """
    rendered, rig, layer = tmp_path / "press", tmp_path / "rig", tmp_path / "layer.toml"
    layer.write_text(LAYER)
    small = [
        "-s",
        "camera.binning=4",
        "-s",
        "press.cell_mm=0.25",
        "--no-report",
        "-o",
        str(rendered),
    ]
    assert run(["render", "examples/wrapped_balls", *small]) == 0
    ball = ["--ball", str(rendered), "--ball-diameter-mm", "8", "--layer", str(layer)]
    assert run(["adopt", str(rendered), *ball, "-o", str(rig), "--no-report"]) == 0
    elastomer = tomllib.loads((rig / "rig.toml").read_text())["elastomer"]
    low, high = elastomer["thickness_mm"]["range"]
    assert low < 0.2 < high < 0.21
    assert high - low < 0.006
    low, high = elastomer["young_modulus_kpa"]["range"]
    assert low < 412.7 < high
    assert "shore_a" not in elastomer
    assert elastomer["length_x_mm"]["source"] == "stated: layer.toml"
    adopted = load_experiment(rig / "experiment.toml")
    assert adopted.elastomer.thickness_mm == pytest.approx(0.2, abs=0.003)
    layer.write_text(LAYER.replace("0.21", "4.0"))
    press = KnownBallPress(rendered, layer, 8.0)
    with pytest.raises(InputError, match="which shows no free form"):
        elastomer_fields(press, read_capture(rendered))


def test_the_public_function_returns_the_same(adopted):
    """As fields with sources, in one line, with the points of the capture."""
    adopted_rig = twin.adopt(EXAMPLE)
    written = json.loads((adopted / "result.json").read_text())["metrics"]
    assert adopted_rig.fields["projector.blur_px"].value == written["projector_blur_px"]
    measured = [
        field for field in adopted_rig.fields.values() if field.source.startswith("measured")
    ]
    assert repr(adopted_rig).startswith(
        f"<Adopted: {len(adopted_rig.fields)} fields, {len(measured)} measured"
    )
    assert adopted_rig.to_xarray()["z_mm"].dims == ("row", "col")
    assert "projector.blur_px" in adopted_rig._repr_html_()
