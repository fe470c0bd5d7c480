"""What an identification found, in one TOML file: for pages that show it, and for trials.

| table | content |
|---|---|
| fields.NAME | path, value, intervals, and how little the rows say of it |
| rows.NAME | measured and predicted, fitted or held out, and the twin's figure behind it |
| limits.NAME | what is known from one side, the twin's figure, and how probably it is met |
| models | choices with their probabilities, the most probable first |
| ridges | what cannot be taken apart, in words and components |
| worth.NAME | what would be left of each field's variance if this were measured |
| draws | joint samples within all stated ranges, the same place of each list together |
"""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from reconstruction.arrays import FloatArray
from reconstruction.writing import write_text
from twin.identification.findings import LimitMet, Prediction
from twin.identification.known import Identified
from twin.identification.record import identified_values

SUMMARY_FILE = "identified.toml"
DRAWS = 64
_DIGITS = 5


def write_summary(folder: Path, found: Identified) -> None:
    """Write the summary into a folder."""
    text = tomli_w.dumps(summary_of(found))
    write_text(folder / SUMMARY_FILE, text)


def summary_of(found: Identified) -> dict[str, Any]:
    """Return the summary as nested tables of plain values."""
    problem, values, open_fields = found.problem, identified_values(found), found.undetermined()
    intervals, samples = found.intervals(), found.values
    fields = {
        name: {"path": free.path, "hardly_narrowed": name in open_fields}
        | values[name]
        | asdict(intervals[name])
        for name, free in problem.free.items()
    }
    whole: dict[str, Any] = {
        "name": problem.name,
        "fields": fields,
        "rows": {one.row: _row(found, one) for one in found.best.predictions},
        "limits": {one.limit: _limit(found, one) for one in found.limits()},
        "models": [
            {"probability": one.probability, "choices": dict(one.combination)}
            for one in found.models
        ],
        "ridges": [asdict(one) for one in found.ridges()],
        "worth": {one.row: dict(one.shrink) for one in found.worth()},
        "draws": _draws(values, samples, found.seed),
    }
    rounded: dict[str, Any] = _rounded(whole)
    return rounded


def _row(found: Identified, one: Prediction) -> dict[str, Any]:
    row = found.problem.rows[one.row]
    metric = found.problem.metric_of(one.row, row, found.best.combination)
    told: dict[str, Any] = {
        "experiment": found.problem.experiment_of(row, found.best.combination),
        "figures": [metric] if isinstance(metric, str) else list(metric),
        "statistic": row.statistic,
        "measured": one.measured,
        "sd": one.sd,
        "scatter": one.scatter,
        "fitted": one.fitted,
        "twin": one.twin.mean,
        "twin_sd": one.twin.sd,
        "any_coat": one.any_coat.mean,
        "any_coat_sd": one.any_coat.sd,
        "steps": one.steps,
        "deviation": one.deviation,
    }
    rotated = found.best.rotated.get(one.row)
    return told if rotated is None else told | {"deviation_when_held_out": rotated.deviation}


def _limit(found: Identified, one: LimitMet) -> dict[str, Any]:
    limit = found.problem.limits[one.limit]
    return {
        "experiment": found.problem.experiment_of(limit, found.best.combination),
        "at_least" if limit.side > 0 else "at_most": limit.value,
        "sd": limit.sd,
        "twin": one.twin.mean,
        "twin_sd": one.twin.sd,
        "probability_before": one.before,
        "probability": one.probability,
    }


def _draws(
    values: dict[str, dict[str, Any]], samples: FloatArray, seed: int
) -> dict[str, list[float]]:
    """Return samples that an experiment takes, whose values must lie in their stated ranges."""
    low, high = np.array([one["range"] for one in values.values()]).T
    allowed = samples[((samples >= low) & (samples <= high)).all(axis=1)]
    chosen = np.random.default_rng(seed).choice(len(allowed), DRAWS)
    return {name: allowed[chosen, i].tolist() for i, name in enumerate(values)}


def _rounded(node: Any) -> Any:
    """Return nested tables with numbers as they are written."""
    if isinstance(node, dict):
        return {key: _rounded(value) for key, value in node.items()}
    if isinstance(node, (list, tuple)):
        return [_rounded(value) for value in node]
    return float(f"{node:.{_DIGITS}g}") if isinstance(node, float) else node
