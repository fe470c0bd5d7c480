"""The result of a finished measurement for a terminal, whatever the method."""

from pathlib import Path

from twin.report.photometric import sentences
from twin.report.table import HEADINGS, MEASURED_LABEL, Row, fit_values, fringe_table, line_of
from twin.results.folder import read_measurement
from twin.results.record import Measurement


def summary_table(folder: Path) -> str:
    """Return the result of a measurement as a short plain-text table, at most 100 columns.

    Raises
    ------
    InputError
        The folder is no finished measurement, or a file is missing or damaged.
    """
    measured = read_measurement(folder)
    by_method = fringe_table if measured.experiment.method.fringes else _photometric_table
    return by_method(measured)


def _photometric_table(seen: Measurement) -> str:
    balls = seen.score.spheres
    lines = [line_of(f"{seen.experiment.name}, sphere fits (mm)", HEADINGS)] if balls else []
    for ball in balls:
        for label, fit in ((MEASURED_LABEL, ball.measured), ("true coat", ball.true_face)):
            row = Row(ball.number, label, fit_values(fit, ball.nominal.radius_mm))
            first = f"ball {ball.number}" if label == MEASURED_LABEL else ""
            lines.append(line_of(f"{first:<8}{label}", row.cells))
    return "\n".join([*lines, *seen.score.unfitted, *sentences(seen)])
