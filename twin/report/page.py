"""The report as one HTML page that needs no other file and no network."""

from pathlib import Path

from twin.pipeline.progress import Watcher, nobody
from twin.report import appendix, direct, photometric
from twin.report.direct_view import direct_plates
from twin.report.discussion import discussion
from twin.report.figures import plates
from twin.report.glance import glance
from twin.report.html import STAGE, Picture, Plate, draw_pictures, template, write_page
from twin.report.photometric_plates import photometric_plates
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
    shown = draw_pictures(path.parent, plates_of(measured), watch)
    render = render_page if measured.experiment.method.fringes else render_photometric
    write_page(path, render(measured, shown))
    watch(STAGE, 1.0)
    return path


def plates_of(measured: Measurement) -> list[Plate]:
    """Return all figures of the page in their order."""
    if not measured.experiment.method.fringes:
        return photometric_plates(measured)
    return direct_plates(measured) if measured.pressed is None else plates(measured)


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


def render_photometric(seen: Measurement, shown: dict[str, Picture]) -> str:
    """Fill the template with figures that are drawn already."""
    numbers = [ball.number for ball in seen.score.spheres]
    return template("photometric.html").render(
        experiment=seen.experiment,
        verdicts=photometric.verdicts(seen),
        warnings=[*seen.figures["warnings"], *seen.score.unfitted],
        glance=photometric.glance(seen),
        field=photometric.field_figures(seen),
        decoder_headings=photometric.DECODER_HEADINGS,
        decoder_rows=photometric.decoder_rows(seen),
        headings=HEADINGS,
        ball_rows=[photometric.ball_rows(seen, number) for number in numbers],
        discussion=photometric.discussion(seen),
        figures=shown,
        ball_names=[name for name in shown if name.startswith("ball_")],
        settings=appendix.settings(seen.experiment),
        metrics=appendix.metrics(seen),
        timings=appendix.timings(seen.seconds),
        versions=appendix.versions(seen),
    )
