"""A reproduction runs each requested measurement once, in stores of the study."""

from collections import Counter
from dataclasses import replace

import pytest

from reconstruction.errors import InputError
from reconstruction.reading import read_json
from twin.paper import reproduction
from twin.paper.completeness import COMPLETENESS_FILE
from twin.paper.plan import BALLS, CASES, RODS, WIDTH, Resolution, experiment_of
from twin.paper.reproduction import CAMERA_TILT_DEG, GROUPS, ROUGHNESS, Reproduction, link
from twin.paper.run import Request
from twin.paper.statistics import values_of
from twin.paper.trials import REFUSED
from twin.propagation.results import is_uncertainty
from twin.study import sweep as sweeping
from twin.study.measuring import NOMINAL_CONDITIONS, CaseResult, RigCovariance

measured = Counter()


class Fake:
    """Measurer that computes every figure of the tables from the experiment's numbers."""

    def __init__(self, keep=()):
        pass

    def __call__(self, experiment, conditions=NOMINAL_CONDITIONS):
        measured[experiment.name, experiment.modality] += 1
        value = 4.0 + experiment.specimen.x_mm + 1e-3 * conditions.trial
        figures = {"sphere_1_radius_mm": value, WIDTH: value}
        if conditions.board:
            figures["true_rig_sphere_1_radius_mm"] = value - 0.01
        figures |= {"share_specimen": 0.7, "share_specimen_points": 0.8}
        return CaseResult(figures, lambda folder: (folder / COMPLETENESS_FILE).touch())

    def reads(self):
        return ()


class Refusing(Fake):
    def __call__(self, experiment, conditions=NOMINAL_CONDITIONS):
        if conditions.trial == 2:
            raise InputError("specimen: too large")
        return super().__call__(experiment, conditions)


class RefusingAll(Fake):
    def __call__(self, experiment, conditions=NOMINAL_CONDITIONS):
        raise InputError("specimen: too large")


@pytest.fixture
def run_of(tmp_path, monkeypatch):
    """Return a reproduction with a replaced measurer."""

    def make(fake=Fake, trials=3):
        monkeypatch.setattr(
            reproduction,
            "run_groups",
            lambda groups, *given: sweeping.run_groups(
                [replace(group, make_measurer=fake) for group in groups], *given
            ),
        )
        monkeypatch.setattr(reproduction, "calibrated", lambda *_: RigCovariance(()))
        measured.clear()
        return Reproduction(
            tmp_path / "work", trials, Resolution({"press.solver_pitch_mm": 0.4}, {})
        )

    return make


def test_trials_are_stored_as_a_study(run_of, tmp_path):
    run = run_of()
    trials = run.fringe_trials(RODS[0])
    assert [trial.number for trial in trials] == [0, 1, 2, 3]
    assert "true_rig_sphere_1_radius_mm" in trials[1].figures
    assert is_uncertainty(tmp_path / "work/trials" / RODS[0])
    assert measured == {(RODS[0], "contact_fpp"): 4}
    assert run.fringe_trials(RODS[0]) == trials
    assert run_of(trials=4).fringe_trials(RODS[0])[:4] == trials
    assert sum(measured.values()) == 1


def test_the_nominal_press_under_every_calibration(run_of):
    colours = run_of().ball_trials()["GelSight"]
    redone = [name for name in colours[0].figures if name.startswith("calibration_")]
    assert redone == [f"calibration_{number}_sphere_1_radius_mm" for number in range(5)]
    assert [trial.number for trial in colours] == [0, 1, 2, 3]
    assert not any(name.startswith("calibration_") for name in colours[1].figures)


def test_budget_of_a_model(run_of):
    """radius = 4 + x: only u(x) = 0.2 mm contributes; joint samples are no part of the budget."""
    run = run_of()
    parts = {part.name: part.u for part in run.budget(BALLS)}
    assert parts.pop("place_x") == pytest.approx(0.2)
    assert set(parts.values()) == {0.0}
    assert "projector_focus" in parts
    assert "thickness_mm" not in {part.name for part in run.budget(BALLS)}


def test_cases_of_figures_are_linked_by_name(run_of, tmp_path):
    cases = run_of().cases_folder()
    pairs = {(name, method) for names, methods in CASES for name in names for method in methods}
    for name, method in pairs:
        assert (cases / name / method / "result.json").is_file()
    assert sum(measured.values()) == len(pairs)


