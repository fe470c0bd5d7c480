"""The result of a finished measurement for a terminal, whatever the method."""

from pathlib import Path

from twin.report.photometric import sentences
from twin.report.photometric_folder import Photographed, read_photographed
from twin.report.result_folder import is_photometric, read_scored
from twin.report.table import HEADINGS, MEASURED_LABEL, Row, fit_values, fringe_table, line_of


def summary_table(folder: Path) -> str:
    """Return the result of a measurement as a short plain-text table, at most 100 columns.

    Raises
    ------
    InputError
        The folder is no finished measurement, or a file is missing or damaged.
    """
    if is_photometric(folder):
        return _photometric_table(read_photographed(folder))
    return fringe_table(read_scored(folder))


def _photometric_table(seen: Photographed) -> str:
    balls = seen.own.score.spheres
    lines = [line_of(f"{seen.experiment.name}, sphere fits (mm)", HEADINGS)] if balls else []
    for ball in balls:
        for label, fit in ((MEASURED_LABEL, ball.measured), ("true coat", ball.true_face)):
            row = Row(ball.number, label, fit_values(fit, ball.nominal.radius_mm))
            first = f"ball {ball.number}" if label == MEASURED_LABEL else ""
            lines.append(line_of(f"{first:<8}{label}", row.cells))
    return "\n".join([*lines, *seen.own.score.unfitted, *sentences(seen)])
