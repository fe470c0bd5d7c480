"""HTML page of the reproduction with every table and figure, self-contained and printable."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from twin.config import Experiment
from twin.config.inputs import Inputs
from twin.output import versions
from twin.paper.claims import FITTED, LIMIT, PREDICTED, STEERED
from twin.paper.figures import FIGURES
from twin.paper.identified import pending
from twin.paper.plan import BALLS
from twin.report.page import REPORT_FILE, Figure, Grade, Note, Page, Section, Verdict, write_page
from twin.report.settings import settings_blocks
from twin.report.table import Cell, Column, Table
from twin.report.words import shown


@dataclass(frozen=True)
class PageSection:
    """A section of the page, with the names of its tables and figures."""

    name: str
    title: str
    figures: tuple[str, ...] = ()
    tables: tuple[str, ...] = ()
    paragraphs: tuple[str, ...] = ()


SECTIONS = (
    PageSection("claims", "Targets", (), ("claims",)),
    PageSection(
        "identified",
        "The sensor as identified: paper, twin, fitted or predicted",
        ("ridges",),
        (
            "identified",
            "identified_fields",
            "identified_choices",
            "identified_worth",
            "identified_decisions",
        ),
    ),
    PageSection("sensor", "Sensor and elastomer", ("concept", "setup", "hardness"), ("hardness",)),
    PageSection(
        "direct",
        "Metal and clear specimens: direct FPP and contact-FPP",
        ("direct_and_contact", "missing"),
        ("completeness", "pictures", "identified_bounds"),
    ),
    PageSection("rods", "Acrylic rods", ("rods",), ("rods",)),
    PageSection("grid", "Comparison with a GelSight-like sensor", ("grid",)),
    PageSection(
        "spheres",
        "Two joined balls",
        ("sphere_fit",),
        ("sphere_fit", "repeated_fit", "uncertainty"),
    ),
    PageSection(
        "budget",
        "Sources of uncertainty",
        (),
        (f"budget_{BALLS}",),
    ),
    PageSection(
        "differences",
        "Differences between twin and paper, and their reasons",
        (),
        (
            "explain_region",
            "explain_height_scale",
            "explain_decoders",
            "explain_nut",
        ),
        ("The paper states neither region nor kind of its fits, nor GelSight's decoder.",),
    ),
)


@dataclass(frozen=True, eq=False)
class Contents:
    """Contents of the page.

    Attributes
    ----------
    tables : tables by name
    drawn : names of the figures in the folder `figures` of the page
    experiment : its settings are listed on the page as the parameter set
    inputs : inputs that vary from trial to trial, with their distributions
    trials : number of trials of every repeated measurement
    """

    tables: Mapping[str, Table]
    drawn: Collection[str]
    experiment: Experiment
    inputs: Inputs
    trials: int


def write_paper_page(folder: Path, contents: Contents) -> Path:
    """Write `report.html` into `folder` and return its path.

    Raises
    ------
    InputError
        The page cannot be written.
    """
    tables = contents.tables
    used = ", ".join(f"{name} {version}" for name, version in versions().items())
    parameters = (
        "One set for all tables and figures. Two of its values were chosen for one table each: the "
        "pose of camera and projector, so that the bare nut fails as the text states, and the "
        "balls' footprint as the second region of GelSight.",
        *settings_blocks(contents.experiment),
        _spread_table(contents.inputs),
        Note(used),
    )
    page = Page(
        kind="every table and figure from one parameter set",
        title="Contact-based fringe projection profilometry, reproduced",
        lead=f"{contents.trials} trials of every repeated measurement; the paper's numbers are "
        "compared with those of the twin.",
        sections=[
            *_sections(tables, contents.drawn),
            Section("parameters", "Parameter set", parameters),
        ],
        verdicts=_verdicts(tables),
        contents=True,
    )
    return write_page(folder / REPORT_FILE, page)


def _sections(tables: Mapping[str, Table], drawn: Collection[str]) -> list[Section]:
    """Return the sections with at least one figure or table; tables without rows are left out."""
    sections = []
    for part in SECTIONS:
        figures = [_figure(name) for name in part.figures if name in drawn]
        shown = [tables[name] for name in part.tables if name in tables and tables[name].rows]
        if figures or shown:
            words = part.paragraphs
            if part.name == "identified" and (note := pending()):
                words = (*words, note)
            sections.append(Section(part.name, part.title, (*words, *figures, *shown)))
    return sections


def _figure(name: str) -> Figure:
    figure = FIGURES[name]
    counterpart = f" Compare with the paper's {figure.paper}." if figure.paper else ""
    return Figure(name, figure.title, figure.caption + counterpart, figure.title)


def _verdicts(tables: Mapping[str, Table]) -> list[Verdict]:
    if "claims" not in tables:
        return []
    rows = tables["claims"].rows
    met = [row for row in rows if row["met"] == "yes"]
    missed = [
        f"missed: {row['claim']}: {shown(row['found'], 4)}, {row['allowed']}"
        for row in rows
        if row["met"] != "yes"
    ]
    grade: Grade = "check" if missed else "good"
    return [
        Verdict(
            question="Does the twin reproduce the paper?",
            headline=f"{len(met)} of {len(rows)} figures meet their targets, "
            f"{_count(met, FITTED)} of them fitted and {_count(met, LIMIT)} assumed limits, "
            f"{_count(met, STEERED)} steered a choice",
            grade=grade,
            reasons=(*_uses(rows), *(missed or ["every target is met"])),
        )
    ]


def _count(rows: Iterable[Mapping[str, Cell]], use: str) -> int:
    return sum(row["use"] == use for row in rows)


def _uses(rows: Sequence[Mapping[str, Cell]]) -> Iterator[str]:
    """Yield, for each use of the paper's rows, the number of targets met and the figures."""
    kinds = {
        FITTED: "compared with rows from which the sensor was identified (fitted)",
        LIMIT: "limits assumed from the text, also used in the identification",
        STEERED: "compared with rows after which a model, evaluation or pose was chosen (steered)",
        PREDICTED: "compared with rows that the identification did not use (predicted)",
        "": "compared with no row of the paper",
    }
    for use, words in kinds.items():
        some = [row for row in rows if row["use"] == use]
        met = sum(row["met"] == "yes" for row in some)
        if some:
            yield f"{met} of {len(some)} {words}"


def _spread_table(inputs: Inputs) -> Table:
    rows, kinds = [], []
    for name, given in inputs.inputs.items():
        kinds.append("assumed" if given.source.startswith("assumed") else "")
        spread = f"{100 * (given.spread or 0):g} %" if given.relative else f"{given.spread or 0:g}"
        if given.together:
            low, high = min(given.values), max(given.values)
            spread = f"{len(given.values)} joint samples, {low:.3g} to {high:.3g}"
        rows.append(
            {
                "name": name.replace("_", " "),
                "key": given.key,
                "distribution": given.distribution,
                "spread": spread,
                "source": given.source,
            }
        )
    columns = (
        Column("name", "input"),
        Column("key", "varied", kind="code"),
        Column("distribution", "distribution"),
        Column("spread", "standard deviation or half width", kind="number"),
        Column("source", "source"),
    )
    title = "Inputs that vary from trial to trial"
    return Table("spreads", title, "", columns, tuple(rows), kinds=tuple(kinds), look="settings")
