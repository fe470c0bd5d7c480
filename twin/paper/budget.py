"""Ranked uncertainty budget of radius and width, and its check by the repeated trials.

Each input alone through the pressed face, of the balls' optics through the chain; the trials' own
differences for noise and calibration. The trials are at once the Monte Carlo of JCGM 101: every
input drawn together, through the whole chain.
"""

from collections.abc import Sequence

import numpy as np

from reconstruction.arrays import FloatArray
from twin.paper.plan import BUDGET_OF
from twin.paper.statistics import Spread, spread_of, values_of
from twin.paper.trials import Trial
from twin.propagation.budget import (
    Part,
    calibration_part,
    noise_left,
    ranked,
    shares,
    together,
)
from twin.report.table import Cell, Column, Table
from twin.study.measuring import TRUE_RIG


def budget_table(name: str, parts: Sequence[Part], trials: Sequence[Trial]) -> Table:
    """Return the budget of a specimen's figure, largest contribution first."""
    output, repeated = BUDGET_OF[name], [one for one in trials if one.number]
    rows = _rows([*parts, *_of_trials(parts, repeated, output)])
    found = spread_of(values_of(repeated, output))
    if found is not None and found.n > 1:
        rows.append({"input": f"all, Monte Carlo, {found.n} trials", "u": found.sd})
    return Table(
        f"budget_{name}",
        f"Ranked uncertainty of {output} of one measurement, {name}",
        "",
        (
            Column("input", "input"),
            Column("group", "of"),
            Column("key", "varied"),
            Column("u", "u, mm", 5),
            Column("share", "share of variance, %", 1),
        ),
        tuple(rows),
        (*_NOTES, *_coverage(found)),
    )


_NOTES = (
    "Standard uncertainties of one measurement, not of a mean of five. The inputs alone are the "
    "handling; the trials also draw what was identified.",
    "Each input alone: slope and bend over one standard uncertainty of the input, of the pressed "
    "face or, for optics, of the whole chain without noise; noise and calibration from the trials' "
    "own differences.",
)
_LEAST_FOR_COVERAGE = 40


def _of_trials(parts: Sequence[Part], trials: Sequence[Trial], output: str) -> list[Part]:
    """Return noise and calibration: one trial alone, which differs from nothing, has neither."""
    ball, _, rest = output.rpartition("_radius")
    face = f"{ball}_true_face_radius{rest}" if ball else f"true_face_{output}"
    noise = noise_left(_difference(trials, f"{TRUE_RIG}{output}", face), parts)
    calibration = calibration_part(_difference(trials, output, f"{TRUE_RIG}{output}"))
    return [] if noise is None or calibration is None else [noise, calibration]


def _rows(parts: Sequence[Part]) -> list[dict[str, Cell]]:
    ordered = ranked(parts)
    rows: list[dict[str, Cell]] = [
        {"input": one.name, "group": one.group, "key": one.key, "u": one.u, "share": 100.0 * share}
        for one, share in zip(ordered, shares(ordered), strict=True)
    ]
    return [*rows, {"input": "all, each alone", "u": together(parts), "share": 100.0}]


def _coverage(found: Spread | None) -> list[str]:
    """State the interval of the trials, once there are enough to speak of one."""
    if found is None or found.n < _LEAST_FOR_COVERAGE:
        return []
    ends = f"{found.low:.3f} and {found.high:.3f} mm"
    return [f"Monte Carlo: 95 % of {found.n} trials lie between {ends}."]


def _difference(trials: Sequence[Trial], first: str, second: str) -> FloatArray:
    """Return what one figure is above another, in the trials that have both."""
    both = [one.figures for one in trials if None not in map(one.figures.get, (first, second))]
    return np.array([float(figures[first]) - float(figures[second]) for figures in both])
