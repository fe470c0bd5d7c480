"""The report of one finished measurement by any method: HTML page, and table for a terminal."""

from collections.abc import Callable
from pathlib import Path

from twin.pipeline.progress import ProgressCallback, no_progress
from twin.report import bare, contact, photometric
from twin.report.page import REPORT_FILE, STAGE, Page, write_page
from twin.report.spheres import fit_table
from twin.results.folder import read_measurement
from twin.results.record import Measurement


def write_report(
    folder: Path, watch: ProgressCallback = no_progress, into: Path | None = None
) -> Path:
    """Write `report.html` and `figures/*.png` into the folder of a finished measurement.

    Parameters
    ----------
    folder : result folder of `twin measure` or `twin demo`; nothing else is read
    watch : progress callback
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
    return write_page((into or folder) / REPORT_FILE, page_of(read_measurement(folder)), watch)


def page_of(measured: Measurement) -> Page:
    """Return the page of a measurement by its method."""
    return _by_method(measured)[0](measured)


def summary_table(folder: Path) -> str:
    """Return the result of a measurement as a short plain-text table, at most 100 columns.

    Raises
    ------
    InputError
        The folder is no finished measurement, or a file is missing or damaged.
    """
    measured = read_measurement(folder)
    fits, sentences = fit_table(measured, decoders=False), _by_method(measured)[1](measured)
    head = [f"{measured.experiment.name}, sphere fits", fits.as_text()] if fits else []
    return "\n".join([*head, *measured.score.unfitted, *sentences])


def _by_method(
    measured: Measurement,
) -> tuple[Callable[[Measurement], Page], Callable[[Measurement], list[str]]]:
    method = measured.experiment.method
    if not method.fringes:
        return photometric.page_of, photometric.sentences
    room = contact if method.presses else bare
    return room.page_of, room.sentences
