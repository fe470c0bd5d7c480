"""Run the measurements of a reproduction; each case is measured once and stored in a folder.

| in work/ | content |
|---|---|
| calibration.json | covariance of the rig after its calibration |
| calibrations/ | calibrations of the GelSight-like sensor |
| trials/NAME/ | studies of the repeated measurements; `twin report` draws their uncertainty |
| gelsight/ | repeated presses under the GelSight-like sensor |
| budgets/, nut/, measured/ | cases of the budgets, of the bare nut and of the figures |
| cases/NAME/METHOD | links to the cases that the figures show, including nominal trials |

All cases that the requested tables and figures need are run in one queue (`Reproduction.measure`),
so that no worker waits for the end of a study.
"""

import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from reconstruction.errors import InputError
from twin.config import Experiment, vary
from twin.config.methods import TRAITS, Method
from twin.paper.completeness import COMPLETENESS_FILE, files_for_figures, shares_of
from twin.paper.plan import (
    BALLS,
    BUDGET_OF,
    CASES,
    COARSE,
    CONTACT_FPP,
    GELSIGHT,
    NUT,
    RODS,
    Resolution,
    experiment_of,
)
from twin.paper.trials import (
    BOARD,
    REFUSED,
    Trial,
    colour_cases,
    figures_by_decoder,
    fringe_study,
    handling,
    plan_of,
    trials_among,
)
from twin.pipeline.comparison import case_for
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.propagation.budget import Part, part_of
from twin.study.cases import Case, Cases, case_of
from twin.study.measuring import DEFAULT_MEASURING, Measuring, RigCovariance, calibrated
from twin.study.outcome import SweepOutcome
from twin.study.store import Store
from twin.study.sweep import CaseGroup, run_groups
from twin.study.trials import INPUT, PART, STEP, TRIAL, TRIALS, alone_cases
from twin.study.worker import MakeMeasurer
from twin.study.workers import Workers, local_workers

ROUGHNESS = (0.05, 0.1, 0.2, 0.4)
# Of the camera from the vertical; the projector is opposite, at a constant angle to the camera.
CAMERA_TILT_DEG = (0.0, 6.25, 12.5)
_FOR_FIGURES = Measuring(further=files_for_figures)
# Binning 4 x 4 takes 25 % of the run time; a note of the table states it.
_BARE_NUT = {"modality": "direct_fpp", "camera.binning": 4}


