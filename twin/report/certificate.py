"""First printed page of the report on a measurement: object, measurands, conditions."""

from dataclasses import replace

from twin.report.experiment import glance
from twin.report.object import deviation_table, object_verdict, quantity_table
from twin.report.page import Block, Note
from twin.report.table import Table, parts
from twin.results.record import Measurement

_VIRTUAL = (
    "A virtual measurement: a digital twin pressed, rendered, exposed and decoded the object. It "
    "predicts the result of a sensor built to these settings and is no calibration certificate of "
    "any instrument."
)


def certificate(measured: Measurement) -> tuple[Block, ...]:
    """Return the first printed page of a measurement.

    The page lists the measurands with expanded uncertainty and verdict, the conditions, and the
    versions and digest with which the measurement can be repeated.
    """
    return (
        _head(measured),
        *_measurands(measured),
        replace(glance(measured), title="Conditions"),
        parts("certified_with", [("made with", _versions(measured))]),
        Note(_VIRTUAL),
    )


def _head(measured: Measurement) -> Table:
    judged = object_verdict(measured)
    rows = [("method", measured.experiment.method.title), ("result", judged.headline)]
    return parts("certified", rows)


def _measurands(measured: Measurement) -> list[Table]:
    """Return the table of measurands, and the deviation table if no length was measured.

    A table without values is omitted.
    """
    score = measured.object
    tables = [quantity_table(measured)] if score.quantities else []
    lengths = any(quantity.measurand.unit == "mm" for quantity in score.quantities)
    if score.observed is not None and score.aligned and not lengths:
        tables.append(deviation_table(measured))
    return tables


def _versions(measured: Measurement) -> str:
    return ", ".join(f"{name} {version}" for name, version in measured.versions.items())
