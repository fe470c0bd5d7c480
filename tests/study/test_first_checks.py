"""Checks without rendering are reported before the first case; other failures as they occur."""

import pytest

from reconstruction.errors import InputError
from tests.pipeline.reference import ALONE, FEW_PRESSES, FREE, recorded
from twin.cli import run
from twin.config import load_experiment
from twin.pipeline.comparison import PhotometricPlan, case_for
from twin.pipeline.press import press_specimen
from twin.results.names import figure_names

STUDY = """
name = "first"
base = "examples/gel_on_window"
metrics = ["{metric}"]
objectives = [{{ metric = "{goal}" }}]
[set.camera]
binning = 4
[[axis]]
path = "{path}"
values = {values}
"""


def study(tmp_path, metric="object_rms_um", goal="z_rmse_um", path="seed", values=(1, 2)):
    file = tmp_path / "study.toml"
    text = STUDY.format(metric=metric, goal=goal, path=path, values=list(values))
    file.write_text(text, encoding="utf-8")
    return str(file)


def experiments():
    """The experiments behind tests/pipeline/reference.json, by name."""
    two_balls = load_experiment("examples/slab_balls", FREE)
    plan = PhotometricPlan(settings=FEW_PRESSES)
    result = {name: load_experiment(*given) for name, given in ALONE.items()}
    for method in ("contact_fpp", "direct_fpp"):
        result[f"compared_{method}"] = case_for(two_balls, method, plan)
    gel = load_experiment(
        "rigs/gelsight_mini", {"name": "gel", "specimen": two_balls.specimen.model_dump()}
    )
    return result | {"compared_photometric_stereo": gel}


METHODS = ("contact_fpp", "direct_fpp", "photometric_stereo")


@pytest.mark.parametrize("name", [*ALONE, *(f"compared_{method}" for method in METHODS)])
def test_every_figure_of_a_measurement_is_known_before_it(name):
    """Recorded measurements by all methods have no figure that the checks would not know."""
    have = set(recorded()["measured"][name]["metrics"])
    assert have <= figure_names(experiments()[name])


def test_a_misspelt_figure_stops_a_study_before_its_first_case(tmp_path, capsys):
    for requested in ({"metric": "object_rsm_um"}, {"goal": "object_radius_2_abs_error_um"}):
        assert run(["sweep", study(tmp_path, **requested), "-o", str(tmp_path / "out")]) == 2
        message = capsys.readouterr().err
        assert "no case of this study has a figure" in message
        assert "did you mean object_r" in message
        assert not (tmp_path / "out").exists()


def test_no_case_runs_if_none_can_be_measured(tmp_path, capsys):
    """A gel without mechanics: reported from the description only, with the missing field."""
    file = study(tmp_path)
    text = (tmp_path / "study.toml").read_text(encoding="utf-8")
    text = text.replace("examples/gel_on_window", "examples/slab_balls")
    text += '[set.elastomer]\nlayout = "contact_face"\n[set.press]\nback_pressure_kpa = 0.0\n'
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    assert run(["sweep", file, "-o", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert "2 of 2 cases cannot be measured: layers: found none" in message
    assert not (tmp_path / "out" / "cases").exists()


def test_a_measurand_that_the_specimen_cannot_have_is_refused_at_once(tmp_path, capsys):
    file = tmp_path / "wrong.toml"
    file.write_text(
        'name = "wrong"\nuse = "scenes/examples/gel_on_window"\n[[measurand]]\n'
        'name = "second"\nquantity = "radius"\nnumber = 2\n',
        encoding="utf-8",
    )
    assert run(["measure", str(file), "-o", str(tmp_path / "out")]) == 2
    assert "radius number 2: the specimen (ball) has 1" in capsys.readouterr().err


def test_the_first_reasons_are_reported_with_a_remedy(mi, tmp_path, capsys):
    """A gel too thin for a force is detected by the press only: reported as the case fails."""
    file = study(tmp_path, path="press.force_n", values=[4000.0])
    assert run(["sweep", file, "-o", str(tmp_path / "out"), "-j", "1"]) == 1
    message = capsys.readouterr().err
    assert message.index("a case failed: press.force_n: 4000 N needs") < message.index("1 failed: ")
    assert "lower press.force_n, or use a thicker or harder slab" in message
    assert "rim" not in message  # a gel on a window has none


def test_a_free_slab_is_warned_of_its_rim_and_of_the_other_layout():
    slab = {"press.control": "force", "press.force_n": 5000.0, "press.back_pressure_kpa": 0.0}
    slab |= {"press.depth_mm": "absent", "press.solver_pitch_mm": 0.4}
    slab |= {"mechanics.model": "spectral"}
    with pytest.raises(InputError, match=r"narrower rim .* 'contact_face', with layers"):
        press_specimen(load_experiment("examples/slab_balls", slab))
