"""Report of one finished measurement by any method: HTML page, and table for a terminal.

Each method has a module with its judgements (`verdicts`), its sections (`sections`) and the result
as text for a terminal (`sentences`). This module adds the parts that the pages of all methods have.
"""

import textwrap
from pathlib import Path
from typing import Protocol

from twin.pipeline.progress import ProgressCallback, no_progress
from twin.report.certificate import certificate
from twin.report.experiment import appendix
from twin.report.object import object_lines, object_section, object_verdict
from twin.report.page import (
    REPORT_FILE,
    STAGE,
    Drawer,
    Page,
    Section,
    Verdict,
    one_by_one,
    write_page,
)
from twin.report.spheres import fit_table
from twin.report.view import view_section
from twin.results.folder import read_measurement
from twin.results.record import Measurement


class MethodReport(Protocol):
    """Interface of the report module of a method.

    `METHOD` is the name of the method, `WARNED` the heading of the warnings.
    """

    METHOD: str
    WARNED: str

    def verdicts(self, measured: Measurement, /) -> list[Verdict]:
        """Return the judgements of the measurement, for the head of the page."""

    def sections(self, measured: Measurement, /) -> list[Section]:
        """Return the sections of the page that depend on the method."""

    def sentences(self, measured: Measurement, /) -> list[str]:
        """Return the result as lines for a terminal, at most 100 columns wide, in ASCII."""


def write_report(
    folder: Path,
    watch: ProgressCallback = no_progress,
    into: Path | None = None,
    measured: Measurement | None = None,
    draw: Drawer = one_by_one,
) -> Path:
    """Write `report.html` and `figures/*.png` of a finished measurement; return the page's path.

    Parameters
    ----------
    folder : result folder of `twin measure` or `twin demo`; no other file is read
    into : existing folder for the page and its figures; None: `folder`
    measured : content of the folder; None: the folder is read
    draw : function that draws the figures; `twin.report.side_by_side.draw_side_by_side` uses two
        processes

    Raises
    ------
    InputError : the folder is no finished measurement, a file is missing or damaged, or the page
        cannot be written
    """
    watch(STAGE, 0.0)
    page = page_of(measured or read_measurement(folder))
    return write_page((into or folder) / REPORT_FILE, page, watch, draw)


def page_of(measured: Measurement) -> Page:
    """Return the report page of a measurement by any method."""
    by, experiment = _by_method(measured), measured.experiment
    return Page(
        kind=f"virtual measurement by {by.METHOD}",
        title=experiment.name.replace("_", " "),
        lead=experiment.description,
        sections=[
            *object_section(measured),
            *by.sections(measured),
            *view_section(measured),
            appendix(measured),
        ],
        verdicts=[object_verdict(measured), *by.verdicts(measured)],
        warned=by.WARNED,
        warnings=[*measured.warnings, *measured.score.unfitted],
        numbered=True,
        certificate=certificate(measured),
    )


def summary_table(measured: Measurement) -> str:
    """Return the result of a measurement as a short plain-text table, at most 100 columns."""
    object_text = [
        textwrap.fill(f"object: {line}", 100, subsequent_indent="  ")
        for line in object_lines(measured)
    ]
    lines = _by_method(measured).sentences(measured)
    fits = fit_table(measured, decoders=False)
    tail = [f"{fits.title} (mm):", fits.as_text()] if fits else []
    head = f"{measured.experiment.name}, by {measured.experiment.method.title}"
    warnings = [
        textwrap.fill(f"warning: {warning}", 100, subsequent_indent="  ")
        for warning in measured.warnings
    ]
    return "\n".join([head, *object_text, *lines, *tail, *measured.score.unfitted, *warnings])


def _by_method(measured: Measurement) -> MethodReport:
    """Return the report module of the measurement's method; the other modules are not imported."""
    method = measured.experiment.method
    if not method.fringes:
        from twin.report import photometric

        return photometric
    if method.presses:
        from twin.report import contact

        return contact
    from twin.report import bare

    return bare
