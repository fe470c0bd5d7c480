"""Every case of the figures: measured in memory; completeness, figures and panel data are kept."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from twin.config import Experiment
from twin.output import read_json, write_json
from twin.paper.completeness import Completeness, completeness_of
from twin.paper.panel_data import PANELS_FOLDER, write_panel_data
from twin.paper.panel_sources import panel_data_of
from twin.paper.table import Cell, Column, Table
from twin.pipeline import measure
from twin.results.record import Measurement
from twin.study.measuring import AS_IT_IS, Answer, CaseMeasurer, Conditions

COMPLETENESS_FILE = "completeness.json"
_KEYS = ("contact", "contact_points", "specimen", "specimen_points", "limit_um")


class _FigureMeasurer(CaseMeasurer):
    """Keeps figures, completeness and panel data of a case: its arrays are nobody's input."""

    def __call__(self, experiment: Experiment, conditions: Conditions = AS_IT_IS) -> Answer:
        """Measure one case."""
        done = measure(experiment, memory=self.memory, trial=conditions.trial)
        panels, completeness = panel_data_of(done), asdict(counted(done))

        def write(folder: Path) -> None:
            write_json(folder / COMPLETENESS_FILE, completeness)
            write_panel_data(folder / PANELS_FOLDER, panels)

        return Answer(done.figures, write)


def measures_figures(keep: tuple[str, ...]) -> CaseMeasurer:
    """Make what measures the cases of the figures."""
    return _FigureMeasurer(keep)


def shares_of(seen: Measurement) -> dict[str, Any]:
    """Return the completeness of a measurement as further figures of it."""
    return {f"share_{name}": value for name, value in asdict(counted(seen)).items()}


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
