"""How well each dimension can be known by noise, in a report: bound, and spread of the fit."""

from twin.report.page import Note, Section
from twin.report.table import Column, Row, Table
from twin.report.words import label_of
from twin.results.record import Measurement

_BOUND, _SPREAD = "_crb_um", "_spread_um"
_HOW = (
    "Before any noise is drawn: the Cramer-Rao bound is the least standard deviation that any "
    "unbiased fit of the shape to the decoded coordinates can have, the spread that of the fit in "
    "use, through the filter. What elastomer, calibration and filter bias do is no part of them."
)


def bound_section(measured: Measurement) -> list[Section]:
    """Return bounds and spreads; nothing where the measurement says none."""
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
    return [Section("bound", "What the light allows", (table, Note(_HOW)))]
