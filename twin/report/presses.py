"""Report page of presses of a photometric sensor: heights, dots, unreadable images."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from reconstruction.photometric.pictures import draw_heights
from reconstruction.reading import read_bytes
from reconstruction.writing import write_bytes
from twin.pipeline.colour_presses import PRESSES_FOLDER, ColourOutcome
from twin.report.page import REPORT_FILE, Figure, Page, Section, write_page
from twin.report.printed_dots import DOT_COLUMNS, dots_section
from twin.report.table import Column, Row, Table
from twin.results.dot_figures import DOTS_PICTURE

_MOST_DOT_PICTURES = 12
_HEIGHTS = (
    Column("press", "press"),
    Column("valid_share", "valid share", 3),
    Column("highest_mm", "highest, mm", 3),
    Column("lowest_mm", "lowest, mm", 3),
    Column("untouched_share", "share without contact", 3),
    Column("untouched_drift_um", "RMS height without contact, µm", 1),
)


def write_presses_page(folder: Path, outcome: ColourOutcome, name: str) -> Path:
    """Write `report.html` and its figures into the folder of reconstructed presses.

    Parameters
    ----------
    name : name of the description

    Raises
    ------
    InputError : the page cannot be written
    """
    measured = [row for row in outcome.rows if "refused" not in row]
    refused = [row for row in outcome.rows if "refused" in row]
    sections = [_heights(outcome, measured)]
    if any("dots_tracked" in row for row in measured):
        sections.append(_dots(folder, measured))
    if refused:
        sections.append(_refused(refused))
    page = Page(
        kind="presses",
        title=name.replace("_", " "),
        lead="Heights of the pressed gel, measured by photometric stereo from one image per press: "
        f"{len(measured)} measured, {len(refused)} not readable.",
        sections=sections,
        warned="Warnings",
        warnings=outcome.doubts,
    )
    return write_page(folder / REPORT_FILE, page)


def _heights(outcome: ColourOutcome, measured: Sequence[dict[str, Any]]) -> Section:
    maps = Figure(
        "heights",
        "Height maps",
        "Height (mm) over x and y (mm), one colour scale for all presses; positive towards the "
        "camera. At most 24 presses at equal intervals are shown.",
        "Height map of each press.",
        partial(draw_heights, heights=outcome.heights),
    )
    table = Table("presses", "", "", _HEIGHTS, _rows(measured, _HEIGHTS))
    return Section("heights", "Heights", (maps, table))


def _dots(folder: Path, measured: Sequence[dict[str, Any]]) -> Section:
    pictures = [
        Figure(
            f"dots_{number:03d}",
            "",
            str(row["press"]),
            f"Displacements of the printed dots of {row['press']} as arrows.",
            partial(_copied, _picture(folder, str(row["press"]))),
        )
        for number, row in enumerate(measured[:_MOST_DOT_PICTURES])
    ]
    return dots_section(pictures, Table("dots", "", "", DOT_COLUMNS, _rows(measured, DOT_COLUMNS)))


def _picture(folder: Path, press: str) -> Path:
    several = folder / PRESSES_FOLDER / press / DOTS_PICTURE
    return several if several.exists() else folder / DOTS_PICTURE


def _copied(source: Path, target: Path) -> None:
    write_bytes(target, read_bytes(source))


def _refused(refused: Sequence[dict[str, Any]]) -> Section:
    columns = Column("press", "press"), Column("refused", "reason")
    return Section(
        "refused", "Images without a result",
        (Table("refused", "", "", columns, _rows(refused, columns)),),
    )  # fmt: skip


def _rows(rows: Sequence[dict[str, Any]], columns: Sequence[Column]) -> tuple[Row, ...]:
    return tuple({column.key: row.get(column.key) for column in columns} for row in rows)
