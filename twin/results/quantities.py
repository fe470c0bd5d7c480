"""Measurands of an experiment: its `[[measurand]]` tables, and the specimen's defaults."""

from collections import Counter
from collections.abc import Iterator

from twin.config.measurands import MEASURANDS, ObjectMeasurand
from twin.config.models import Experiment
from twin.results.features import Feature, feature_of, features_of
from twin.results.measurands import MeasurandKind, measurand_of


def measurands_of(experiment: Experiment) -> list[ObjectMeasurand]:
    """Return the measurands of an experiment: first the specimen's defaults, then its tables.

    A table replaces a default that has the same name, or the same quantity, part and number.
    """
    tables = {table.name: table for table in experiment.measurand}
    same = {(table.quantity, table.part, table.number) for table in experiment.measurand}
    defaults = {
        default.name: default
        for feature in features_of(experiment.specimen)
        for default in _defaults(feature)
        if (default.quantity, default.part, default.number) not in same
    }
    return list((defaults | tables).values())


def check_measurands(experiment: Experiment) -> None:
    """Check, before anything is measured, that the specimen has the features of all measurands.

    Raises
    ------
    InputError : the specimen lacks a part, ball, rod, bar or grating that a measurand names
    """
    features = features_of(experiment.specimen)
    for table in experiment.measurand:
        feature = feature_of(features, table)
        measurand_of(table).check(table, experiment.specimen, feature)


def nominal_mm(feature: Feature, request: ObjectMeasurand) -> float | None:
    """Return the nominal length, mm, of a measurand, from its table or the specimen, or None."""
    return measurand_of(request).requested_mm(request, feature)


def _defaults(feature: Feature) -> Iterator[ObjectMeasurand]:
    """Yield the default measurands of a part, which need no `[[measurand]]` table."""
    before, count = _prefix(feature.name), Counter[str]()
    for nominal in feature.specimen.nominal_features():
        for quantity in nominal.lengths_mm:
            count[quantity] += 1
            number = f"_{count[quantity]}" if nominal.is_counted else ""
            yield ObjectMeasurand(
                name=f"{before}{quantity}{number}",
                quantity=quantity,
                part=feature.name,
                number=count[quantity],
            )
    for kind in MEASURANDS:
        if isinstance(kind, MeasurandKind):
            yield from kind.defaults(feature)


def _prefix(part: str) -> str:
    """Return the prefix of the names of a part's measurands, made from the name of the part."""
    if not part:
        return ""
    plain = "".join(c if c.isascii() and c.isalnum() else "_" for c in part.lower())
    return f"{plain[:20]}_" if plain[0].isalpha() else f"part_{plain[:15]}_"
