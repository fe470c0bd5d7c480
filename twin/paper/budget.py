"""Ranked uncertainty budget of a measured value, and its check by the repeated trials.

Each input is varied separately, and its effect is computed on the pressed face. Optical inputs of
the balls are varied through the whole measurement chain instead. The contributions of noise and
calibration are computed from differences within the trials. The trials are a Monte Carlo
propagation (JCGM 101): all inputs are drawn together and propagated through the whole chain.
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
    """Return the uncertainty budget of one measurement, with the largest contribution first.

    Parameters
    ----------
    name : specimen; `BUDGET_OF` states which of its measured values has a budget
    parts : contributions of the varied inputs
    trials : repeated measurements of the specimen
    """
    output, repeated = BUDGET_OF[name], [trial for trial in trials if trial.number]
    rows = _rows([*parts, *_of_trials(parts, repeated, output)])
    spread = spread_of(values_of(repeated, output))
    if spread is not None and spread.n > 1:
        rows.append({"input": f"all, Monte Carlo, {spread.n} trials", "u": spread.sd})
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
        (*_NOTES, *_coverage(spread)),
    )


_NOTES = (
    "Standard uncertainties of one measurement, not of a mean of five. The listed inputs are those "
    "of the handling; the trials also draw the identified fields.",
    "Each input is varied separately: slope and bend over one standard uncertainty of the input, "
    "of the pressed face or, for optics, of the whole chain without noise. Noise and calibration "
    "follow from differences within the trials.",
)
_LEAST_FOR_COVERAGE = 40


def _of_trials(parts: Sequence[Part], trials: Sequence[Trial], output: str) -> list[Part]:
    """Return the contributions of noise and calibration to `output`; empty for a single trial."""
    ball, _, rest = output.rpartition("_radius")
    face = f"{ball}_true_face_radius{rest}" if ball else f"true_face_{output}"
    noise = noise_left(_difference(trials, f"{TRUE_RIG}{output}", face), parts)
    calibration = calibration_part(_difference(trials, output, f"{TRUE_RIG}{output}"))
    return [] if noise is None or calibration is None else [noise, calibration]


def _rows(parts: Sequence[Part]) -> list[dict[str, Cell]]:
    ordered = ranked(parts)
    rows: list[dict[str, Cell]] = [
        {
            "input": part.name,
            "group": part.group,
            "key": part.key,
            "u": part.u,
            "share": 100.0 * share,
        }
        for part, share in zip(ordered, shares(ordered), strict=True)
    ]
    return [*rows, {"input": "all, in quadrature", "u": together(parts), "share": 100.0}]


def _coverage(spread: Spread | None) -> list[str]:
    """Return a note on the 95 % interval of the trials, if there are enough of them."""
    if spread is None or spread.n < _LEAST_FOR_COVERAGE:
        return []
    ends = f"{spread.low:.3f} and {spread.high:.3f} mm"
    return [f"Monte Carlo: 95 % of {spread.n} trials are between {ends}."]


def _difference(trials: Sequence[Trial], first: str, second: str) -> FloatArray:
    """Return measured value `first` minus `second`, (trial,), of the trials that have both."""
    both = [t.figures for t in trials if None not in map(t.figures.get, (first, second))]
    return np.array([float(figures[first]) - float(figures[second]) for figures in both])