@dataclass(frozen=True, eq=False)
class Reproduction:
    """Measurements of one run of the reproduction: run them, and read the stored results.

    Attributes
    ----------
    work : folder of the measurements
    trials : number of repetitions of every repeated measurement
    resolution : numerical resolution of every experiment
    watch : called with the progress
    workers : processes for the measurements; their number does not change the results
    shown : (specimen, method) of the cases that figures and tables show; None: all
    """

    work: Path
    trials: int
    resolution: Resolution = COARSE
    watch: ProgressCallback = no_progress
    workers: Workers = field(default_factory=lambda: local_workers(1))
    shown: frozenset[tuple[str, str]] | None = None
    _made: dict[str, CaseGroup] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def rigs(self) -> RigCovariance:
        """Covariance of the rig's parameters after a calibration, the same for all specimens."""
        return calibrated(self.work, self._experiment(BALLS), BOARD, self.watch)

    def measure(self, names: Collection[str]) -> None:
        """Measure groups of cases in parallel and store the results for tables and figures.

        Parameters
        ----------
        names : names of groups, from `GROUPS`

        Raises
        ------
        InputError
            A folder cannot be used.
        MissingBackend
            No usable Dr.Jit backend.
        """
        groups = [self._group(name) for name in GROUPS if name in names]
        if "measured" in names:
            alone = [name for name in self._nominal_names if _trials(name) not in names]
            groups = [self._nominal(name) for name in alone] + groups
        run_groups(groups, self.workers, self.watch)

    def fringe_trials(self, name: str) -> list[Trial]:
        """Return the trials of the repeated contact-FPP measurement of a specimen."""
        return self._trials_of(_trials(name))

    def ball_trials(self) -> dict[str, list[Trial]]:
        """Return the trials of the repeated measurements of the two balls, by method."""
        return {GELSIGHT: self.gelsight_trials(), CONTACT_FPP: self.fringe_trials(BALLS)}

    def gelsight_trials(self) -> list[Trial]:
        """Return the trials of the repeated presses under the GelSight-like sensor."""
        return self._trials_of("gelsight")

    def _trials_of(self, group: str) -> list[Trial]:
        return trials_among(self._group(group).cases.run, self._figures(group))

    def rod_trials(self) -> dict[str, list[Trial]]:
        """Return the trials of the repeated measurements of the rods, by letter: A, B, C."""
        return {name[-1].upper(): self.fringe_trials(name) for name in RODS}

    def budget(self, name: str) -> list[Part]:
        """Return the contribution of every input to the uncertainty of `BUDGET_OF[name]`.

        The effect of an input is computed on the pressed face. Optical inputs are varied for the
        balls only, through the whole measurement chain, with two renders each. In the trials of a
        rod, the contribution of the noise includes the optics.

        Raises
        ------
        InputError
            A press fails for an input that is one standard uncertainty from its nominal value.
        MissingBackend
            No usable Dr.Jit backend.
        """
        figures, output = self._figures("budgets"), BUDGET_OF[name]
        parts = [self._part_of(output, cases, figures) for cases in self._budget_cases(name)]
        return [part for some in parts for part in some]

    def _budget_cases(self, name: str) -> list[list[Case]]:
        experiment, given = self._experiment(name), handling().inputs
        optics = {title: i for title, i in given.items() if i.group == "optics"}
        cases = [alone_cases(experiment, given, face_only=True)]
        if name == BALLS:
            cases.append(alone_cases(experiment, optics))
        return cases

    def _part_of(
        self, output: str, cases: Sequence[Case], by_digest: Mapping[str, Mapping[str, Any]]
    ) -> list[Part]:
        """Return the contributions to `output` of the inputs that these cases vary.

        Parameters
        ----------
        by_digest : measured values of each case, by the case's digest
        """
        values = {(c.settings[INPUT], c.settings[STEP]): by_digest[c.digest] for c in cases}
        middle = {step: figures[output] for (title, step), figures in values.items() if not title}
        parts = []
        for title in dict.fromkeys(title for title, _ in values if title):
            steps = {
                step: figures.get(output) for (of, step), figures in values.items() if of == title
            }
            part = part_of(title, handling().inputs[title], middle | steps)
            if part is None:
                raise InputError(f"budget of {output}: {title}: found no figure at its steps")
            parts.append(part)
        return parts

    def bare_nut(self) -> dict[tuple[float, float], list[float]]:
        """Return the shares of the bare nut's pixels with a good point and with any point.

        The keys are the tilt of the camera from the vertical (deg) and the steel's GGX alpha.

        Raises
        ------
        InputError, MissingBackend
            As `measure`; or the nut is not in the camera's view.
        """
        figures, shares = self._figures("nut"), {}
        for case in self._nut_cases():
            measured = figures[case.digest]
            both = [measured[f"share_{name}"] for name in ("specimen", "specimen_points")]
            if None in both:
                raise InputError(f"{NUT}: the specimen is not in the camera's view")
            shares[case.settings["tilt_deg"], case.settings["alpha"]] = both
        return shares

    def _nut_cases(self) -> list[Case]:
        return [
            case_of({"tilt_deg": tilt, "alpha": alpha}, self._bare_nut_at(tilt, alpha))
            for tilt in CAMERA_TILT_DEG
            for alpha in ROUGHNESS
        ]

    def _bare_nut_at(self, tilt_deg: float, alpha: float) -> Experiment:
        """Return the experiment of the bare nut with a tilted camera and roughness `alpha`.

        The angle between camera and projector remains constant.
        """
        bare = vary(self._experiment(NUT), _BARE_NUT)
        between_deg = bare.camera.pose.polar_deg + bare.projector.pose.polar_deg
        stated = {"range": [0.0, between_deg], "source": "varied to find what the nut shows"}
        changed = {
            "camera.pose.polar_deg": {"value": tilt_deg} | stated,
            "projector.pose.polar_deg": {"value": between_deg - tilt_deg} | stated,
            "specimen.material.roughness": alpha,
        }
        return vary(bare, changed)

    def cases_folder(self) -> Path:
        """Measure the cases that are shown; return the folder of links to them."""
        self._figures("measured")
        for (name, method), case in self._figure_cases().items():
            link(self.work / "cases" / name / method, self.work / "measured/cases" / case.digest)
        for name in self._nominal_names:
            nominal = self._nominal(name)
            (outcome,) = run_groups([nominal], self.workers, self.watch)
            _figures(nominal.cases.run, nominal.folder, outcome)
            (case,) = nominal.cases.run
            link(self.work / "cases" / name / "contact_fpp", nominal.folder / "cases" / case.digest)
        return self.work / "cases"

    def _figure_cases(self) -> dict[tuple[str, Method], Case]:
        """Return the cases of the figures, by specimen and method, except nominal trials."""
        pairs = [(name, method) for names, methods in CASES for name in names for method in methods]
        return {
            (name, method): self._case(name, method)
            for name, method in pairs
            if self._is_shown(name, method) and not (name in _REPEATED and method == _REPEATED_BY)
        }

    @property
    def _nominal_names(self) -> list[str]:
        """Specimens of which the nominal trial is shown."""
        return [name for name in _REPEATED if self._is_shown(name, _REPEATED_BY)]

    def _is_shown(self, name: str, method: Method) -> bool:
        return self.shown is None or (name, method) in self.shown

    def _nominal(self, name: str) -> CaseGroup:
        """Return a group of only the nominal trial of a repeated measurement, with the true rig."""
        record, folder = (
            fringe_study(self._experiment(name), self.trials),
            self.work / _trials(name),
        )
        store, nominal = Store(folder), record.cases().run[0]
        done = store.path_of(nominal.digest)
        if done.is_dir() and not (done / COMPLETENESS_FILE).exists():
            store.forget(nominal.digest)  # measured when the figures had cases of their own
        return CaseGroup(folder, Cases((nominal,), 0), _FOR_FIGURES, record)

    def _case(self, name: str, method: Method) -> Case:
        experiment = self._experiment(name)
        settings = {"specimen": name, "method": TRAITS[method].title}
        return case_of(settings, case_for(experiment, method, plan_of(0)))

    def _figures(self, name: str) -> dict[str, dict[str, Any]]:
        """Measure the missing cases of a group; return the measured values by the case's digest."""
        group = self._group(name)
        (outcome,) = run_groups([group], self.workers, self.watch)
        return _figures(group.cases.run, group.folder, outcome)

    def _group(self, name: str) -> CaseGroup:
        if name not in self._made:
            self._made[name] = self._new_group(name)
        return self._made[name]

    def _new_group(self, name: str) -> CaseGroup:
        folder = self.work / name
        match name:
            case "gelsight":
                cases = colour_cases(self._experiment(BALLS), self.trials)
                # Cases with the same calibration of the sensor are consecutive.
                cases.sort(key=lambda case: case.experiment.seed)
                make = Measuring(more=figures_by_decoder, calibrations=self._calibrations)
                return _group(folder, cases, make)
            case "budgets":
                parts = [part for of in BUDGET_OF for part in self._budget_cases(of)]
                return _group(folder, [case for part in parts for case in part], DEFAULT_MEASURING)
            case "measured":
                return _group(
                    folder,
                    self._figure_cases().values(),
                    replace(_FOR_FIGURES, calibrations=self._calibrations),
                )
            case "nut":
                return _group(folder, self._nut_cases(), Measuring(more=shares_of))
        record = fringe_study(self._experiment(folder.name), self.trials)
        make = replace(_FOR_FIGURES, rigs=self.rigs)
        return CaseGroup(folder, record.cases(), make, record)

    @property
    def _calibrations(self) -> Path:
        return self.work / "calibrations"

    def _experiment(self, name: str) -> Experiment:
        return experiment_of(name, self.resolution)


