"""Reproduce the paper: measure what its tables and figures need, each thing once, and write them.

| in the folder | content |
|---|---|
| tables.json, tables.md | every table, the paper's rows beside the twin's, and the claims |
| figures/NAME.png, NAME.pdf | every figure |
| report.html | all of it on one page |
| work/ | what was measured: calibration, trials, cases; an interrupted run goes on from here |
"""

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from reconstruction.errors import InputError
from twin.config import digest
from twin.config.board import load_board
from twin.modalities.comparison import compare
from twin.modalities.instruments import Method
from twin.modalities.progress import Watcher, nobody
from twin.modalities.storage import write_result
from twin.output import replace_json, versions
from twin.paper.budget import budget_table
from twin.paper.claims import claims_of, claims_table
from twin.paper.colours import colour_trials, plan_of
from twin.paper.complete_table import completeness_table, measure_case
from twin.paper.explanations import explanations
from twin.paper.figures import FIGURES, draw_figure
from twin.paper.page import Contents, write_paper_page
from twin.paper.plan import (
    BALLS,
    COARSE,
    DIRECT_AND_CONTACT,
    FINE,
    GRID,
    RODS,
    experiment_of,
    fringe_repeats,
)
from twin.paper.published import CONTACT_FPP, GELSIGHT
from twin.paper.repeats import Trial, kept
from twin.paper.rig_draws import BOARD, RigScatter, calibrate_rig, rig_scatter
from twin.paper.rod_table import hardness_table, rods_table
from twin.paper.scatter import Scatter, load_scatter
from twin.paper.sphere_tables import repeated_fit_table, sphere_fit_table, uncertainty_table
from twin.paper.table import Cell, Table, shown
from twin.report.html import FIGURES_FOLDER, make_folder

COMMAND, WORK = "paper", "work"
CASES: Sequence[tuple[tuple[str, ...], tuple[Method, ...]]] = (
    (DIRECT_AND_CONTACT, ("direct_fpp", "contact_fpp")),
    (GRID, ("photometric_stereo", "contact_fpp")),
    (RODS, ("contact_fpp",)),
)


@dataclass(frozen=True, eq=False)
class Reproduction:
    """One run: where it works and what it is to do.

    Attributes
    ----------
    work : folder of what was measured
    trials : repetitions of every repeated measurement
    settings : laid over every experiment; resolution, never a property of the sensor
    """

    work: Path
    trials: int
    settings: Mapping[str, Any] = field(default_factory=lambda: dict(COARSE))
    watch: Watcher = nobody

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

    def fringe_trials(self, name: str) -> list[Trial]:
        """Return the repeated contact-FPP measurement of a specimen."""
        repeats = fringe_repeats(name, self.scatter, self.rigs(), self.settings)
        return list(repeats.trials(self.work / "trials", self.trials, self.watch))

    def ball_trials(self) -> dict[str, list[Trial]]:
        """Return the repeated measurements of the two balls by method."""
        experiment = experiment_of(BALLS, self.settings)
        folder = self.work / "trials"
        colours = colour_trials(experiment, self.scatter, folder, self.trials, self.watch)
        return {GELSIGHT: colours, CONTACT_FPP: self.fringe_trials(BALLS)}

    def rod_trials(self) -> dict[str, list[Trial]]:
        """Return the repeated measurements of the rods: A, B, C."""
        return {name[-1].upper(): self.fringe_trials(name) for name in RODS}

    def cases(self) -> Path:
        """Measure every specimen of the figures; return the folder of the cases."""
        folder = self.work / "cases"
        plan = plan_of(self.scatter.seed, 0)  # the sensor of trial 0, which is in memory
        for names, methods in CASES:
            experiments = [experiment_of(name, self.settings) for name in names]
            compare(experiments, methods, folder, measure_case, watch=self.watch, plan=plan)
        return folder


def sphere_tables(run: Reproduction) -> list[Table]:
    """Return the tables on the two balls."""
    trials = run.ball_trials()
    balls = experiment_of(BALLS, run.settings)
    budget = budget_table(
        balls, run.scatter, trials[CONTACT_FPP], "sphere_1_radius_mm", optics=True
    )
    return [
        sphere_fit_table(trials),
        repeated_fit_table(trials),
        uncertainty_table(trials),
        budget,
    ]


def rod_tables(run: Reproduction) -> list[Table]:
    """Return the tables on the rods."""
    trials = run.rod_trials()
    budgets = [
        budget_table(
            experiment_of(name, run.settings),
            run.scatter,
            trials[name[-1].upper()],
            "rod_width_mm",
        )
        for name in RODS
    ]
    return [rods_table(trials), *budgets]


