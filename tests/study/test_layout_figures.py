"""A study bounds frames, duration and layout: known before a measurement, or after it."""

import pytest

from twin.config import vary
from twin.config.axis import Axis
from twin.config.inputs import Input
from twin.config.study import Constraint, load_study
from twin.study.cases import cases_of
from twin.study.checks import check_figures
from twin.study.derived import with_derived
from twin.study.feasibility import unmet_conditions
from twin.study.needed import bound_needed
from twin.study.record import StudyRecord
from twin.study.trials import alone_cases, draw

STEPS = Axis(path="patterns.steps", values=(4, 8, 16))


def test_designs_with_too_many_frames_are_not_measured(study_of, base):
    """Frames: 2 N + 17."""
    study = study_of(STEPS, constraint=(Constraint(value="frames", at_most=40),))
    cases = cases_of(study, base)
    assert [case.experiment.patterns.steps for case in cases.run] == [4, 8]
    assert cases.excluded == 1


def test_a_fixed_exposure_bounds_the_duration_before_the_measurement(study_of, base):
    fixed = vary(base, {"camera.exposure_ms": 20.0})
    bounds = (Constraint(value="sequence_ms", at_most=700.0),)
    assert len(cases_of(study_of(STEPS, constraint=bounds), fixed).run) == 2
    per_mm = (Constraint(value="sequence_ms", per="patterns.steps", at_most=110.0),)
    assert len(cases_of(study_of(STEPS, constraint=per_mm), fixed).run) == 2


def test_an_automatic_exposure_bounds_the_duration_after_the_measurement(study_of, base):
    bound = Constraint(value="sequence_ms", at_most=600.0)
    cases = cases_of(study_of(STEPS, constraint=(bound,)), base)
    assert len(cases.run) == 3
    assert unmet_conditions(cases.run[0], {"sequence_ms": 650.0}, [bound]) == {
        "sequence_ms <= 600": "650"
    }


@pytest.mark.parametrize("figure", ["sequence_ms", "least_sequence_ms"])
def test_a_duration_below_that_of_the_rates_is_not_measured(study_of, base, figure):
    """89 frames per second: 25, 33 and 49 frames take 281, 371 and 551 ms."""
    bounds = (Constraint(value=figure, at_most=400.0),)
    assert len(cases_of(study_of(STEPS, constraint=bounds), base).run) == 2


def test_the_field_follows_an_axis_and_is_a_column(study_of, base):
    fields = Axis(path="optics.field_mm", values=([12, 9], [20, 15], [28, 21]))
    bounds = (Constraint(value="pixel_on_coat_um", at_most=130.0),)
    study = study_of(fields, constraint=bounds, metrics=("field_width_mm", "force_n"))
    cases = cases_of(study, base).run
    assert len(cases) == 2
    check_figures(StudyRecord(study, base), cases)
    names = ["field_width_mm", "magnification"]
    widths = [with_derived(case.experiment, {}, names)["field_width_mm"] for case in cases]
    assert widths == pytest.approx([12.0, 20.0])
    assert bound_needed(study) == "no"


def test_lenses_are_choices(study_of, base, tmp_path):
    file = tmp_path / "study.toml"
    file.write_text(
        'name = "lenses"\nbase = "examples/slab_balls"\n[set.optics]\nfield_mm = [30, 22]\n'
        '[[axis]]\nname = "lens"\n'
        '[axis.choices."35 mm".optics.lens]\nuse = "scenes/lenses/kowa_lm35jc10m"\n'
        '[axis.choices."50 mm".optics.lens]\nuse = "scenes/lenses/fujinon_hf50xa_5m"\n'
    )
    cases = cases_of(*load_study(file)).run
    standoff_mm = [case.experiment.camera.pose.standoff_mm for case in cases]
    assert standoff_mm == pytest.approx([35 * (1 + 1 / 0.2904), 50 * (1 + 1 / 0.2904)], rel=1e-3)


def test_trials_vary_the_built_rig_not_the_request(base):
    experiment = vary(base, {"optics.field_mm": [20, 15]})
    key = "camera.pose.standoff_mm"
    at_mm = experiment.camera.pose.standoff_mm
    inputs = {"distance": Input(group="optics", key=key, distribution="normal", spread=0.1)}
    drawn = draw(experiment, inputs, seed=1, trial=1)
    assert 0.0 < abs(drawn.camera.pose.standoff_mm - at_mm) < 1.0
    assert drawn.camera.focal_length_mm == 50.0
    assert len(alone_cases(experiment, inputs)) == 3
