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
from difflib import get_close_matches
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
from twin.paper.identified import (
    bounds_table,
    cases_of_pictures,
    choices_table,
    decisions_table,
    fields_table,
    identified_rows_table,
    pictures_table,
    worth_table,
)
from twin.paper.page import Contents, write_paper_page
from twin.paper.plan import BALLS, CASES, COARSE, CONTACT_FPP, FINE, GELSIGHT, experiment_of
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


ALL_CASES = tuple(
    (name, method) for names, methods in CASES for name in names for method in methods
)


@dataclass(frozen=True)
class PaperTable:
    """Description of one table of the reproduction.

    Attributes
    ----------
    group : name of the group of tables that are requested together
    make : function that returns the table from the measurements of a run
    needs : groups of measurements that the table needs
    cases : function that returns (experiment's name, method) of each case of the figures that the
        table needs
    """

    group: str
    make: Callable[[Reproduction], Table]
    needs: tuple[str, ...] = ()
    cases: Callable[[], tuple[tuple[str, str], ...]] = tuple


def _identified_rows(run: Reproduction) -> Table:
    balls = run.ball_trials()
    trials = {"balls": balls[CONTACT_FPP], "gelsight": balls[GELSIGHT]}
    for letter, repeated in run.rod_trials().items():
        trials |= {f"{form}_{letter.lower()}": repeated for form in ("bar", "round")}
    return identified_rows_table(trials)


def _region(run: Reproduction) -> Table:
    run.watch("differences", 0.0)
    table = region_table(experiment_of(BALLS, run.resolution))
    run.watch("differences", 1.0)
    return table


def _height_scale(run: Reproduction) -> Table:
    return height_scale_table(experiment_of(BALLS, run.resolution).score.roi_radius_mm)


def _budget(run: Reproduction) -> Table:
    return budget_table(BALLS, run.budget(BALLS), run.fringe_trials(BALLS))


_BALLS, _DIFFERENCES, _OBJECTS = "spheres", "differences", "completeness"
_TRIALS = (*TRIALS_OF_BALLS, *TRIALS_OF_RODS)
TABLES: Mapping[str, PaperTable] = {
    "identified_fields": PaperTable("identified", lambda _: fields_table()),
    "identified": PaperTable("identified", _identified_rows, _TRIALS),
    "identified_bounds": PaperTable("identified", lambda _: bounds_table()),
    "identified_choices": PaperTable("identified", lambda _: choices_table()),
    "identified_worth": PaperTable("identified", lambda _: worth_table()),
    "identified_decisions": PaperTable("identified", lambda _: decisions_table()),
    "hardness": PaperTable("hardness", lambda _: hardness_table()),
    "rods": PaperTable("rods", lambda run: rods_table(run.rod_trials()), TRIALS_OF_RODS),
    "sphere_fit": PaperTable(
        _BALLS, lambda run: sphere_fit_table(run.ball_trials()), TRIALS_OF_BALLS
    ),
    "repeated_fit": PaperTable(
        _BALLS, lambda run: repeated_fit_table(run.ball_trials()), TRIALS_OF_BALLS
    ),
    "uncertainty": PaperTable(
        _BALLS, lambda run: uncertainty_table(run.ball_trials()), TRIALS_OF_BALLS
    ),
    "explain_decoders": PaperTable(
        _BALLS, lambda run: decoder_table(run.gelsight_trials()), ("gelsight",)
    ),
    f"budget_{BALLS}": PaperTable(_BALLS, _budget, ("budgets", TRIALS_OF_BALLS[1])),
    "completeness": PaperTable(
        _OBJECTS, lambda run: completeness_table(run.cases_folder()), cases=lambda: ALL_CASES
    ),
    "pictures": PaperTable(
        _OBJECTS, lambda run: pictures_table(run.cases_folder()), cases=cases_of_pictures
    ),
    "explain_region": PaperTable(_DIFFERENCES, _region),
    "explain_height_scale": PaperTable(_DIFFERENCES, _height_scale),
    "explain_nut": PaperTable(_DIFFERENCES, lambda run: nut_table(run.bare_nut()), ("nut",)),
}
"""Tables of the reproduction by name; `--only` takes a table, its group, or a figure."""
TABLE_GROUPS = tuple(dict.fromkeys(table.group for table in TABLES.values()))
_ONE_TABLE, _ONE_FIGURE = "tables/", "figures/"


def names_allowed() -> list[str]:
    """Return the names that `--only` takes: groups, figures, and single tables and figures."""
    single = [f"{_ONE_TABLE}{name}" for name in TABLES] + [f"{_ONE_FIGURE}{n}" for n in FIGURES]
    return [*dict.fromkeys([*TABLE_GROUPS, *FIGURES]), *single]


@dataclass(frozen=True)
class Request:
    """Request for a reproduction.

    Attributes
    ----------
    trials : number of repetitions of every repeated measurement
    only : names of groups of tables, of figures, or tables/NAME and figures/NAME; empty: all
    full : True: full resolution; False: reduced resolution with a shorter run time
    """

    trials: int
    only: tuple[str, ...] = ()
    full: bool = False

    def __post_init__(self) -> None:
        unknown = [name for name in self.only if name not in names_allowed()]
        if unknown:
            close = get_close_matches(unknown[0], names_allowed(), n=1)
            hint = f", allowed {', '.join(names_allowed())}"
            if close:
                hint = f"; did you mean {close[0]}? (twin paper --help lists all)"
            raise InputError(f"--only {unknown[0]}: found no such table or figure{hint}")

    @property
    def tables(self) -> list[str]:
        """Names of the requested tables."""
        return [
            name
            for name, table in TABLES.items()
            if not self.only or {table.group, f"{_ONE_TABLE}{name}"} & {*self.only}
        ]

    @property
    def figures(self) -> list[str]:
        """Names of the requested figures."""
        return [
            name
            for name in FIGURES
            if not self.only or {name, f"{_ONE_FIGURE}{name}"} & {*self.only}
        ]

    @property
    def cases(self) -> frozenset[tuple[str, str]]:
        """Specimen and method of every case that the requested figures and tables show."""
        drawn = [case for name in self.figures for case in FIGURES[name].cases]
        return frozenset(drawn + [case for name in self.tables for case in TABLES[name].cases()])

    @property
    def measured(self) -> set[str]:
        """Names of the groups of measurements that the requested tables and figures need."""
        shown = {"measured"} if self.cases else set()
        return shown.union(*(TABLES[name].needs for name in self.tables))


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
        run = Reproduction(out / WORK, request.trials, resolution, watch, pool, request.cases)
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
    """Return the named tables; "claims" compares them with the targets."""
    tables = {name: TABLES[name].make(run) for name in names}
    claims = claims_of(tables)
    return tables | ({"claims": claims_table(claims)} if claims else {})


def _draw(
    run: Reproduction, out: Path, names: Sequence[str], drawers: Executor
) -> dict[str, "Future[None]"]:
    """Measure the cases of the figures, then submit the drawing jobs; return these by figure."""
    folder, cases, steps = figures_folder(out), run.work / "cases", count(1)
    if any(FIGURES[name].cases for name in names):
        cases = run.cases_folder()

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
    use = f"; {row['use']}" if row["use"] else ""
    return f"{mark} {row['claim']}: {shown(row['found'], 4)} ({row['allowed']}{use})"
