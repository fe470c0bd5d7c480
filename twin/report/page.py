"""The report as one HTML page that needs no other file and no network."""

from pathlib import Path

from twin.modalities.progress import Watcher, nobody
from twin.report import appendix, direct
from twin.report.direct_view import direct_plates
from twin.report.discussion import discussion
from twin.report.figures import Plate, plates
from twin.report.glance import glance
from twin.report.html import data_uri, make_folder, template, write_page
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
    drawn = direct_plates(measured) if measured.pressed is None else plates(measured)
    make_folder(folder / FIGURES_FOLDER)
    for number, plate in enumerate(drawn, start=1):
        plate.draw(_picture(folder, plate))
        watch(_STAGE, number / (len(drawn) + 1))
    path = folder / REPORT_FILE
    write_page(path, render_page(measured, folder, drawn))
    watch(_STAGE, 1.0)
    return path


def render_page(measured: Measured, folder: Path, drawn: list[Plate]) -> str:
    """Fill the template; the figures must lie in the folder already."""
    shown = {
        plate.name: {"uri": data_uri(_picture(folder, plate)), "plate": plate} for plate in drawn
    }
    pressed = measured.pressed is not None
    return template("report.html").render(
        experiment=measured.experiment,
        digest=measured.digest,
        pressed=pressed,
        verdicts=verdicts(measured) if pressed else direct.verdicts(measured),
        warnings=[*measured.figures["warnings"], *measured.score.unfitted],
        glance=glance(measured),
        shares=[] if pressed else direct.shares(measured),
        headings=HEADINGS,
        ball_rows=[ball_rows(measured, ball) for ball in measured.score.spheres],
        discussion=discussion(measured) if pressed else direct.discussion(measured),
        figures=shown,
        ball_names=[name for name in shown if name.startswith("ball_")],
        settings=appendix.settings(measured.experiment),
        metrics=appendix.metrics(measured),
        timings=appendix.timings(measured),
        versions=appendix.versions(measured),
    )


def _picture(folder: Path, plate: Plate) -> Path:
    return folder / FIGURES_FOLDER / f"{plate.name}.png"
