"""One page with every table and figure, self-contained; it prints."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from twin.config import Experiment
from twin.config.inputs import Inputs
from twin.output import versions
from twin.paper.figures import FIGURES
from twin.paper.table import PAPER, Cell, Column, Table, shown
from twin.report.appendix import settings
from twin.report.html import Picture, Plate, data_uri, template, write_page
from twin.report.verdict import Grade, Verdict

REPORT_FILE = "report.html"


@dataclass(frozen=True)
class PageSection:
    """What stands together on the page: names of tables and figures."""

    name: str
    title: str
    figures: tuple[str, ...] = ()
    tables: tuple[str, ...] = ()
    paragraphs: tuple[str, ...] = ()


SECTIONS = (
    PageSection("claims", "What was to be shown", (), ("claims",)),
    PageSection("sensor", "Sensor and elastomer", ("concept", "setup", "hardness"), ("hardness",)),
    PageSection(
        "direct",
        "Metal and clear specimens: direct FPP beside contact-FPP",
        ("direct_and_contact", "missing"),
        ("completeness",),
    ),
    PageSection("rods", "Acrylic rods", ("rods",), ("rods",)),
    PageSection("grid", "Side by side with a GelSight-like sensor", ("grid",)),
    PageSection(
        "spheres",
        "Two joined balls",
        ("sphere_fit",),
        ("sphere_fit", "repeated_fit", "uncertainty"),
    ),
    PageSection(
        "budget",
        "Where the uncertainty comes from",
        (),
        ("budget_two_balls", "budget_rods_a", "budget_rods_b", "budget_rods_c"),
    ),
    PageSection(
        "differences",
        "Where twin and paper differ, and why",
        (),
        (
            "explain_region",
            "explain_layout",
            "explain_thickness",
            "explain_drape",
            "explain_travel",
            "explain_scale",
            "explain_height_scale",
            "explain_rods",
            "explain_decoders",
            "explain_roughness",
        ),
        (
            "The paper does not state thickness, support, drape, travel or the region of its fits. "
            "Each table presses the same two balls with one of these changed and fits the coat "
            "itself; a note marks where the linear slab is no longer valid. The last tables are "
            "on the rods, on GelSight's decoders and on the bare nut.",
        ),
    ),
)


@dataclass(frozen=True)
class _Text:
    text: str
    kind: str = ""
    number: bool = False


@dataclass(frozen=True)
class _Row:
    cells: list[_Text]
    paper: bool


@dataclass(frozen=True)
class _Shown:
    """A table as the template takes it."""

    title: str
    of_paper: str
    heads: list[_Text]
    rows: list[_Row]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Part:
    name: str
    title: str
    paragraphs: tuple[str, ...]
    pictures: list[Picture] = field(default_factory=list)
    tables: list[_Shown] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Contents:
    """What the page shows.

    Attributes
    ----------
    tables : by name
    drawn : PNG files of the figures by name
    experiment : whose settings stand for the parameter set
    inputs : spreads of the trials
    trials : repetitions
    """

    tables: Mapping[str, Table]
    drawn: Mapping[str, Path]
    experiment: Experiment
    inputs: Inputs
    trials: int


def write_paper_page(folder: Path, contents: Contents) -> Path:
    """Write `report.html` into `folder` and return its path.

    Raises
    ------
    InputError
        It cannot be written.
    """
    tables = contents.tables
    parts = [part for one in SECTIONS if (part := _part(one, tables, contents.drawn)) is not None]
    text = template("paper.html").render(
        lead=f"{contents.trials} trials of every repeated measurement; the paper's numbers beside "
        "ours.",
        cards=_cards(tables),
        sections=parts,
        settings=settings(contents.experiment),
        spreads=_spreads(contents.inputs),
        versions=", ".join(f"{name} {version}" for name, version in versions().items()),
    )
    path = folder / REPORT_FILE
    write_page(path, text)
    return path


def _part(
    section: PageSection, tables: Mapping[str, Table], drawn: Mapping[str, Path]
) -> _Part | None:
    pictures = [_picture(name, drawn[name]) for name in section.figures if name in drawn]
    found = [_shown(tables[name]) for name in section.tables if name in tables]
    if not pictures and not found:
        return None
    return _Part(section.name, section.title, section.paragraphs, pictures, found)


def _picture(name: str, path: Path) -> Picture:
    figure = FIGURES[name]
    plate = Plate(name, lambda _: None, figure.title, figure.caption)
    return Picture(data_uri(path), plate)


def _shown(table: Table) -> _Shown:
    numeric = {c.key: _is_numeric(table, c) for c in table.columns}
    heads = [_Text(c.heading, number=numeric[c.key]) for c in table.columns]
    rows = [
        _Row(
            [
                _Text(shown(row.get(c.key), c.digits), _kind(c, row.get(c.key), numeric[c.key]))
                for c in table.columns
            ],
            row.get("source") == PAPER,
        )
        for row in table.rows
    ]
    return _Shown(table.title, table.of_paper, heads, rows, table.notes)


def _is_numeric(table: Table, column: Column) -> bool:
    cells = [row.get(column.key) for row in table.rows]
    return any(isinstance(cell, (int, float)) for cell in cells)


def _kind(column: Column, cell: Cell, numeric: bool) -> str:
    if column.key == "met":
        return "met" if cell == "yes" else "missed"
    return "number" if numeric else ""


def _cards(tables: Mapping[str, Table]) -> list[Verdict]:
    if "claims" not in tables:
        return []
    rows = tables["claims"].rows
    met = [row for row in rows if row["met"] == "yes"]
    missed = [
        f"{row['claim']}: {shown(row['found'], 4)}, {row['allowed']}"
        for row in rows
        if row["met"] != "yes"
    ]
    grade: Grade = "check" if missed else "good"
    return [
        Verdict(
            question="Does the twin show what the paper shows?",
            headline=f"{len(met)} of {len(rows)} figures within their bars",
            grade=grade,
            reasons=tuple(missed) or ("every bar is met",),
        )
    ]


def _spreads(inputs: Inputs) -> Sequence[dict[str, object]]:
    return [
        {
            "name": name.replace("_", " "),
            "key": one.key,
            "distribution": one.distribution,
            "spread": f"{100 * (one.spread or 0):g} %" if one.relative else f"{one.spread:g}",
            "source": one.source,
            "assumed": one.source.startswith("assumed"),
        }
        for name, one in inputs.inputs.items()
    ]
