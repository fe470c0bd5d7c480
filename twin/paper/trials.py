"""The paper's repeated measurements: studies of trials, and a GelSight-like sensor beside them."""

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
"""Figure of a trial that could not be pressed or measured: the reason."""

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
    """One repetition: its number, 0 for the nominal one, and what was measured."""

    number: int
    figures: Figures


def handling() -> Inputs:
    """Return what differs from trial to trial in the handling and the piece."""
    return load_inputs(INPUTS)


@lru_cache
def inputs() -> Inputs:
    """Return what differs from trial to trial: handling, and joint samples of the identified."""
    given = handling()
    found = identified()
    drawn = {
        name: Input(
            group=_GROUPS[one["path"].partition(".")[0]],
            key=one["path"],
            distribution="choice",
            together="posterior",
            values=tuple(found["draws"][name]),
            # GelSight has a gel of its own, and no air: it shares the travel alone.
            methods=() if one["path"] == "press.depth_mm" else ("contact_fpp",),
            optional=one["path"].startswith("specimen."),  # bars have edges, balls have none
            source=one["source"],
        )
        for name, one in found["fields"].items()
    }
    return given.model_copy(update={"inputs": given.inputs | drawn})


def fringe_study(experiment: Experiment, trials: int) -> StudyRecord:
    """Return the repeated contact-FPP measurement of a specimen."""
    told = experiment.specimen.kind in {"two_balls", "bars"}
    return record_of(experiment, inputs(), trials, budget=False, compensated=told)


def plan_of(trial: int) -> PhotometricPlan:
    """Return sensor and decoder of a trial; its reference presses are one of five sets."""
    seed = inputs().seed + trial % CALIBRATIONS
    settings: dict[str, Any] = {**PAPER_DECODER, "seed": seed}
    # The z stage goes as far: a thin sheet gives way at forces that a gel on a window hardly feels.
    return PhotometricPlan(settings=settings, match="depth")


def colour_cases(experiment: Experiment, trials: int) -> list[Case]:
    """Return the repeated presses under the GelSight-like sensor.

    And the nominal press under each calibration. A trial has the specimen, pose and load of the
    same trial of contact-FPP.

    Raises
    ------
    InputError
        A press of contact-FPP, whose force the sensor shares, fails.
    """
    # What is scored comes from the experiment, as specimen and load do.
    experiment = vary(experiment, {"score.regions_mm": [FOOTPRINT_MM]})
    given, found = inputs(), []
    for number in range(trials + 1):
        drawn = draw(experiment, given.inputs, given.seed, number)
        found.append(_colour_case(TRIALS, drawn, number))
    return found + [_colour_case(CALIBRATION, experiment, n) for n in range(CALIBRATIONS)]


def _colour_case(part: str, experiment: Experiment, number: int) -> Case:
    case = case_for(experiment, "photometric_stereo", plan_of(number))
    return case_of({PART: part, TRIAL: number}, case, Conditions(number))


def figures_by_decoder(done: Measurement) -> dict[str, Any]:
    """Return the balls' figures of one image by every decoder, each under its name."""
    found: dict[str, Any] = {}
    for one in done.colours.decoded:
        found |= _by_decoder(one)
    return found


def _by_decoder(one: DecodedImage) -> dict[str, Any]:
    return {
        f"{one.colour_map}_{one.integration}_{name}": value
        for name, value in metrics(one.score).items()
        if name.startswith("sphere_") or name == "z_rmse_um"
    }


def trials_among(cases: Sequence[Case], found: Mapping[str, Figures]) -> list[Trial]:
    """Return the trials in their order, by the figures of each case's digest.

    Trial 0 has the balls' radii under every calibration, too.
    """
    redone = {
        f"calibration_{case.settings[TRIAL]}_{name}": value
        for case in cases
        if case.settings[PART] == CALIBRATION
        for name, value in found[case.digest].items()
        if name.startswith("sphere_") and name.endswith("_radius_mm") and "true" not in name
    }
    numbered = {case.settings[TRIAL]: case for case in cases if case.settings[PART] == TRIALS}
    trials = [Trial(number, found[numbered[number].digest]) for number in sorted(numbered)]
    return [Trial(0, {**trials[0].figures, **redone}), *trials[1:]]
