"""Every case of the figures: measured in memory; completeness, figures and panel data are kept."""

from dataclasses import asdict
from pathlib import Path

import numpy as np

from twin.config import Experiment
from twin.output import read_json, write_json
from twin.paper.completeness import Completeness, completeness_of
from twin.paper.panels import PANELS_FOLDER, panel_data_of, write_panel_data
from twin.pipeline import Memory, measure
from twin.pipeline.progress import Watcher, nobody
from twin.report.table import Cell, Column, Table
from twin.results.parts import write_result
from twin.results.record import Measurement

COMMAND, COMPLETENESS_FILE = "paper", "completeness.json"
_KEYS = ("contact", "contact_points", "specimen", "specimen_points", "limit_um")


def measure_case(
    folder: Path, experiment: Experiment, watch: Watcher = nobody, memory: Memory | None = None
) -> None:
    """Measure; keep figures, completeness and panel data. The arrays are nobody's input any more.

    Raises
    ------
    InputError
        Something in the experiment cannot be pressed, rendered or fitted.
    MissingBackend
        No usable Dr.Jit backend.
    """
    seen = measure(experiment, watch, memory)
    watch("keep", 0.0)
    write_result(folder, COMMAND, experiment, seen.figures)
    write_json(folder / COMPLETENESS_FILE, asdict(counted(seen)))
    write_panel_data(folder / PANELS_FOLDER, panel_data_of(seen))
    watch("keep", 1.0)


def counted(seen: Measurement) -> Completeness:
    """Return the completeness of a measurement by any method."""
    points = seen.points
    points_mm = points.world_mm.astype(np.float64)
    return completeness_of(seen.experiment, seen.truth, points_mm, points.valid, seen.pressed)


def completeness_table(cases: Path) -> Table:
    """Return one row per case in a folder of cases, NAME/METHOD."""
    rows: list[dict[str, Cell]] = []
    for file in sorted(cases.glob(f"*/*/{COMPLETENESS_FILE}")):
        found = read_json(file)
        row: dict[str, Cell] = {key: found[key] for key in _KEYS}
        name, method = file.parent.parent.name, file.parent.name
        rows.append({"specimen_name": name, "method": method, **row})
    return Table(
        "completeness",
        "Share of the specimen with good points",
        "Figure: direct FPP and contact-FPP",
        (
            Column("specimen_name", "specimen"),
            Column("method", "method"),
            Column("specimen", "of the specimen, good"),
            Column("specimen_points", "of the specimen, any point"),
            Column("contact", "of the contact region, good"),
            Column("contact_points", "of the contact region, any point"),
            Column("limit_um", "good within, um", 0),
        ),
        tuple(rows),
        (
            "Direct FPP is judged against the specimen's own surface. Contact methods are judged "
            "against the coat over the contact region, and against the specimen as if the sheet "
            "lay on it with its own thickness everywhere: what is missing there is not touched or "
            "not carried through the sheet.",
        ),
    )
