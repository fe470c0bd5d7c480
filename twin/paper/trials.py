"""Trials of the repeated measurements, by contact-FPP and by a GelSight-like sensor."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from twin.config import Experiment, vary
from twin.config.inputs import Group, Input, Inputs, load_inputs
from twin.paper.plan import FOOTPRINT_MM, identified
from twin.pipeline.comparison import PhotometricPlan, case_for
from twin.propagation.trials import record_of
from twin.results.decoders import DecodedImage
from twin.results.figures import COMPENSATED
from twin.results.names import compensated_names
from twin.results.record import Measurement
from twin.results.score import metrics
from twin.study.cases import Case, case_of
from twin.study.measuring import Conditions
from twin.study.record import StudyRecord
from twin.study.trials import CALIBRATION, CALIBRATIONS, PART, TRIAL, TRIALS, draw

INPUTS, BOARD = "paper/trials", "boards/paper_dots"
# The paper's pipeline: a look-up table, then integration as in the vendor's programs of its time.
PAPER_DECODER = {"photometric.colour_map": "table", "photometric.integration": "sdk_2024"}

REFUSED = "refused"
"""Key in `Trial.figures` of the reason why a trial could not be pressed or measured."""

RIGID_BAR = f"{COMPENSATED}bar_1_width_mm"
"""Figure of the rigid bar's width, estimated from the coat."""

_GROUPS: Mapping[str, Group] = {
    "elastomer": "elastomer",
    "coating": "elastomer",
    "press": "press",
    "score": "press",
    "specimen": "placement",
}

Figures = Mapping[str, Any]


@dataclass(frozen=True)
class Trial:
    """One trial of a repeated measurement.

    Attributes
    ----------
    number : 0 for the nominal trial
    figures : measured values by name, with units in the names
    """

    number: int
    figures: Figures


def rigid_ball(ball: int) -> str:
    """Return the name, without unit, of the rigid ball's radius, estimated from the coat."""
    return f"{COMPENSATED}sphere_{ball}_radius"


def handling() -> Inputs:
    """Return the distributions of the handling and specimen inputs that vary between trials."""
    return load_inputs(INPUTS)


@lru_cache
def inputs() -> Inputs:
    """Return all inputs that vary in the trials: handling, and samples of the identified fields.

    The samples of all fields are drawn together from the posterior distribution.
    """
    given = handling()
    summary = identified()
    drawn = {
        name: Input(
            group=_GROUPS[field["path"].partition(".")[0]],
            key=field["path"],
            distribution="choice",
            together="posterior",
            values=tuple(summary["draws"][name]),
            # GelSight has another gel and no back pressure: only the travel is common.
            methods=() if field["path"] == "press.depth_mm" else ("contact_fpp",),
            optional=field["path"].startswith("specimen."),  # bars have edges, balls have none
            source=field["source"],
        )
        for name, field in summary["fields"].items()
    }
    return given.model_copy(update={"inputs": given.inputs | drawn})


def fringe_study(experiment: Experiment, trials: int) -> StudyRecord:
    """Return the study record of the repeated contact-FPP measurement of a specimen.

    The object behind the coat is estimated where the tables have a dimension of it.
    """
    in_tables = {RIGID_BAR, f"{rigid_ball(1)}_mm"}
    compensated = not in_tables.isdisjoint(compensated_names(experiment))
    return record_of(experiment, inputs(), trials, budget=False, compensated=compensated)


def plan_of(trial: int) -> PhotometricPlan:
    """Return the settings of GelSight-like sensor and decoder for a trial.

    The trial number selects one of `CALIBRATIONS` sets of reference presses.
    """
    seed = inputs().seed + trial % CALIBRATIONS
    settings: dict[str, Any] = {**PAPER_DECODER, "seed": seed}
    # Equal travel, not equal force: the thin sheet's force hardly indents a gel on a window.
    return PhotometricPlan(settings=settings, match="depth")


def colour_cases(experiment: Experiment, trials: int) -> list[Case]:
    """Return the cases of the repeated presses under the GelSight-like sensor.

    Further cases evaluate the nominal press with each calibration. A trial has the specimen, pose
    and load of the contact-FPP trial with the same number.

    Raises
    ------
    InputError
        A press of contact-FPP fails, so that its load is unknown.
    """
    # The scored region is that of the experiment, like specimen and load.
    experiment = vary(experiment, {"score.regions_mm": [FOOTPRINT_MM]})
    given, cases = inputs(), []
    for number in range(trials + 1):
        drawn = draw(experiment, given.inputs, given.seed, number)
        cases.append(_colour_case(TRIALS, drawn, number))
    return cases + [_colour_case(CALIBRATION, experiment, n) for n in range(CALIBRATIONS)]


def _colour_case(part: str, experiment: Experiment, number: int) -> Case:
    case = case_for(experiment, "photometric_stereo", plan_of(number))
    return case_of({PART: part, TRIAL: number}, case, Conditions(number))


def figures_by_decoder(done: Measurement) -> dict[str, Any]:
    """Return the values of the balls measured from one image by every decoder.

    The name of each value starts with the decoder's colour map and integration scheme.
    """
    figures: dict[str, Any] = {}
    for decoded in done.colours.decoded:
        figures |= _by_decoder(decoded)
    return figures


def _by_decoder(decoded: DecodedImage) -> dict[str, Any]:
    return {
        f"{decoded.colour_map}_{decoded.integration}_{name}": value
        for name, value in metrics(decoded.score).items()
        if name.startswith("sphere_") or name == "z_rmse_um"
    }


def trials_among(cases: Sequence[Case], by_digest: Mapping[str, Figures]) -> list[Trial]:
    """Return the trials among `cases`, in the order of their number.

    Trial 0 also has the radii of the balls from every calibration.

    Parameters
    ----------
    by_digest : measured values of each case, by the case's digest
    """
    redone = {
        f"calibration_{case.settings[TRIAL]}_{name}": value
        for case in cases
        if case.settings[PART] == CALIBRATION
        for name, value in by_digest[case.digest].items()
        if name.startswith("sphere_") and name.endswith("_radius_mm") and "true" not in name
    }
    numbered = {case.settings[TRIAL]: case for case in cases if case.settings[PART] == TRIALS}
    trials = [Trial(number, by_digest[numbered[number].digest]) for number in sorted(numbered)]
    return [Trial(0, {**trials[0].figures, **redone}), *trials[1:]]
