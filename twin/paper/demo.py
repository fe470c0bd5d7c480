"""Demo: the identified model of the paper's sensor measures the paper's balls, nut and brick.

| in the folder | content |
|---|---|
| result.json, ... | the measurement of the balls, with the files of `twin measure` |
| nut/, brick/ | the measurements of nut and brick, with the same files |
| report.html | all measurements; its first section compares true object, paper and twin |
"""

from collections.abc import Sequence
from concurrent.futures import as_completed
from dataclasses import replace
from pathlib import Path

from reconstruction.errors import InputError
from twin.output import RESULT_FILE
from twin.paper.plan import (
    BALLS,
    CONTACT_FPP,
    FIT,
    NOMINAL_RADIUS_MM,
    NUT,
    Resolution,
    experiment_of,
    rows_of,
)
from twin.pipeline.methods import measure_into
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.report.measurement import page_of
from twin.report.object import object_section
from twin.report.page import REPORT_FILE, Figure, Page, Section, write_page
from twin.report.surfaces import height_map_figure, relief_figure
from twin.report.table import Cell, Column, Table
from twin.results.figures import Figures
from twin.results.folder import read_measurement
from twin.results.record import Measurement
from twin.study.workers import default_count, local_workers

COMMAND = "demo"
FURTHER = (NUT, "brick")
"""Specimens measured in addition to the balls; the folder of each has the specimen's name."""

DemoParts = tuple[Measurement, Sequence[Measurement]]
"""Measurement of the balls, and those of the further specimens."""


def is_demo(folder: Path) -> bool:
    """Return True if a folder contains the results of the demo's further specimens."""
    return all((folder / name / RESULT_FILE).is_file() for name in FURTHER)


def measure_demo(folder: Path, resolution: Resolution, watch: ProgressCallback) -> DemoParts:
    """Measure the specimens of the demo and return the measurements.

    The results of the balls are written into `folder`, those of nut and brick into folders below
    it. The measurements run in parallel; nut and brick are started first.

    Raises
    ------
    InputError, MissingBackend
        As `twin.pipeline.measure`.
    """
    places = {name: folder / name for name in FURTHER} | {BALLS: folder}
    for name in FURTHER:
        places[name].mkdir()
    workers = local_workers(min(len(places), default_count()))
    executor = workers.open()
    watch("measure", 0.0)
    try:
        jobs = [executor.submit(_measure, place, n, resolution) for n, place in places.items()]
        for done, job in enumerate(as_completed(jobs), start=1):
            job.result()
            watch("measure", done / len(jobs))
    finally:
        workers.close(executor)
    return _parts(folder)


def _measure(folder: Path, name: str, resolution: Resolution) -> None:
    try:
        measure_into(folder, COMMAND, experiment_of(name, resolution))
    except InputError as error:
        # Subclasses of InputError may not survive pickling between processes.
        raise InputError(str(error)) from None


def _parts(folder: Path) -> DemoParts:
    return read_measurement(folder), [read_measurement(folder / name) for name in FURTHER]


def write_demo(
    folder: Path,
    watch: ProgressCallback = no_progress,
    into: Path | None = None,
    measured: DemoParts | None = None,
) -> Path:
    """Write the page of the demo and its figures; return the path of the page.

    Parameters
    ----------
    folder : folder of the demo's measurements, see `measure_demo`
    into : existing folder for the page; None: `folder`
    measured : the measurements; None: they are read from `folder`

    Raises
    ------
    InputError
        A measurement is missing or damaged, or the page cannot be written.
    """
    parts = measured or _parts(folder)
    return write_page((into or folder) / REPORT_FILE, demo_page(*parts), watch)


def demo_page(balls: Measurement, further: Sequence[Measurement]) -> Page:
    """Return the page of the demo: comparison with the paper, the balls, then nut and brick."""
    page = page_of(balls)
    views = [view for measured in further for view in _views(measured)]
    first = Section("paper", "True object, paper and twin", (paper_table(balls, further), *views))
    *sections, last = page.sections
    objects = [
        section
        for measured in further
        for section in renamed(
            object_section(measured), _name(measured), _name(measured).capitalize()
        )
    ]
    return replace(
        page,
        kind="demo: the paper's sensor, as identified",
        title="two balls, a nut and a toy brick",
        lead="Two joined 8 mm steel balls, an M6 nut and a clear brick, pressed into the coated "
        "sheet as identified from the paper's tables; decoded like captures of a real rig.",
        sections=[first, *sections, *objects, last],
    )


