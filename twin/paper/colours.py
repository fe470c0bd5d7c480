"""Repeated presses of the two balls under the GelSight-like sensor, decoded as the paper did.

The sensor is calibrated anew several times, on reference presses drawn from another seed each; a
trial uses one of these calibrations. The press has the specimen, pose and load of the same trial of
contact-FPP.
"""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from twin.config import Experiment, digest
from twin.paper.repeats import Figures, Repeated, Trial
from twin.paper.scatter import Scatter
from twin.pipeline.instruments import PhotometricPlan, case_for
from twin.pipeline.memory import Memory
from twin.pipeline.methods import measure
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.results.decoders import DecodedImage
from twin.results.score import metrics

CALIBRATIONS = 5
# The paper's pipeline: a look-up table, then integration as in the vendor's programs of its time.
PAPER_DECODER = {"photometric.colour_map": "table", "photometric.integration": "sdk_2024"}


def plan_of(seed: int, trial: int) -> PhotometricPlan:
    """Return sensor and decoder of a trial; its reference presses are one of five sets."""
    settings: dict[str, Any] = {**PAPER_DECODER, "seed": seed + trial % CALIBRATIONS}
    return PhotometricPlan(settings=settings)


def measure_colours(seed: int, memory: Memory, experiment: Experiment, trial: int) -> Figures:
    """Measure once; the paper's decoder under plain names, every decoder under its own."""
    case = case_for(experiment, "photometric_stereo", plan_of(seed, trial))
    measured = measure(case, memory=memory, trial=trial)
    figures = metrics(measured.score)
    for one in measured.colours.decoded:
        figures |= _by_decoder(one)
    return figures | {name: measured.figures[name] for name in ("depth_mm", "force_n")}


def _by_decoder(one: DecodedImage) -> Figures:
    found = metrics(one.score)
    return {
        f"{one.colour_map}_{one.integration}_{name}": value
        for name, value in found.items()
        if name.startswith("sphere_") or name == "z_rmse_um"
    }


@dataclass(frozen=True, eq=False)
class ColourTrials:
    """The repeated presses of an experiment: trials 0 to `count`, kept in `folder`.

    `memory` holds the sensor that the trials share.
    """

    experiment: Experiment
    scatter: Scatter
    folder: Path
    count: int
    memory: Memory

    def all(self, watch: ProgressCallback = no_progress) -> list[Trial]:
        """Return every trial; trial 0 also holds the nominal press under every calibration.

        Raises
        ------
        InputError, MissingBackend
            As `measure`.
        """
        found, nominal = [], {}
        # The first calibration comes last: it is still in memory for the cases of the figures.
        for done, calibration in enumerate(reversed(range(CALIBRATIONS))):
            watch(f"trials of {self._name}", done / CALIBRATIONS)
            nominal[calibration], trials = self.of_calibration(calibration)
            found += trials
        watch(f"trials of {self._name}", 1.0)
        found.sort(key=lambda one: one.number)
        return [_with_calibrations(found[0], nominal), *found[1:]]

    def of_calibration(self, calibration: int) -> tuple[Figures, list[Trial]]:
        """Return the nominal press under one calibration, and the trials that use it."""
        measured = partial(measure_colours, self.scatter.seed, self.memory)
        named = _sensor_digest(self.experiment, self.scatter)
        presses = Repeated(self._name, self.experiment, self.scatter, measured, named)
        still = self.scatter.model_copy(update={"inputs": {}})
        nominal = Repeated(f"{self._name}_calibrations", self.experiment, still, measured, named)
        numbers = range(calibration, self.count + 1, CALIBRATIONS)
        found = [presses.trial(self.folder, number) for number in numbers]
        return nominal.trial(self.folder, calibration).figures, found

    @property
    def _name(self) -> str:
        return f"{self.experiment.name}_photometric_stereo"


def _sensor_digest(experiment: Experiment, scatter: Scatter) -> str:
    """Name sensor, decoder and seed by content; at equal depth, which needs no press."""
    plan = replace(plan_of(scatter.seed, 0), match="depth")
    return digest(case_for(experiment, "photometric_stereo", plan))


def _with_calibrations(trial: Trial, redone: dict[int, Figures]) -> Trial:
    radii = {
        f"calibration_{number}_{name}": value
        for number, figures in redone.items()
        for name, value in figures.items()
        if name.startswith("sphere_") and name.endswith("_radius_mm") and "true" not in name
    }
    return Trial(trial.number, trial.drawn, trial.figures | radii)