def _trials(name: str) -> str:
    return f"trials/{name}"


_REPEATED_BY: Method = "contact_fpp"
_REPEATED = (*RODS, BALLS)
"""Specimens with repeated trials; the figures show the nominal trial of each."""
TRIALS_OF_RODS = tuple(_trials(name) for name in RODS)
TRIALS_OF_BALLS = ("gelsight", _trials(BALLS))
GROUPS = (*TRIALS_OF_RODS, "gelsight", "measured", _trials(BALLS), "budgets", "nut")
"""Names of the groups of cases, which are also their folders. Groups with long cases are first, so
that short cases fill the end of the queue."""


def _group(folder: Path, cases: Iterable[Case], make: MakeMeasurer) -> CaseGroup:
    return CaseGroup(folder, Cases(tuple(cases), 0), make)


def _figures(
    cases: Sequence[Case], folder: Path, outcome: SweepOutcome
) -> dict[str, dict[str, Any]]:
    """Return the measured values of each case, by the case's digest.

    The only value of a failed repeated trial is the reason, under the name `REFUSED`.

    Raises
    ------
    InputError
        A case that is no repeated trial failed, or a case could not be saved.
    """
    store, figures = Store(folder), {}
    for case in cases:
        content = store.read(case.digest) or {"failure": outcome.unsaved.get(case.digest, "lost")}
        if "metrics" not in content and _is_repeated(case) and "failure" in content:
            # The drawn sheet may have no equilibrium at the drawn pressure: the tables count it.
            content["metrics"] = {REFUSED: content["failure"]}
        if "metrics" not in content:
            at = f", trial {case.settings[TRIAL]}" if TRIAL in case.settings else ""
            raise InputError(f"{case.experiment.name}{at}: {content['failure']}")
        figures[case.digest] = content["metrics"]
    return figures


def _is_repeated(case: Case) -> bool:
    return case.settings.get(PART) == TRIALS and case.settings[TRIAL] > 0


def link(path: Path, target: Path) -> None:
    """Create a symbolic link at `path` to `target`, or replace an earlier link.

    Raises
    ------
    InputError
        `path` is a file or folder.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.exists() and not path.is_symlink():
        raise InputError(f"{path}: found a file or folder, allowed a link; move or delete it")
    with suppress(FileNotFoundError):
        path.unlink()
    path.symlink_to(os.path.relpath(target, path.parent))
