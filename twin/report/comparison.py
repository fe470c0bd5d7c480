"""The report of a comparison: every specimen by every method, as one HTML page."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from twin.config.methods import TRAITS, Method
from twin.pipeline.comparison import Outcome, read_outcomes
from twin.pipeline.progress import Watcher, nobody
from twin.report import direct, photometric
from twin.report.comparison_figures import (
    ROWS,
    Gist,
    RatioRow,
    gist_of,
    press_in_words,
    ratio_in_words,
    ratio_rows,
    values,
)
from twin.report.comparison_panels import panels_of
from twin.report.comparison_view import draw_panel, overview
from twin.report.direct import percent
from twin.report.html import FIGURES_FOLDER, data_uri, make_folder, template, write_page
from twin.results.folder import read_measurement
from twin.results.record import Colours, Measurement

REPORT_FILE = "report.html"
_STAGE, _OVERVIEW = "report", "overview.png"


@dataclass(frozen=True)
class Cell:
    """One specimen by one method, as the page shows it; without a measurement only `failure`."""

    title: str
    words: str
    report: str
    failure: str
    values: list[str]
    verdict: str = ""
    shares: list[dict[str, str]] = field(default_factory=list)
    pictures: list[dict[str, str]] = field(default_factory=list)


@dataclass(frozen=True)
class ComparedSpecimen:
    """One specimen on the page: a cell per method, and what only all methods together say."""

    description: str
    cells: list[Cell]
    press: str
    ratios: list[RatioRow]
    paper: str


def write_comparison(folder: Path, watch: Watcher = nobody, into: Path | None = None) -> Path:
    """Write `report.html` and `figures/*.png` into the folder of a finished comparison.

    Parameters
    ----------
    folder : result folder of `twin compare`; nothing else is read
    watch : told how far the report is
    into : existing folder to write into instead

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        The folder is no finished comparison, a file is missing or damaged, or the page cannot be
        written.
    """
    watch(_STAGE, 0.0)
    outcomes = read_outcomes(folder)
    path = (into or folder) / REPORT_FILE
    pictures = path.parent / FIGURES_FOLDER
    make_folder(pictures)
    methods = tuple(dict.fromkeys(outcome.method for outcome in outcomes))
    by_name: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        by_name.setdefault(outcome.name, []).append(outcome)
    specimens = {}
    with overview(pictures / _OVERVIEW, methods, tuple(by_name)) as fill:
        for number, (name, parts) in enumerate(by_name.items(), start=1):
            specimens[name] = _specimen(folder, pictures, parts, fill)
            watch(_STAGE, number / (len(by_name) + 1))
    write_page(path, _page(pictures, methods, specimens))
    watch(_STAGE, 1.0)
    return path


def _specimen(
    folder: Path,
    pictures: Path,
    outcomes: list[Outcome],
    fill: Callable[[str, Method, Measurement | None], None],
) -> ComparedSpecimen:
    """Draw one specimen by every method, one after the other."""
    found: dict[str, Gist | None] = {}
    cells = []
    for outcome in outcomes:
        measured = _read(folder, outcome)
        fill(outcome.name, outcome.method, measured)
        cells.append(_cell(pictures, outcome, measured))
        found[outcome.method] = None if measured is None else gist_of(measured)
    return ComparedSpecimen(
        outcomes[0].description,
        cells,
        press_in_words(found),
        ratio_rows(found),
        ratio_in_words(found),
    )


def _read(folder: Path, outcome: Outcome) -> Measurement | None:
    return None if outcome.failure else read_measurement(folder / outcome.name / outcome.method)


def _cell(pictures: Path, outcome: Outcome, measured: Measurement | None) -> Cell:
    cell = Cell(
        title=TRAITS[outcome.method].title,
        words=TRAITS[outcome.method].told,
        report=f"{outcome.name}/{outcome.method}/{REPORT_FILE}",
        failure=outcome.failure,
        values=["–"] * len(ROWS),
    )
    if measured is None:
        return cell
    return replace(
        cell,
        verdict=_verdict(measured),
        shares=_shares(measured),
        pictures=_pictures(pictures, outcome, measured),
        values=values(measured),
    )


def _verdict(measured: Measurement) -> str:
    if isinstance(measured.images, Colours):
        return photometric.verdict_in_words(measured)
    return direct.verdict_in_words(measured)


def _pictures(pictures: Path, outcome: Outcome, measured: Measurement) -> list[dict[str, str]]:
    shown = []
    for panel in panels_of(measured):
        path = pictures / f"{outcome.name}_{outcome.method}_{panel.name}.png"
        draw_panel(path, panel, measured)
        alt = f"{outcome.name}, {TRAITS[outcome.method].title}: {panel.caption}"
        shown.append({"uri": data_uri(path), "caption": panel.caption, "alt": alt})
    return shown


def _shares(measured: Measurement) -> list[dict[str, str]]:
    """Three parts of the wanted pixels, for the bar: good, wrong, none."""
    good, found = measured.figures["good_share"], measured.figures["completeness"]
    if good is None:
        return []
    limit_um = measured.experiment.score.good_within_um
    parts = (
        ("good", f"within {limit_um:g} µm", good),
        ("wrong", "off by more", found - good),
        ("none", "no point", 1 - found),
    )
    return [
        {"kind": kind, "words": f"{words} {percent(share)}", "width": f"{100 * share:.2f}%"}
        for kind, words, share in parts
    ]


def _page(
    pictures: Path, methods: tuple[Method, ...], specimens: dict[str, ComparedSpecimen]
) -> str:
    return template("comparison.html").render(
        overview=data_uri(pictures / _OVERVIEW), methods=methods, specimens=specimens, rows=ROWS
    )
