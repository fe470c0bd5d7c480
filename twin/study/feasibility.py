"""Feasibility of measured designs: all constraints are satisfied, and all tolerances are met.

A constraint limits a field or a measured figure. A tolerance of a `[[measurand]]` limits the
measured value with its expanded uncertainty U (ISO 14253-1). Every verdict except "within
tolerance" counts as not met. A design with repeats, which differ only in their seed, is feasible
only if each repeat is feasible. Otherwise the best design would be selected by its noise.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from reconstruction.errors import counted
from reconstruction.evaluate.conformity import WITHIN
from twin.config import Experiment
from twin.config.study import Constraint
from twin.results.object_score import tolerance_of
from twin.results.quantities import measurands_of
from twin.study.cases import Case, quantity

Row = Mapping[str, Any]

UNMET = "unmet"
"""Key of a table row under which the conditions that the case does not meet are stored."""
TOLERANCES = "all tolerances of [[measurand]] are met, with U"
_PERCENT = 100.0


def has_tolerances(experiment: Experiment) -> bool:
    """Return True if a measurand of the experiment has a tolerance."""
    return any(tolerance_of(measurand) is not None for measurand in measurands_of(experiment))


def unmet_conditions(
    case: Case, figures: Mapping[str, Any], bounds: Iterable[Constraint]
) -> dict[str, str]:
    """Return the conditions that a measured case does not meet, each with the value as text."""
    unmet: dict[str, str] = {}
    for bound in bounds:
        number = quantity(case.experiment, figures, bound)
        if number is None or not bound.holds_for(number):
            unmet[bound.title] = "no value" if number is None else f"{number:.6g}"
    return unmet | dict(_beyond_tolerance(figures))


def _beyond_tolerance(figures: Mapping[str, Any]) -> Iterable[tuple[str, str]]:
    for name in _judged(figures):
        if figures[f"{name}_verdict"] != WITHIN:
            margin = _margin(figures, name)
            short = "no value" if margin is None else f"{-margin[0]:.3g} {margin[1]} short, with U"
            yield f"{name} within tolerance", f"{figures[f'{name}_verdict']}, {short}"


def _judged(figures: Mapping[str, Any]) -> list[str]:
    """Return the names (object_NAME) of the figures of measurands that have a tolerance."""
    ends = "_verdict"
    return [name.removesuffix(ends) for name in figures if name.endswith(ends)]


def _margin(figures: Mapping[str, Any], name: str) -> tuple[float, str] | None:
    um, share = figures.get(f"{name}_margin_um"), figures.get(f"{name}_margin_share")
    if um is not None:
        return float(um), "um"
    return None if share is None else (_PERCENT * float(share), "%")


def beyond_tolerances(figures: Mapping[str, Any]) -> float:
    """Return the sum of all excesses over tolerances, in um (for a coverage: in percent).

    It is 0 if all tolerances are met or if there are none. It is infinite if a measurand with a
    tolerance has no value.
    """
    total = 0.0
    for name in _judged(figures):
        margin = _margin(figures, name)
        total += float("inf") if margin is None else max(0.0, -margin[0])
    return total


def spread_over_repeats(rows: Sequence[dict[str, Any]], cases: Sequence[Case]) -> None:
    """Mark all repeats of a design as infeasible if one repeat is infeasible or failed.

    `rows`, in the order of `cases`, are changed in place.
    """
    designs: dict[str, list[dict[str, Any]]] = {}
    for row, case in zip(rows, cases, strict=True):
        settings = {name: value for name, value in case.settings.items() if name != "seed"}
        designs.setdefault(repr(settings), []).append(row)
    for repeats in designs.values():
        missed = sum(row["state"] == "failed" or row["feasible"] is False for row in repeats)
        for row in repeats if missed else ():
            if row["feasible"]:
                row["feasible"] = False
                row[UNMET] = {"every repeat of the design": f"{missed} of {len(repeats)} not"}


def unmet_counts(rows: Iterable[Row]) -> dict[str, int]:
    """Return the number of measured cases that miss each condition, the most missed first."""
    counts: dict[str, int] = {}
    for row in rows:
        for condition in row.get(UNMET) or ():
            counts[condition] = counts.get(condition, 0) + 1
    return dict(sorted(counts.items(), key=lambda item: -item[1]))


def feasibility_in_words(rows: Sequence[Row]) -> str:
    """Return a text with the number of feasible measured cases and the missed conditions."""
    done = [row for row in rows if row.get("feasible") is not None]
    feasible = sum(bool(row["feasible"]) for row in done)
    missed = "; ".join(f"{count} miss: {name}" for name, count in unmet_counts(done).items())
    share = f"{feasible} of {counted(len(done), 'finished case')} feasible"
    return f"{share} ({missed})" if missed else share