def renamed(sections: Sequence[Section], name: str, title: str) -> list[Section]:
    """Return copies of sections with `name` before all names and `title` before section titles.

    Names are those of sections, figures and tables. On the page of the demo, this distinguishes the
    sections from those of the balls.
    """
    return [
        Section(
            f"{name}_{section.name}",
            f"{title}: {section.title.lower()}",
            tuple(
                replace(block, name=f"{name}_{block.name}")
                if isinstance(block, Figure | Table)
                else block
                for block in section.blocks
            ),
        )
        for section in sections
    ]


def _name(measured: Measurement) -> str:
    return measured.experiment.name


def paper_table(balls: Measurement, further: Sequence[Measurement]) -> Table:
    """Return the table that compares true values, values of the paper and values of the twin."""
    rows = [row for ball in (1, 2) for row in _ball(balls, ball)]
    rows += [
        {
            "quantity": f"{_name(measured)}: deviation where the sheet touches it, RMS",
            "true": 0.0,
            "paper": "a picture",
            "twin": measured.figures.get("object_rms_um"),
            "unit": "µm",
        }
        for measured in further
    ]
    rows += [
        {
            "quantity": f"{_name(measured)}: share of a hexagon in the coat's outline",
            "true": 1.0,
            "paper": "a picture: a hexagon",
            "twin": share,
            "unit": "",
        }
        for measured in further
        if isinstance(share := measured.figures.get("nut_hexagon_share"), float)
    ]
    columns = (
        Column("quantity", "quantity"),
        Column("true", "true object", 3),
        Column("paper", "paper, ± SD of one trial", 3),
        Column("twin", "twin", 3),
        Column("unit", "unit"),
    )
    notes = (
        f"Fitted over {balls.experiment.score.roi_radius_mm:g} mm round each apex. Thickness, "
        "pressure, travel, texture and this radius are identified from the paper's tables "
        "(docs/identify.md). This is one press on one coat, and coats differ: `twin paper` repeats "
        "the measurement.",
        "The paper's fit is most probably algebraic, which gives too small a radius on a rough "
        "cap; the geometric fit of the same points is the next row. The object's radius is fitted "
        "to the touched surface, after the local sheet thickness is subtracted.",
    )
    return Table("paper", "", "", columns, tuple(rows), notes)


def _ball(balls: Measurement, ball: int) -> list[dict[str, Cell]]:
    figures, printed = balls.figures, _printed(ball)
    by_paper, geometric = f"sphere_{ball}_{FIT}", f"sphere_{ball}_"
    name = f"ball {ball}: "
    radius: dict[str, Cell] = {"true": NOMINAL_RADIUS_MM, "unit": "mm"}
    residual: dict[str, Cell] = {"true": 0.0, "unit": "µm"}
    rows = [
        radius
        | {"quantity": name + "radius of the object, ± U (k = 2)"}
        | {"twin": _with_u(figures, f"object_radius_{ball}")},
        radius
        | {
            "quantity": name + "radius of the coat, as the paper evaluates",
            "paper": f"{printed['mean_radius']:.3f} ± {printed['sd']:.3f}",
            "twin": figures.get(f"{by_paper}radius_mm"),
        },
        radius
        | {"quantity": name + "radius of the coat, geometric fit"}
        | {"twin": figures.get(f"{geometric}radius_mm")},
    ]
    for key in ("rmse", "mae", "p95"):
        value_mm = figures.get(f"{by_paper}{key}_mm")
        rows.append(
            residual
            | {
                "quantity": f"{name}{key.upper()} of the fit's residuals",
                "paper": f"{1e3 * printed[key]:.1f}",
                "twin": None if value_mm is None else 1e3 * value_mm,
            }
        )
    return rows


def _with_u(figures: Figures, name: str) -> str | None:
    """Return a length in mm with its expanded uncertainty as text; None if it was not measured."""
    value, expanded_um = figures.get(f"{name}_mm"), figures.get(f"{name}_expanded_um")
    if value is None or expanded_um is None:
        return None
    return f"{value:.3f} ± {1e-3 * expanded_um:.3f}"


def _printed(ball: int) -> dict[str, float]:
    """Return the paper's values of a ball by contact-FPP, from its repeated and its single fit."""
    tables = ("sphere_fit", "repeated_fit")
    rows = [row for table in tables for row in rows_of(table)]
    ours = [row for row in rows if row["method"] == CONTACT_FPP and row["sphere"] == ball]
    return {key: value for row in ours for key, value in row.items()}


def _views(measured: Measurement) -> list[Figure]:
    figures = relief_figure(measured), height_map_figure(measured)
    return [_renamed(figure, _name(measured)) for figure in figures]


def _renamed(figure: Figure, name: str) -> Figure:
    title = f"{name.capitalize()}: {figure.title.lower()}"
    return replace(figure, name=f"{name}_{figure.name}", title=title)