def difference_tables(run: Reproduction) -> list[Table]:
    """Return the experiments on where twin and paper differ."""
    run.watch("differences", 0.0)
    rods = {name: experiment_of(name, run.settings) for name in RODS}
    found = explanations(experiment_of(BALLS, run.settings), rods)
    run.watch("differences", 1.0)
    return found


TABLES: Mapping[str, Callable[[Reproduction], list[Table]]] = {
    "hardness": lambda _: [hardness_table()],
    "rods": rod_tables,
    "spheres": sphere_tables,
    "completeness": lambda run: [completeness_table(run.cases())],
    "differences": difference_tables,
}


@dataclass(frozen=True)
class Wish:
    """What is asked for: repetitions, names of tables or figures (empty: all), all pixels."""

    trials: int
    only: tuple[str, ...] = ()
    full: bool = False

    def __post_init__(self) -> None:
        unknown = [name for name in self.only if name not in {*TABLES, *FIGURES}]
        if unknown:
            raise InputError(
                f"--only {unknown[0]}: found no such table or figure, allowed "
                f"{', '.join([*TABLES, *FIGURES])}"
            )

    @property
    def tables(self) -> list[str]:
        """Groups of tables that are asked for."""
        return [name for name in TABLES if not self.only or name in self.only]

    @property
    def figures(self) -> list[str]:
        """Figures that are asked for."""
        return [name for name in FIGURES if not self.only or name in self.only]


@dataclass(frozen=True)
class Reproduced:
    """What a run left: the page, and the claims in lines."""

    page: Path
    lines: tuple[str, ...]


def reproduce(out: Path, wish: Wish, watch: Watcher = nobody) -> Reproduced:
    """Make everything asked for and write it into `out`; what lies there already is used.

    Raises
    ------
    InputError
        `out` holds something else or cannot be written, or a press or fit fails.
    MissingBackend
        No usable Dr.Jit backend.
    """
    _claim_folder(out)
    settings = dict(FINE if wish.full else COARSE)
    run = Reproduction(out / WORK, wish.trials, settings, watch)
    tables = tables_of(run, wish.tables)
    drawn = _figures(run, out, wish)
    _write_tables(out, tables, wish)
    balls = experiment_of(BALLS, settings)
    contents = Contents(tables, drawn, balls, run.scatter, wish.trials)
    page = write_paper_page(out, contents)
    claims = tables["claims"].rows if "claims" in tables else ()
    write_result(out, COMMAND, balls, _figures_of(claims))
    return Reproduced(page, tuple(_line(row) for row in claims))


def tables_of(run: Reproduction, names: Sequence[str]) -> dict[str, Table]:
    """Make the tables of the named groups, and judge the claims by them."""
    found = {table.name: table for name in names for table in TABLES[name](run)}
    claims = claims_of(found)
    return found | ({"claims": claims_table(claims)} if claims else {})


def _figures(run: Reproduction, out: Path, wish: Wish) -> dict[str, Path]:
    folder = out / FIGURES_FOLDER
    make_folder(folder)
    needed = any(FIGURES[name].cases for name in wish.figures)
    cases = run.cases() if needed else run.work / "cases"
    for done, name in enumerate(wish.figures):
        run.watch("figures", done / len(wish.figures))
        draw_figure(name, cases, folder)
    run.watch("figures", 1.0)
    return {name: folder / f"{name}.png" for name in wish.figures}


def _claim_folder(out: Path) -> None:
    """Refuse a folder of something else; keep an earlier or interrupted run of this command."""
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: is a file; choose another -o DIR")
    foreign = out.is_dir() and any(out.iterdir()) and not (out / WORK).is_dir()
    if foreign:
        raise InputError(
            f"{out}: exists and holds no earlier run of twin {COMMAND} (no {WORK}/); "
            "choose another -o DIR"
        )
    # What a killed run was writing lies under hidden names; nothing refers to it.
    for leftover in out.glob(f"{WORK}/cases/*/.*"):
        shutil.rmtree(leftover, ignore_errors=True)
    try:
        (out / WORK).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out}: cannot be written ({error.strerror})") from None


def _write_tables(out: Path, tables: Mapping[str, Table], wish: Wish) -> None:
    content = {
        "schema_version": 1,
        "trials": wish.trials,
        "versions": versions(),
        "tables": {name: table.as_json() for name, table in tables.items()},
    }
    replace_json(out / "tables.json", content)
    text = "\n".join(table.as_markdown() for table in tables.values())
    (out / "tables.md").write_text(text, encoding="utf-8")


def _figures_of(claims: Sequence[Mapping[str, Cell]]) -> dict[str, Any]:
    met = sum(row["met"] == "yes" for row in claims)
    return {"claims": len(claims), "claims_met": met}


def _line(row: Mapping[str, Cell]) -> str:
    mark = "met   " if row["met"] == "yes" else "MISSED"
    return f"{mark} {row['claim']}: {shown(row['found'], 4)} ({row['allowed']})"
