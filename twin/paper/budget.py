"""Ranked uncertainty budget of radius and width, and its check by the repeated trials.

Linear propagation (JCGM 100, 5.1.2) through the pressed face for what the elastomer does, and the
trials' own differences for noise and calibration. The trials are at once the Monte Carlo of JCGM
101: every input drawn together, through the whole chain.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.config import Experiment
from twin.paper.face_model import contributions
from twin.paper.optics_model import optical_contributions
from twin.paper.plan import BUDGET_OF
from twin.paper.repeats import Trial
from twin.paper.scatter import Scatter
from twin.paper.statistics import spread_of, values_of
from twin.report.table import Cell, Column, Table


@dataclass(frozen=True)
class Part:
    """What one input, of a group, adds to the standard uncertainty of an output; mm."""

    name: str
    group: str
    key: str
    u_mm: float


def parts_of(experiment: Experiment, scatter: Scatter, output: str) -> list[Part]:
    """Return what every input adds: by the pressed face, and of balls the optics by the chain.

    Two renders for each optical input are spent on the balls only; in the trials of a rod the
    optics stay in the row of the noise.

    Raises
    ------
    InputError
        A press fails one standard uncertainty away from the nominal one.
    MissingBackend
        No usable Dr.Jit backend.
    """
    found = contributions(experiment, scatter.counting_for(experiment, optics=False), output)
    if output.startswith("sphere_"):
        found += optical_contributions(experiment, scatter, output)
    inputs = scatter.inputs
    return [Part(one.name, inputs[one.name].group, one.key, one.output_u_mm) for one in found]


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
        (*_NOTES, *_coverage(values_of(repeated, output))),
    )


_NOTES = (
    "Standard uncertainties of one measurement, not of a mean of five.",
    "Each input alone: slope and bend over one standard uncertainty of the input, of the pressed "
    "face or, for optics, of the whole chain without noise; noise and calibration from the trials' "
    "own differences.",
)
_LEAST_FOR_COVERAGE = 40


def _of_trials(parts: Sequence[Part], trials: Sequence[Trial], output: str) -> list[Part]:
    """Noise is what is left of the trials' own difference when the optics are taken off.

    One trial differs from nothing: it has neither part.
    """
    measuring = _difference(trials, "true_rig_", output)
    calibration = _difference(trials, "", output)
    if min(measuring.size, calibration.size) < 2:
        return []
    light = [part for part in parts if part.group == "optics"]
    of_light = sum(part.u_mm**2 for part in light)
    noise = float(np.sqrt(max(measuring.var(ddof=1) - of_light, 0.0)))
    name = "noise and decoding" if light else "noise, optics and decoding"
    return [
        Part(name, "camera", "", noise),
        Part("calibration", "rig", "", float(calibration.std(ddof=1))),
    ]


def _rows(parts: Sequence[Part]) -> list[dict[str, Cell]]:
    total = float(np.sqrt(sum(one.u_mm**2 for one in parts)))
    rows: list[dict[str, Cell]] = [
        {
            "input": one.name,
            "group": one.group,
            "key": one.key,
            "u": one.u_mm,
            "share": 100.0 * (one.u_mm / total) ** 2 if total else 0.0,
        }
        for one in sorted(parts, key=lambda part: -part.u_mm)
    ]
    return [*rows, {"input": "all, each alone", "u": total, "share": 100.0}]


def _coverage(values: np.ndarray) -> list[str]:
    """State the interval of JCGM 101, 7.7, once there are trials enough to speak of one."""
    if values.size < _LEAST_FOR_COVERAGE:
        return []
    low, high = np.quantile(values, (0.025, 0.975))
    return [f"Monte Carlo: 95 % of {values.size} trials lie between {low:.3f} and {high:.3f} mm."]


def _difference(trials: Sequence[Trial], prefix: str, output: str) -> np.ndarray:
    """With `true_rig_`: what measuring adds to the coat; without: what the calibration adds."""
    ball, _, rest = output.rpartition("_radius")
    face = f"{ball}_true_face_radius{rest}" if ball else f"true_face_{output}"
    first, second = (f"true_rig_{output}", face) if prefix else (output, f"true_rig_{output}")
    both = [one.figures for one in trials if None not in map(one.figures.get, (first, second))]
    return np.array([float(figures[first]) - float(figures[second]) for figures in both])
