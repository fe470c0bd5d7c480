"""Feasibility of measured designs: all constraints are satisfied, and all tolerances are met.

A constraint limits a field or a measured figure. A tolerance of a `[[measurand]]` limits the
measured value with its expanded uncertainty U (ISO 14253-1). Every verdict except "within
tolerance" counts as not met. A design with repeats, which differ only in their seed, is feasible
only if each repeat is feasible. Otherwise the best design would be selected by its noise.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from reconstruction.errors import counted
from reconstruction.evaluate.conformity import WITHIN
from twin.config import Experiment
from twin.config.study import Constraint
from twin.results.object_score import tolerance_of
from twin.results.quantities import measurands_of
from twin.study.cases import Case, quantity

Row = Mapping[str, Any]

DESIGN = "design"
"""Key of a table row under which the settings of the case without its seed are stored, as text."""
UNMET = "unmet"
"""Key of a table row under which the conditions that the case does not meet are stored."""
RESERVES = "reserves"
"""Key of a table row under which the reserve of the case to each condition is stored."""
TOLERANCES = "all tolerances of [[measurand]] are met, with U"
_PERCENT = 100.0
_EVERY_REPEAT = "every repeat of the design"


@dataclass(frozen=True)
class Reserve:
    """Distance of a case from the limit of a condition, negative if the condition is not met.

    Attributes
    ----------
    figure : name of the limited number; its suffix is the unit of `amount`
    amount : the distance; for a tolerance minus U; None if the case lacks the number
    scale : size of the limit; of two limits of a constraint the smaller size, of two limits of a
        tolerance the larger; 1 if it is 0
    """

    figure: str
    amount: float | None
    scale: float

    @property
    def relative(self) -> float:
        """The distance divided by the size of the limit; minus infinity if it is not known."""
        return -math.inf if self.amount is None else self.amount / self.scale


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


def reserves(
    case: Case, figures: Mapping[str, Any], bounds: Iterable[Constraint]
) -> dict[str, Reserve]:
    """Return the reserve of a measured case to every condition, met or not, by its title."""
    by_title: dict[str, Reserve] = {}
    for bound in bounds:
        number = quantity(case.experiment, figures, bound)
        amount = None if number is None else -bound.excess(number)
        name = bound.value if bound.per is None else f"{bound.value} / {bound.per}"
        limits = [limit for limit in (bound.at_least, bound.at_most) if limit]
        by_title[bound.title] = Reserve(name, amount, min(map(abs, limits), default=1.0))
    judged = _judged(figures)
    sizes = _tolerance_sizes(case.experiment) if judged else {}
    for name in judged:
        amount, unit = _margin(figures, name) or (None, "um")
        size = sizes.get(name, 1.0) * (_PERCENT if unit == "%" else 1.0)
        shown = f"{name}_margin_{'percent' if unit == '%' else 'um'}"
        by_title[_tolerance_title(name)] = Reserve(shown, amount, size)
    return by_title


def _tolerance_sizes(experiment: Experiment) -> dict[str, float]:
    """Return the size of the largest finite limit of each tolerance; 1 if it is 0."""
    by_figure = {}
    for measurand in measurands_of(experiment):
        tolerance = tolerance_of(measurand)
        limits = () if tolerance is None else (tolerance.lower, tolerance.upper)
        sizes = [abs(limit) for limit in limits if math.isfinite(limit)]
        by_figure[f"object_{measurand.name}"] = max(sizes, default=1.0) or 1.0
    return by_figure


def shortfall(row: Row) -> float:
    """Return the sum of the relative distances of a row beyond the limits of its conditions.

    It is 0 if all conditions are met, and infinite if the value of a condition is missing.
    """
    held: Mapping[str, Reserve] = row[RESERVES]
    return sum(max(0.0, -reserve.relative) for reserve in held.values())


def _tolerance_title(name: str) -> str:
    return f"{name} within tolerance"


def _beyond_tolerance(figures: Mapping[str, Any]) -> Iterable[tuple[str, str]]:
    for name in _judged(figures):
        if figures[f"{name}_verdict"] != WITHIN:
            margin = _margin(figures, name)
            short = "no value" if margin is None else f"{-margin[0]:.3g} {margin[1]} short, with U"
            yield _tolerance_title(name), f"{figures[f'{name}_verdict']}, {short}"


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


def spread_over_repeats(rows: Sequence[dict[str, Any]]) -> None:
    """Mark all repeats of a design as infeasible if one repeat is infeasible or failed.

    The rows are changed in place.
    """
    designs: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        designs.setdefault(row[DESIGN], []).append(row)
    for repeats in designs.values():
        missed = sum(row["state"] == "failed" or row["feasible"] is False for row in repeats)
        for row in repeats if missed else ():
            if row["feasible"]:
                row["feasible"] = False
                row[UNMET] = {_EVERY_REPEAT: f"{missed} of {len(repeats)} not"}


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
