"""Summary of an identification in one TOML file, `identified.toml`.

| table | content |
|---|---|
| fields.NAME | path, value, intervals, and whether the variance is over 50 % of the prior's |
| rows.NAME | measured and predicted, fitted or held out, and the twin's figure behind it |
| limits.NAME | a bound from one side, the twin's figure, and the probability that it is met |
| bounds | intervals of the fields with other bounds of a limit; no `bound`: without the limit |
| models | choices with their probabilities, the most probable first |
| ridges | combinations of fields that cannot be separated, by components |
| worth.NAME | remaining share of each field's variance if this were measured |
| decisions | expected probability of the best choice of an alternative if a row were measured |
| draws | joint samples within all stated ranges; equal indices of the lists are one sample |
"""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from reconstruction.arrays import FloatArray
from reconstruction.writing import write_text
from twin.identification.findings import BoundCompared, LimitMet, Prediction
from twin.identification.known import Identified
from twin.identification.record import identified_values

SUMMARY_FILE = "identified.toml"
DRAWS = 64
_DIGITS = 5


def write_summary(folder: Path, identified: Identified) -> None:
    """Write the summary of an identification as `identified.toml` into a folder."""
    text = tomli_w.dumps(summary_of(identified))
    write_text(folder / SUMMARY_FILE, text)


def summary_of(identified: Identified) -> dict[str, Any]:
    """Return the summary as nested tables of texts, numbers and lists, as TOML stores them."""
    problem, values = identified.problem, identified_values(identified)
    open_fields, intervals = identified.undetermined(), identified.intervals()
    fields = {
        name: {"path": free.path, "hardly_narrowed": name in open_fields}
        | values[name]
        | asdict(intervals[name])
        for name, free in problem.free.items()
    }
    whole: dict[str, Any] = {
        "name": problem.name,
        "fields": fields,
        "rows": {row.row: _row(identified, row) for row in identified.best.predictions},
        "limits": {limit.limit: _limit(identified, limit) for limit in identified.limits()},
        "bounds": [_bound(compared) for compared in identified.best.bounds],
        "models": [
            {"probability": model.probability, "choices": dict(model.combination)}
            for model in identified.models
        ],
        "ridges": [asdict(ridge) for ridge in identified.ridges()],
        "worth": {worth.row: dict(worth.shrink) for worth in identified.worth()},
        "decisions": [asdict(decision) for decision in identified.decisions],
        "draws": _draws(values, identified.values, identified.seed),
    }
    rounded: dict[str, Any] = _rounded(whole)
    return rounded


def _row(identified: Identified, predicted: Prediction) -> dict[str, Any]:
    row = identified.problem.rows[predicted.row]
    metric = identified.problem.metric_of(predicted.row, row, identified.best.combination)
    content: dict[str, Any] = {
        "experiment": identified.problem.experiment_of(row, identified.best.combination),
        "figures": [metric] if isinstance(metric, str) else list(metric),
        "statistic": row.statistic,
        "measured": predicted.measured,
        "sd": predicted.sd,
        "scatter": predicted.scatter,
        "fitted": predicted.fitted,
        "twin": predicted.twin.mean,
        "twin_sd": predicted.twin.sd,
        "any_coat": predicted.any_coat.mean,
        "any_coat_sd": predicted.any_coat.sd,
        "steps": predicted.steps,
        "deviation": predicted.deviation,
    }
    rotated = identified.best.rotated.get(predicted.row)
    return content if rotated is None else content | {"deviation_when_held_out": rotated.deviation}


def _limit(identified: Identified, predicted: LimitMet) -> dict[str, Any]:
    limit = identified.problem.limits[predicted.limit]
    return {
        "experiment": identified.problem.experiment_of(limit, identified.best.combination),
        "at_least" if limit.side > 0 else "at_most": limit.value,
        "sd": limit.sd,
        "twin": predicted.twin.mean,
        "twin_sd": predicted.twin.sd,
        "probability_before": predicted.before,
        "probability": predicted.probability,
    }


def _bound(compared: BoundCompared) -> dict[str, Any]:
    content = {"limit": compared.limit, "log_evidence": compared.log_evidence}
    fields = {"fields": {name: asdict(field) for name, field in compared.fields.items()}}
    return content | ({} if compared.bound is None else {"bound": compared.bound}) | fields


def _draws(
    values: dict[str, dict[str, Any]], samples: FloatArray, seed: int
) -> dict[str, list[float]]:
    """Draw samples of the fields, by name, from those inside all stated ranges.

    An experiment with a value outside its stated range would have a warning.
    """
    low, high = np.array([field["range"] for field in values.values()]).T
    allowed = samples[((samples >= low) & (samples <= high)).all(axis=1)]
    chosen = np.random.default_rng(seed).choice(len(allowed), DRAWS)
    return {name: allowed[chosen, i].tolist() for i, name in enumerate(values)}


def _rounded(node: Any) -> Any:
    """Return nested tables with numbers rounded to 5 significant digits."""
    if isinstance(node, dict):
        return {key: _rounded(value) for key, value in node.items()}
    if isinstance(node, (list, tuple)):
        return [_rounded(value) for value in node]
    return float(f"{node:.{_DIGITS}g}") if isinstance(node, float) else node
