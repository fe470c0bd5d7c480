"""The page, the folder and the command of an identification."""

import json
import tomllib

import numpy as np
import pytest
import xarray

from tests.browser import assert_readable
from tests.identification.sensors import Formula
from tests.identification.test_identify import CHOICES
from twin.cli import run as command
from twin.config import load_experiment
from twin.identification import posterior, simulations
from twin.identification import run as identification
from twin.identification.findings import Ridge
from twin.report.identified import ridge_words

ROWS = """
[rows.held]
experiment = "ball"
metric = "radius_mm"
value = 4.9
sd = 0.01
held_out = true
steered = "far was added after this row"
[limits.deep]
experiment = "ball"
metric = "product_mm2"
at_least = 0.01
sd = 0.01
compare_at = [0.4]
source = "a picture"
[worth.depth]
experiment = "ball"
metric = "height_mm"
value = 0.0
sd = 0.001
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder of `twin identify` with a sensor of formulas."""
    home = tmp_path_factory.mktemp("identify")
    (home / "problem.toml").write_text(CHOICES.replace('name = "sensor"', _NAMED) + ROWS)
    with pytest.MonkeyPatch.context() as patched:
        defaults = simulations.simulate.__kwdefaults__ | {"make_measurer": Formula}
        patched.setattr(simulations.simulate, "__kwdefaults__", defaults)
        defaults = identification.identify.__kwdefaults__ | {"make_measurer": Formula}
        patched.setattr(identification.identify, "__kwdefaults__", defaults)
        # Chains of five correlation times: their accuracy is not judged here.
        patched.setattr(posterior, "_CORRELATION_TIMES", 5)
        patched.setattr(posterior, "_EFFECTIVE", 200)
        code = command(["identify", str(home / "problem.toml"), "-o", str(home / "out"), "-j", "1"])
    assert code in (0, None)
    return home / "out"


_NAMED = 'name = "sensor"\nrotate = ["radius"]'


def test_a_browser_opens_it(folder, tmp_path):
    assert_readable(folder / "report.html", tmp_path)


def test_the_folder_holds_figures_samples_and_experiments(folder):
    figures = json.loads((folder / "result.json").read_text())["metrics"]
    assert figures["fields"]["thickness"]["path"] == "elastomer.thickness_mm"
    assert figures["fields"]["thickness"]["mean"] == pytest.approx(0.3, abs=0.01)
    assert figures["rows"]["held"]["fitted"] is False
    assert set(figures["rotated"]) == {"radius"}
    assert {(shift["field"], shift["towards"]) for shift in figures["priors"]} == {
        (name, end) for name in figures["fields"] for end in ("low", "high")
    }
    assert sum(model["probability"] for model in figures["models"]) == pytest.approx(1.0)
    with xarray.open_dataset(folder / "posterior.nc") as samples:
        assert samples["thickness"].dims == ("model", "sample")
        best = int(np.argmax(samples["probability"].data))
        assert float(samples["thickness"][best].mean()) == pytest.approx(0.3, abs=0.01)
    best = load_experiment(folder / "experiments" / "ball.toml")
    assert best.elastomer.layout == "contact_face"
    assert best.elastomer.thickness_mm == pytest.approx(0.3, abs=0.02)


def test_the_summary_holds_rows_worth_and_joint_draws(folder):
    """Both fields of one index are from one sample: with a known product they anticorrelate."""
    summary = tomllib.loads((folder / "identified.toml").read_text())
    assert summary["rows"]["held"]["fitted"] is False
    assert summary["rows"]["held"]["steps"] > 2.0
    assert summary["models"][0]["probability"] > 0.5
    assert set(summary["worth"]["depth"]) == {"thickness", "depth"}
    decided = {(d["row"], d["alternative"]): d["after"] for d in summary["decisions"]}
    # Far and free have a probability of 0: the rows have decided both alternatives.
    assert decided == {("depth", "fit"): 1.0, ("depth", "layout"): 1.0}
    thickness, depth = (np.array(summary["draws"][name]) for name in ("thickness", "depth"))
    assert thickness.shape == depth.shape == (64,)
    assert np.corrcoef(thickness, depth)[0, 1] < -0.3
    field = summary["fields"]["thickness"]
    assert field["range"][0] <= field["value"] <= field["range"][1]
    assert field["source"].startswith("identified: ")


def test_the_page_lists_unexplained_rows_and_useful_measurements(folder):
    text = (folder / "report.html").read_text()
    assert "held: unexplained, +" in text
    assert "held out, steered a choice" in text
    assert "held: far was added after this row" in text
    assert "Expected gain of one more measurement" in text
    assert "best choice after the measurement" in text
    assert 'id="corner"' in text
    assert (folder / "figures" / "corner.png").stat().st_size > 0


def test_the_influence_of_a_limits_bound_is_listed(folder):
    """The row of the product, 0.32 mm2 with SD 0.005, is known better than bounds up to 0.4."""
    bounds = tomllib.loads((folder / "identified.toml").read_text())["bounds"]
    assert [compared.get("bound") for compared in bounds] == [None, 0.01, 0.4]
    without, stated, higher = (compared["fields"]["depth"]["mean"] for compared in bounds)
    assert stated == pytest.approx(without, abs=0.02)
    assert higher > stated + 0.01
    assert bounds[2]["log_evidence"] < bounds[0]["log_evidence"] - 5.0
    assert "Influence of the bounds" in (folder / "report.html").read_text()


def test_a_folder_with_foreign_files_is_an_error(folder, tmp_path, capsys):
    (tmp_path / "notes.txt").write_text("mine")
    problem = folder.parent / "problem.toml"
    assert command(["identify", str(problem), "-o", str(tmp_path)]) == 2
    assert "notes.txt" in capsys.readouterr().err
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_a_ridge_in_words():
    product = Ridge({"thickness": 0.7, "travel": 0.7}, 1e-3, 0.4)
    ratio = Ridge({"thickness": 0.7, "travel": -0.7}, 1e-3, 0.4)
    assert ridge_words(product) == "thickness up with travel down changes no row"
    assert ridge_words(ratio) == "thickness up with travel up changes no row"
