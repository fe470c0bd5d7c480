"""Reproduce the paper: run the required measurements once, and write tables and figures.

| in the folder | content |
|---|---|
| tables.json, tables.md | tables with rows of paper and twin, and comparison with targets |
| figures/NAME.png, NAME.pdf | every figure |
| report.html | all tables and figures on one page |
| work/ | measurements: calibration, trials, cases; an interrupted run is resumed from these |
"""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

from reconstruction.errors import InputError
from reconstruction.machine import unwritable
from reconstruction.writing import write_text
from twin.output import (
    EXPERIMENT_FILE,
    RESULT_FILE,
    adding,
    alone_in,
    claim,
    versions,
    write_json,
)
from twin.paper.budget import budget_table
from twin.paper.claims import claims_of, claims_table
from twin.paper.completeness import completeness_table
from twin.paper.explanations import (
    decoder_table,
    height_scale_table,
    nut_table,
    region_table,
)
from twin.paper.figures import FIGURES, draw_figure
from twin.paper.identified import identified_tables, pictures_table
from twin.paper.page import Contents, write_paper_page
from twin.paper.plan import BALLS, COARSE, CONTACT_FPP, FINE, GELSIGHT, experiment_of
from twin.paper.reproduction import TRIALS_OF_BALLS, TRIALS_OF_RODS, Reproduction
from twin.paper.rod_table import hardness_table, rods_table
from twin.paper.sphere_tables import repeated_fit_table, sphere_fit_table, uncertainty_table
from twin.paper.trials import inputs
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.report.page import FIGURES_FOLDER, REPORT_FILE, figures_folder
from twin.report.table import Cell, Table
from twin.report.words import shown
from twin.results.parts import write_result
from twin.study.workers import lasting, local_workers, opened

COMMAND, WORK = "paper", "work"
_NAMES = (
    *("tables.json", "tables.md", REPORT_FILE, FIGURES_FOLDER),
    *(RESULT_FILE, EXPERIMENT_FILE),
)


def sphere_tables(run: Reproduction) -> list[Table]:
    """Return the tables on the two balls: sphere fits, uncertainty, decoders, ranked budget."""
    trials = run.ball_trials()
    return [
        sphere_fit_table(trials),
        repeated_fit_table(trials),
        uncertainty_table(trials),
        decoder_table(trials[GELSIGHT]),
        budget_table(BALLS, run.budget(BALLS), trials[CONTACT_FPP]),
    ]


def rod_tables(run: Reproduction) -> list[Table]:
    """Return the table of the rod widths, in a list."""
    return [rods_table(run.rod_trials())]


def difference_tables(run: Reproduction) -> list[Table]:
    """Return the tables on possible reasons for differences between twin and paper."""
    run.watch("differences", 0.0)
    balls = experiment_of(BALLS, run.resolution)
    tables = [region_table(balls), height_scale_table(balls.score.roi_radius_mm)]
    run.watch("differences", 1.0)
    return [*tables, nut_table(run.bare_nut())]


def sensor_tables(run: Reproduction) -> list[Table]:
    """Return the tables of the identification, compared with the trials of balls and rods."""
    balls = run.ball_trials()
    trials = {"balls": balls[CONTACT_FPP], "gelsight": balls[GELSIGHT]}
    for letter, repeated in run.rod_trials().items():
        trials |= {f"{form}_{letter.lower()}": repeated for form in ("bar", "round")}
    return identified_tables(trials)


def object_tables(run: Reproduction) -> list[Table]:
    """Return the tables on the objects in the paper's pictures: completeness, and limits."""
    cases = run.all_cases()
    return [completeness_table(cases), pictures_table(cases)]


TABLES: Mapping[str, Callable[[Reproduction], list[Table]]] = {
    "identified": sensor_tables,
    "hardness": lambda _: [hardness_table()],
    "rods": rod_tables,
    "spheres": sphere_tables,
    "completeness": object_tables,
    "differences": difference_tables,
}


_NEEDS: Mapping[str, tuple[str, ...]] = {
    "identified": (*TRIALS_OF_BALLS, *TRIALS_OF_RODS),
    "rods": TRIALS_OF_RODS,
    "spheres": (*TRIALS_OF_BALLS, "budgets"),
    "completeness": ("measured",),
    "differences": ("nut",),
}
"""Groups of measurements that each group of tables needs."""


