"""The demo's page: an object under a sheet that wraps it, and where that ends, a thicker sheet.

| in the folder | content |
|---|---|
| result.json, ... | the measurement, as of `twin measure` |
| limits/ | that of the same object under the thicker sheet |
| report.html | both |
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from twin.output import RESULT_FILE
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.report.measurement import page_of
from twin.report.object import object_section
from twin.report.page import REPORT_FILE, Figure, Page, Section, write_page
from twin.report.table import Table
from twin.report.words import percent
from twin.results.folder import read_measurement
from twin.results.record import Measurement

LIMITS_FOLDER = "limits"
LIMITS = {"elastomer.thickness_mm": 1.0, "camera.binning": 4}
"""What the second case changes: five times the thickness, and a quick look at it."""


def is_demo(folder: Path) -> bool:
    """Tell whether a result folder is this demo's."""
    return (folder / LIMITS_FOLDER / RESULT_FILE).is_file()


def write_demo(
    folder: Path,
    watch: ProgressCallback = no_progress,
    into: Path | None = None,
    both: tuple[Measurement, Measurement] | None = None,
) -> Path:
    """Write the page of both measurements and its figures; return the page.

    Parameters
    ----------
    into : existing folder to write into instead
    both : what the folder holds, where that is at hand

    Raises
    ------
    InputError : a measurement is not there or damaged, or the page cannot be written
    """
    done = both or (read_measurement(folder), read_measurement(folder / LIMITS_FOLDER))
    return write_page((into or folder) / REPORT_FILE, demo_page(*done), watch)


def demo_page(thin: Measurement, thick: Measurement) -> Page:
    """Return the page of the first measurement, and before its appendix where it ends."""
    page = page_of(thin)
    *sections, last = page.sections
    ends = [
        replace(one, blocks=(limits_in_words(thin, thick), *one.blocks))
        for one in renamed(object_section(thick), LIMITS_FOLDER, "Where it ends")
    ]
    return replace(page, kind=f"demo: {page.kind}", sections=[*sections, *ends, last])


def limits_in_words(thin: Measurement, thick: Measurement) -> str:
    """Say what the thicker sheet does to the object, beside the thinner one."""
    return (
        f"The same press through {_thickness(thick)}: {_told(thick)}. Through {_thickness(thin)}: "
        f"{_told(thin)}. The coat itself is measured to {thick.figures.known('z_rmse_um'):.1f} and "
        f"{thin.figures.known('z_rmse_um'):.1f} µm: what is lost is lost in the elastomer, not in "
        "the optics. A sheet follows an edge to about its own thickness and bridges what is "
        "narrower than some thicknesses: choose it by the smallest detail (docs/sheet.md)."
    )


def _thickness(measured: Measurement) -> str:
    return f"{measured.experiment.elastomer.thickness_mm:g} mm"


def _told(measured: Measurement) -> str:
    figures = measured.figures
    share = percent(figures.get("object_coverage_share"))
    return (
        f"{share} of the object is touched, and deviates there by "
        f"{figures.known('object_rms_um'):.0f} µm RMS"
    )


def renamed(sections: Sequence[Section], name: str, title: str) -> list[Section]:
    """Return sections under names of their own: the first measurement has sections of the same."""
    return [
        Section(
            f"{name}_{one.name}",
            f"{title}: {one.title.lower()}",
            tuple(
                replace(block, name=f"{name}_{block.name}")
                if isinstance(block, Figure | Table)
                else block
                for block in one.blocks
            ),
        )
        for one in sections
    ]
