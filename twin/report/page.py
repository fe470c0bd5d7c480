"""The report as one HTML page that needs no other file and no network."""

from pathlib import Path

from twin.pipeline.progress import Watcher, nobody
from twin.report import appendix, direct
from twin.report.direct_view import direct_plates
from twin.report.discussion import discussion
from twin.report.figures import plates
from twin.report.glance import glance
from twin.report.html import STAGE, Picture, draw_pictures, template, write_page
from twin.report.photometric_page import write_photometric_report
from twin.report.table import HEADINGS, ball_rows
from twin.report.verdict import verdicts
from twin.results.folder import read_measurement
from twin.results.record import Measurement

REPORT_FILE = "report.html"


def write_report(folder: Path, watch: Watcher = nobody, into: Path | None = None) -> Path:
    """Write `report.html` and `figures/*.png` into the folder of a finished measurement.

    Parameters
    ----------
    folder : result folder of `twin measure` or `twin demo`; nothing else is read
    watch : told how far the report is
    into : existing folder to write into instead

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
    watch(STAGE, 0.0)
    path = (into or folder) / REPORT_FILE
    measured = read_measurement(folder)
    write = _write_fringes if measured.experiment.method.fringes else write_photometric_report
    write(measured, path, watch)
    watch(STAGE, 1.0)
    return path


def _write_fringes(measured: Measurement, page: Path, watch: Watcher) -> None:
    drawn = direct_plates(measured) if measured.pressed is None else plates(measured)
    write_page(page, render_page(measured, draw_pictures(page.parent, drawn, watch)))


def render_page(measured: Measurement, shown: dict[str, Picture]) -> str:
    """Fill the template with figures that are drawn already."""
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
        timings=appendix.timings(measured.seconds),
        versions=appendix.versions(measured),
    )
