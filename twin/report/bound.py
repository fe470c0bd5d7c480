"""Section of a report on the precision limit by noise: Cramer-Rao bound, and spread of the fit."""

from twin.report.page import Note, Section
from twin.report.table import Column, Row, Table
from twin.report.words import label_of
from twin.results.record import Measurement

_BOUND, _SPREAD = "_crb_um", "_spread_um"
_HOW = (
    "Both are predicted from the noise model. Cramer-Rao bound: smallest standard deviation that "
    "any unbiased fit of the shape to the decoded coordinates can have. Spread: standard deviation "
    "of the fit in use, including the phase filter. Errors of elastomer and calibration and the "
    "bias of the filter are not included."
)


def bound_section(measured: Measurement) -> list[Section]:
    """Return the section with bound and spread (um) of each dimension; empty if there are none."""
    figures = measured.figures
    rows: list[Row] = []
    for name, bound in figures.items():
        spread = figures.get(name.removesuffix(_BOUND) + _SPREAD)
        if name.endswith(_BOUND) and bound is not None and spread is not None:
            what = label_of(name.removesuffix(_BOUND).removeprefix("object_"))[0]
            rows.append({"what": what, "bound": bound, "spread": spread})
    if not rows:
        return []
    columns = (
        Column("what", "dimension"),
        Column("bound", "least by noise (Cramer-Rao)", unit="µm"),
        Column("spread", "of the fit in use", unit="µm"),
    )
    table = Table("bounds", "Standard deviation by noise", "", columns, tuple(rows))
    return [Section("bound", "Precision limit by noise (Cramer-Rao bound)", (table, Note(_HOW)))]