def test_nominal_trials_are_the_figures_cases(run_of, tmp_path):
    """Expected: one measurement for both, repeated if the figures' files are missing."""
    run = run_of()
    cases = run.cases_folder()
    nominal = run.fringe_trials(RODS[0])[0]
    assert measured[RODS[0], "contact_fpp"] == 4
    case = (cases / RODS[0] / "contact_fpp").resolve()
    assert case.parent.parent == tmp_path / "work/trials" / RODS[0]
    assert read_json(case / "result.json")["metrics"] == nominal.figures
    (case / COMPLETENESS_FILE).unlink()
    run_of().cases_folder()
    assert (case / COMPLETENESS_FILE).is_file()


def test_the_bare_nut_by_tilt_and_roughness(run_of):
    shares = run_of().bare_nut()
    assert shares == {(t, a): [0.7, 0.8] for t in CAMERA_TILT_DEG for a in ROUGHNESS}
    assert measured == {("nut", "direct_fpp"): 12}


def test_the_projector_keeps_its_angle_to_the_camera(run_of):
    nominal = experiment_of("nut")
    assert nominal.camera.pose.polar_deg == CAMERA_TILT_DEG[-1]
    for tilt in CAMERA_TILT_DEG:
        tilted = run_of()._bare_nut_at(tilt, 0.2)
        assert tilted.camera.pose.polar_deg == tilt
        between = tilted.camera.pose.polar_deg + tilted.projector.pose.polar_deg
        assert between == nominal.camera.pose.polar_deg + nominal.projector.pose.polar_deg


def test_a_failed_trial_is_omitted_with_its_reason(run_of):
    """A drawn sheet may have no equilibrium at the drawn pressure; the other trials count."""
    trials = run_of(Refusing).fringe_trials(RODS[0])
    assert [REFUSED in trial.figures for trial in trials] == [False, False, True, False]
    assert trials[2].figures[REFUSED] == "specimen: too large"
    assert values_of(trials[1:], WIDTH).size == 2


def test_a_failed_case_that_is_no_repetition_ends_the_run(run_of):
    with pytest.raises(InputError, match="specimen: too large"):
        run_of(RefusingAll).bare_nut()


def test_all_groups_of_a_request_are_measured_together(run_of):
    """Expected: tables and figures then need no further measurement."""
    run = run_of()
    run.measure(Request(trials=3).measured)
    before = sum(measured.values())
    assert before > 60
    run.ball_trials(), run.rod_trials(), run.budget(BALLS), run.bare_nut(), run.cases_folder()
    assert sum(measured.values()) == before


def test_measurements_of_a_request():
    assert Request(trials=3).measured == set(GROUPS)
    assert Request(trials=3, only=("hardness",)).measured == set()
    assert Request(trials=3, only=("differences",)).measured == {"nut"}
    assert Request(trials=3, only=("rods",)).measured == {*reproduction.TRIALS_OF_RODS, "measured"}
    assert Request(trials=3, only=("tables/rods",)).measured == {*reproduction.TRIALS_OF_RODS}
    assert Request(trials=3, only=("tables/explain_decoders",)).measured == {"gelsight"}
    assert Request(trials=3, only=("tables/identified_worth",)).measured == set()


@pytest.mark.parametrize("only", ["figures/sphere_fit", "tables/pictures", "figures/rods"])
def test_a_single_figure_or_table_measures_only_its_own_cases(run_of, only):
    """Expected: two methods of the balls, the pressed nut, or three nominal rods; no trials."""
    request = Request(trials=3, only=(only,))
    run = replace(run_of(), shown=request.cases)
    run.measure(request.measured)
    run.cases_folder()
    cases = {
        "figures/sphere_fit": {(BALLS, "photometric_stereo"), (BALLS, "contact_fpp")},
        "tables/pictures": {("nut", "contact_fpp")},
        "figures/rods": {(name, "contact_fpp") for name in RODS},
    }
    assert {
        (name.removesuffix("_photometric_stereo"), method) for name, method in measured
    } == cases[only]
    assert sum(measured.values()) == len(cases[only])


def test_a_foreign_folder_is_not_replaced_by_a_link(tmp_path):
    (tmp_path / "theirs").mkdir()
    with pytest.raises(InputError, match="found a file or folder, allowed a link"):
        link(tmp_path / "theirs", tmp_path / "target")
