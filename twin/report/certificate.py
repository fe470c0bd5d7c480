"""What is printed alone on the first page of a measurement: object, measurands, conditions."""

from dataclasses import replace

from twin.report.experiment import glance
from twin.report.object import deviation_table, object_verdict, quantity_table
from twin.report.page import Block, Note
from twin.report.table import Table, parts
from twin.results.record import Measurement

_VIRTUAL = (
    "A virtual measurement: pressed, rendered, exposed and decoded by a digital twin. It says what "
    "a sensor so built would measure, and is no calibration certificate of any instrument."
)


def certificate(measured: Measurement) -> tuple[Block, ...]:
    """Return the first printed page of a measurement.

    The object, what was found of it with expanded uncertainty and verdict, the conditions, and the
    versions and digest by which it can be made again.
    """
    return (
        _head(measured),
        *_found(measured),
        replace(glance(measured), title="Conditions"),
        parts("certified_with", [("made with", _versions(measured))]),
        Note(_VIRTUAL),
    )


def _head(measured: Measurement) -> Table:
    judged = object_verdict(measured)
    rows = [("method", measured.experiment.method.title), ("result", judged.headline)]
    return parts("certified", rows)


def _found(measured: Measurement) -> list[Table]:
    """Return the measurands, and the deviation where no length of the object was measured."""
    found = measured.object
    tables = [quantity_table(measured)] if found.quantities else []
    lengths = any(one.asked.unit == "mm" for one in found.quantities)
    if found.seen is not None and found.aligned and not lengths:
        tables.append(deviation_table(measured))
    return tables


def _versions(measured: Measurement) -> str:
    return ", ".join(f"{name} {version}" for name, version in measured.versions.items())
