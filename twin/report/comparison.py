"""The report of a comparison: every specimen by every method, as one HTML page."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from twin.modalities.comparison import Outcome, read_outcomes
from twin.modalities.progress import Watcher, nobody
from twin.report.comparison_view import (
    METHOD_NAMES,
    METHOD_WORDS,
    PANELS,
    draw_panel,
    overview,
)
from twin.report.direct import percent, verdict_in_words
from twin.report.html import data_uri, make_folder, template, write_page
from twin.report.result_folder import Measured, read_measured

FIGURES_FOLDER, REPORT_FILE = "figures", "report.html"
_STAGE, _OVERVIEW = "report", "overview.png"

ROWS = (
    "points on",
    "good points",
    "z error, RMS (µm)",
    "z error, mean (µm)",
    "z error, P95 (µm)",
    "wrong fringe orders",
    "saturated pixel values",
    "exposure (ms)",
    "sphere radii (mm)",
)
"""Labels of the table under each specimen, in the order of `_values`."""


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


def write_comparison(folder: Path, watch: Watcher = nobody) -> Path:
    """Write `report.html` and `figures/*.png` into the folder of a finished comparison.

    Parameters
    ----------
    folder : result folder of `twin compare`; nothing else is read
    watch : told how far the report is

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
    pictures = folder / FIGURES_FOLDER
    make_folder(pictures)
    methods = tuple(dict.fromkeys(outcome.method for outcome in outcomes))
    names = tuple(dict.fromkeys(outcome.name for outcome in outcomes))
    cells: dict[str, list[Cell]] = {name: [] for name in names}
    with overview(pictures / _OVERVIEW, methods, names) as fill:
        for number, outcome in enumerate(outcomes, start=1):
            measured = _read(folder, outcome)
            fill(outcome.name, outcome.method, measured)
            cells[outcome.name].append(_cell(pictures, outcome, measured))
            watch(_STAGE, number / (len(outcomes) + 1))
    path = folder / REPORT_FILE
    write_page(path, _page(pictures, outcomes, cells))
    watch(_STAGE, 1.0)
    return path


def _read(folder: Path, outcome: Outcome) -> Measured | None:
    return None if outcome.failure else read_measured(folder / outcome.name / outcome.method)


def _cell(pictures: Path, outcome: Outcome, measured: Measured | None) -> Cell:
    cell = Cell(
        title=METHOD_NAMES[outcome.method],
        words=METHOD_WORDS[outcome.method],
        report=f"{outcome.name}/{outcome.method}/{REPORT_FILE}",
        failure=outcome.failure,
        values=["–"] * len(ROWS),
    )
    if measured is None:
        return cell
    return replace(
        cell,
        verdict=verdict_in_words(measured),
        shares=_shares(measured),
        pictures=_pictures(pictures, outcome, measured),
        values=_values(measured),
    )


def _pictures(pictures: Path, outcome: Outcome, measured: Measured) -> list[dict[str, str]]:
    shown = []
    for panel in PANELS:
        path = pictures / f"{outcome.name}_{outcome.method}_{panel.name}.png"
        draw_panel(path, panel, measured)
        alt = f"{outcome.name}, {METHOD_NAMES[outcome.method]}: {panel.caption}"
        shown.append({"uri": data_uri(path), "caption": panel.caption, "alt": alt})
    return shown


def _shares(measured: Measured) -> list[dict[str, str]]:
    """Three parts of the wanted pixels, for the bar: good, wrong, none."""
    good, found = measured.figures["good_share"], measured.figures["completeness"]
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


def _values(measured: Measured) -> list[str]:
    figures = measured.figures
    limit_um = measured.experiment.score.good_within_um
    radii = [f"{ball.measured.radius_mm:.3f}" for ball in measured.score.spheres]
    return [
        percent(figures["completeness"]),
        f"{percent(figures['good_share'])} ({limit_um:g} µm)",
        *(f"{figures[name]:.2f}" for name in ("z_rmse_um", "z_bias_um", "z_p95_um")),
        str(figures["wrong_order_pixels"]),
        f"{figures['saturated_share']:.2%}",
        f"{figures['exposure_ms']:.3g}",
        ", ".join(radii) or "–",
    ]


def _page(pictures: Path, outcomes: list[Outcome], cells: dict[str, list[Cell]]) -> str:
    return template("comparison.html").render(
        overview=data_uri(pictures / _OVERVIEW),
        descriptions={outcome.name: outcome.description for outcome in outcomes},
        specimens=cells,
        rows=ROWS,
    )
