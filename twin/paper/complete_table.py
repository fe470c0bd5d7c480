"""Completeness of every case, and what a finished case leaves in its folder."""

from pathlib import Path

import numpy as np

from twin.modalities.photometric_score import in_world
from twin.output import read_json, write_json
from twin.paper.completeness import Completeness, completeness_of
from twin.paper.panels import draw_panels, prune
from twin.paper.table import Cell, Column, Table
from twin.report.comparison_panels import AnyMeasured, read_any
from twin.report.photometric_folder import Photographed

COMPLETENESS_FILE = "completeness.json"
_KEYS = ("contact", "contact_points", "specimen", "specimen_points", "limit_um")


def finish_case(folder: Path) -> None:
    """Draw a case's panels, count what it shows, and drop the arrays that nothing reads again."""
    found = counted(read_any(folder))
    write_json(folder / COMPLETENESS_FILE, {key: getattr(found, key) for key in _KEYS})
    draw_panels(folder)
    prune(folder)


def counted(measured: AnyMeasured) -> Completeness:
    """Return the completeness of a measurement by any method."""
    if isinstance(measured, Photographed):
        world = in_world(measured.own.heights)
        points, valid = world.points_mm, world.valid
    else:
        point_map = measured.reconstruction.point_map
        points, valid = point_map.points_world_mm.astype(np.float64), point_map.valid
    return completeness_of(measured.experiment, measured.truth, points, valid, measured.pressed)


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
