"""The report as one HTML page that needs no other file and no network."""

import base64
from functools import cache
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined, Template

from reconstruction.errors import InputError
from twin.modalities.progress import Watcher, nobody
from twin.report import appendix
from twin.report.discussion import discussion
from twin.report.figures import Plate, plates
from twin.report.glance import glance
from twin.report.result_folder import Measured, read_measured
from twin.report.table import HEADINGS, ball_rows
from twin.report.verdict import verdicts

REPORT_FILE = "report.html"
FIGURES_FOLDER = "figures"
_STAGE = "report"


def write_report(folder: Path, watch: Watcher = nobody) -> Path:
    """Write `report.html` and `figures/*.png` into the folder of a finished measurement.

    Parameters
    ----------
    folder : result folder of `twin measure` or `twin demo`; nothing else is read
    watch : told how far the report is

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        The folder is no finished measurement, a file is missing or damaged, or the page cannot
        be written.
    """
    watch(_STAGE, 0.0)
    measured = read_measured(folder)
    drawn = plates(measured)
    _make_folder(folder / FIGURES_FOLDER)
    for number, plate in enumerate(drawn, start=1):
        plate.draw(_picture(folder, plate))
        watch(_STAGE, number / (len(drawn) + 1))
    path = folder / REPORT_FILE
    _replace(path, render_page(measured, folder, drawn))
    watch(_STAGE, 1.0)
    return path


def render_page(measured: Measured, folder: Path, drawn: list[Plate]) -> str:
    """Fill the template; the figures must lie in the folder already."""
    shown = {
        plate.name: {"uri": _data_uri(_picture(folder, plate)), "plate": plate} for plate in drawn
    }
    return _template().render(
        experiment=measured.experiment,
        digest=measured.digest,
        verdicts=verdicts(measured),
        warnings=[*measured.figures["warnings"], *measured.score.unfitted],
        glance=glance(measured),
        headings=HEADINGS,
        ball_rows=[ball_rows(measured, ball) for ball in measured.score.spheres],
        discussion=discussion(measured),
        figures=shown,
        ball_names=[f"ball_{ball.number}" for ball in measured.score.spheres],
        settings=appendix.settings(measured.experiment),
        metrics=appendix.metrics(measured),
        timings=appendix.timings(measured),
        versions=appendix.versions(measured),
    )


@cache
def _template() -> Template:
    environment = Environment(
        loader=PackageLoader("twin.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("report.html")


def _picture(folder: Path, plate: Plate) -> Path:
    return folder / FIGURES_FOLDER / f"{plate.name}.png"


def _data_uri(picture: Path) -> str:
    return "data:image/png;base64," + base64.b64encode(picture.read_bytes()).decode("ascii")


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror})") from None


def _replace(path: Path, text: str) -> None:
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None