@dataclass(frozen=True)
class Request:
    """Request for a reproduction.

    Attributes
    ----------
    trials : number of repetitions of every repeated measurement
    only : names of groups of tables, or of figures; empty: all
    full : True: full resolution; False: reduced resolution with a shorter run time
    """

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
        """Names of the requested groups of tables."""
        return [name for name in TABLES if not self.only or name in self.only]

    @property
    def figures(self) -> list[str]:
        """Names of the requested figures."""
        return [name for name in FIGURES if not self.only or name in self.only]

    @property
    def measured(self) -> set[str]:
        """Names of the groups of measurements that the requested tables and figures need."""
        drawn = {"measured"} if any(FIGURES[name].cases for name in self.figures) else set()
        return drawn.union(*(_NEEDS.get(name, ()) for name in self.tables))


@dataclass(frozen=True)
class Reproduced:
    """Result of a run: path of the page, and one line of text per compared target."""

    page: Path
    lines: tuple[str, ...]


def reproduce(
    out: Path, request: Request, watch: ProgressCallback = no_progress, workers: int = 1
) -> Reproduced:
    """Write the requested tables and figures into `out`; reuse measurements stored in `out`.

    Parameters
    ----------
    workers : number of parallel processes; it does not change the result

    Raises
    ------
    InputError
        `out` has other content or cannot be written, another process uses it, or a press or fit
        fails.
    MissingBackend
        No usable Dr.Jit backend.
    """
    claim(out, COMMAND, _NAMES)
    resolution = FINE if request.full else COARSE
    with (
        alone_in(out),
        lasting(local_workers(workers)) as pool,
        adding(out, *_NAMES) as folder,
    ):
        _make_folder(out / WORK)
        run = Reproduction(out / WORK, request.trials, resolution, watch, pool)
        return _reproduce(out, folder, request, run)


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise unwritable(folder, error) from None


def _reproduce(out: Path, folder: Path, request: Request, run: Reproduction) -> Reproduced:
    """Measure into `out`/work, and write tables, figures and page into `folder`."""
    if request.measured:
        run.measure(request.measured)
    with opened(run.workers) as drawers:
        drawn = _draw(run, folder, request.figures, drawers)
        tables = tables_of(run, request.tables)
        for name, figure in drawn.items():
            try:
                figure.result()
            except BrokenExecutor:  # a worker died: draw here, where an error is reported
                draw_figure(name, run.work / "cases", figures_folder(folder))
    _write_tables(folder, tables, request)
    balls = experiment_of(BALLS, run.resolution)
    contents = Contents(tables, tuple(drawn), balls, inputs(), request.trials)
    page = write_paper_page(folder, contents)
    claims = tables["claims"].rows if "claims" in tables else ()
    write_result(folder, COMMAND, balls, _figures_of(claims))
    return Reproduced(out / page.name, tuple(_line(row) for row in claims))


def tables_of(run: Reproduction, names: Sequence[str]) -> dict[str, Table]:
    """Return the tables of the named groups by name; "claims" compares them with the targets."""
    tables = {table.name: table for name in names for table in TABLES[name](run)}
    claims = claims_of(tables)
    return tables | ({"claims": claims_table(claims)} if claims else {})


def _draw(
    run: Reproduction, out: Path, names: Sequence[str], drawers: Executor
) -> dict[str, "Future[None]"]:
    """Measure the cases of the figures, then submit the drawing jobs; return these by figure."""
    folder, cases, steps = figures_folder(out), run.work / "cases", count(1)
    if any(FIGURES[name].cases for name in names):
        cases = run.all_cases()

    def report(_: "Future[None]") -> None:
        run.watch("figures", next(steps) / len(names))

    run.watch("figures", 0.0)
    drawn = {name: drawers.submit(draw_figure, name, cases, folder) for name in names}
    for figure in drawn.values():
        figure.add_done_callback(report)
    return drawn


def _write_tables(out: Path, tables: Mapping[str, Table], request: Request) -> None:
    content = {
        "schema_version": 1,
        "trials": request.trials,
        "versions": versions(),
        "tables": {name: table.as_json() for name, table in tables.items()},
    }
    write_json(out / "tables.json", content)
    text = "\n".join(table.as_markdown() for table in tables.values())
    write_text(out / "tables.md", text)


def _figures_of(claims: Sequence[Mapping[str, Cell]]) -> dict[str, Any]:
    met = sum(row["met"] == "yes" for row in claims)
    return {"claims": len(claims), "claims_met": met}


def _line(row: Mapping[str, Cell]) -> str:
    mark = "met   " if row["met"] == "yes" else "MISSED"
    return f"{mark} {row['claim']}: {shown(row['found'], 4)} ({row['allowed']})"
