"""The page of a measurement by photometric stereo."""

from pathlib import Path

from twin.pipeline.progress import Watcher
from twin.report import appendix, photometric
from twin.report.html import Picture, draw_pictures, template, write_page
from twin.report.photometric_plates import photometric_plates
from twin.report.table import HEADINGS
from twin.results.record import Measurement


def write_photometric_report(seen: Measurement, page: Path, watch: Watcher) -> None:
    """Write the page and its figures; see `write_report`."""
    shown = draw_pictures(page.parent, photometric_plates(seen), watch)
    write_page(page, render_page(seen, shown))


def render_page(seen: Measurement, shown: dict[str, Picture]) -> str:
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
