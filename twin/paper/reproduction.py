"""What a reproduction measures: each thing once, kept in small files and then taken from there."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from twin.config import digest
from twin.config.board import load_board
from twin.config.methods import Method
from twin.paper.bare_nut import NUT, ROUGHNESS, nut_shares
from twin.paper.budget import Part, parts_of
from twin.paper.colours import ColourTrials, plan_of
from twin.paper.complete_table import measure_case
from twin.paper.plan import (
    BALLS,
    BUDGET_OF,
    CASES,
    COARSE,
    RODS,
    experiment_of,
    fringe_repeats,
)
from twin.paper.published import CONTACT_FPP, GELSIGHT
from twin.paper.repeats import Trial, kept
from twin.paper.rig_draws import BOARD, RigScatter, calibrate_rig, rig_scatter
from twin.paper.scatter import Scatter, load_scatter
from twin.pipeline.comparison import measure_each
from twin.pipeline.memory import Memory
from twin.pipeline.progress import ProgressCallback, no_progress


@dataclass(frozen=True, eq=False)
class Reproduction:
    """One run: where it works and what it is to do.

    Attributes
    ----------
    work : folder of what was measured
    trials : repetitions of every repeated measurement
    settings : laid over every experiment; resolution, never a property of the sensor
    memory : of the measurements, so that each photometric sensor is calibrated once
    """

    work: Path
    trials: int
    settings: Mapping[str, Any] = field(default_factory=lambda: dict(COARSE))
    watch: ProgressCallback = no_progress
    memory: Memory = field(default_factory=Memory)

    @property
    def scatter(self) -> Scatter:
        """Spread of the inputs."""
        return load_scatter()

    def rigs(self) -> RigScatter:
        """Return the rig and what a calibration leaves open of it."""
        experiment = experiment_of(BALLS, self.settings)
        named = f"{digest(experiment)} {load_board(BOARD).model_dump_json()}"
        path = self.work / "calibration.json"
        return rig_scatter(
            experiment, kept(path, named, lambda: calibrate_rig(experiment, self.watch))
        )

    def fringe_trials(self, name: str, numbers: Iterable[int] | None = None) -> list[Trial]:
        """Return the repeated contact-FPP measurement of a specimen: some trials, or all."""
        repeats = fringe_repeats(name, self.scatter, self.rigs(), self.settings)
        asked = range(self.trials + 1) if numbers is None else numbers
        return list(repeats.trials(self.work / "trials", list(asked), self.watch))

    def colour_trials(self) -> ColourTrials:
        """Return the repeated presses of the two balls under the GelSight-like sensor."""
        experiment = experiment_of(BALLS, self.settings)
        return ColourTrials(
            experiment, self.scatter, self.work / "trials", self.trials, self.memory
        )

    def ball_trials(self) -> dict[str, list[Trial]]:
        """Return the repeated measurements of the two balls by method."""
        colours = self.colour_trials().all(self.watch)
        return {GELSIGHT: colours, CONTACT_FPP: self.fringe_trials(BALLS)}

    def rod_trials(self) -> dict[str, list[Trial]]:
        """Return the repeated measurements of the rods: A, B, C."""
        return {name[-1].upper(): self.fringe_trials(name) for name in RODS}

    def budget(self, name: str) -> list[Part]:
        """Return what the inputs add to the uncertainty of a specimen's figure."""
        experiment = experiment_of(name, self.settings)
        named = f"slope and bend {digest(experiment)} {self.scatter.model_dump_json()}"
        compute = partial(parts_of, experiment, self.scatter, BUDGET_OF[name])
        path = self.work / "budgets" / f"{name}.json"
        found = kept(path, named, lambda: {"parts": [asdict(part) for part in compute()]})
        return [Part(**part) for part in found["parts"]]

    def bare_nut(self) -> dict[str, list[float]]:
        """Return how much of the bare nut is seen, by its roughness; see `nut_shares`."""
        experiment = experiment_of(NUT, self.settings)
        named = f"{digest(experiment)} {ROUGHNESS}"
        path = self.work / "bare_nut.json"
        found: dict[str, list[float]] = kept(path, named, lambda: nut_shares(experiment))
        return found

    def all_cases(self) -> Path:
        """Measure every specimen of the figures; return the folder of the cases."""
        for names, methods in CASES:
            self.cases(names, methods)
        return self.work / "cases"

    def cases(self, names: Iterable[str], methods: tuple[Method, ...]) -> None:
        """Measure specimens by methods into the folder of the cases."""
        experiments = [experiment_of(name, self.settings) for name in names]
        measure_each(
            experiments,
            methods,
            self.work / "cases",
            measure_case,
            watch=self.watch,
            plan=plan_of(self.scatter.seed, 0),  # the sensor of trial 0, which is in memory
            memory=self.memory,
        )
