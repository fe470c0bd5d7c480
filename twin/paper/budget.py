"""Ranked uncertainty budget of radius and width, and its check by the repeated trials.

Linear propagation (JCGM 100, 5.1.2) through the pressed face for what the elastomer does, and the
trials' own differences for noise and calibration. The trials are at once the Monte Carlo of JCGM
101: every input drawn together, through the whole chain.
"""

from collections.abc import Sequence

import numpy as np

from twin.config import Experiment
from twin.paper.face_model import contributions
from twin.paper.repeats import Trial
from twin.paper.scatter import Scatter
from twin.paper.statistics import spread_of, values_of
from twin.paper.table import Cell, Column, Table


def budget_table(
    experiment: Experiment, scatter: Scatter, trials: Sequence[Trial], output: str
) -> Table:
    """Return the budget of one output, such as `sphere_1_radius_mm`, largest contribution first.

    Raises
    ------
    InputError
        A press fails one standard uncertainty away from the nominal one.
    """
    repeated = [one for one in trials if one.number]
    parts = [
        (one.name, one.key, one.output_u_mm) for one in contributions(experiment, scatter, output)
    ]
    parts.append(("noise and decoding", "", _spread(_difference(repeated, "true_rig_", output))))
    parts.append(("calibration", "", _spread(_difference(repeated, "", output))))
    total = float(np.sqrt(sum(u**2 for _, _, u in parts)))
    rows = [_row(name, key, u, total) for name, key, u in sorted(parts, key=lambda part: -part[2])]
    rows.append({"input": "all, linear", "u": total, "share": 100.0})
    found = spread_of(values_of(repeated, output))
    if found is not None and found.n > 1:
        rows.append({"input": f"all, Monte Carlo, {found.n} trials", "u": found.sd})
    return Table(
        f"budget_{experiment.name}",
        f"Ranked uncertainty of {output} of one measurement, {experiment.name}",
        "",
        (
            Column("input", "input"),
            Column("key", "varied"),
            Column("u", "u, mm", 4),
            Column("share", "share of variance, %", 1),
        ),
        tuple(rows),
        (
            "Standard uncertainties of one measurement, not of a mean of five.",
            "Linear: central difference of the pressed face over one standard uncertainty of the "
            "input; noise and calibration from the trials.",
        ),
    )


def _row(name: str, key: str, u_mm: float, total_mm: float) -> dict[str, Cell]:
    share = 100.0 * (u_mm / total_mm) ** 2 if total_mm else 0.0
    return {"input": name, "key": key, "u": u_mm, "share": share}


def _difference(trials: Sequence[Trial], prefix: str, output: str) -> np.ndarray:
    """With `true_rig_`: what measuring adds to the coat; without: what the calibration adds."""
    ball, _, rest = output.rpartition("_radius")
    face = f"{ball}_true_face_radius{rest}" if ball else f"true_face_{output}"
    first, second = (f"true_rig_{output}", face) if prefix else (output, f"true_rig_{output}")
    both = [one.figures for one in trials if {first, second} <= one.figures.keys()]
    return np.array([float(figures[first]) - float(figures[second]) for figures in both])


def _spread(values: np.ndarray) -> float:
    return float(values.std(ddof=1)) if values.size > 1 else 0.0
