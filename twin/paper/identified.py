"""The paper's sensor as identified: what its rows say, what they cannot, what would help.

The findings are those of `twin identify paper/identify`, kept as scenes/paper/identified.toml.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.reading import read_json
from twin.config.problem import Free, SensorProblem, load_problem
from twin.output import RESULT_FILE
from twin.paper.plan import identified
from twin.paper.statistics import spread_of, values_of
from twin.paper.trials import REFUSED, Trial
from twin.report.canvas import FIT, MEASURED, axes_at, plain_spines, printing
from twin.report.identified_figures import field_words, mark
from twin.report.table import Cell, Column, Table

PROBLEM = "paper/identify"
# Every experiment at the identified values is scored over the identified region.
_REGION = "within_{region_mm}_"
_RIDGE_PANELS = 3
# Whose folder among the cases shows the pictures through the coat.
_METHOD = "contact_fpp"


@lru_cache
def problem() -> SensorProblem:
    """Return what was asked."""
    return load_problem(PROBLEM)[0]


def identified_tables(trials: Mapping[str, Sequence[Trial]]) -> list[Table]:
    """Return fields, rows and worth; `trials` by the experiment of the problem."""
    return [fields_table(), identified_rows_table(trials), choices_table(), worth_table()]


def fields_table() -> Table:
    """Return what is known of each field that the paper does not state."""
    rows: list[dict[str, Cell]] = []
    for name, free in problem().free.items():
        one = identified()["fields"][name]
        rows.append(
            {
                "field": field_words(name, free),
                "prior": f"{free.low:g} to {free.high:g}",
                "value": one["value"],
                "central": f"{one['low_68']:.3g} to {one['high_68']:.3g}",
                "wide": f"{one['low_95']:.3g} to {one['high_95']:.3g}",
                "known": "hardly" if one["hardly_narrowed"] else "yes",
            }
        )
    columns = (
        Column("field", "field"),
        Column("prior", "prior"),
        Column("value", "used here, most probable"),
        Column("central", "68 % interval"),
        Column("wide", "95 % interval"),
        Column("known", "narrowed by the rows"),
    )
    return Table("identified_fields", "What the paper does not state", "", columns, tuple(rows))


def identified_rows_table(trials: Mapping[str, Sequence[Trial]]) -> Table:
    """Return every row: the paper's, the prediction of the identification, and the trials here."""
    rows: list[dict[str, Cell]] = []
    for name, one in identified()["rows"].items():
        near = abs(one["steps"])
        row: dict[str, Cell] = {
            "row": name,
            "use": "fitted" if one["fitted"] else "predicted",
            "paper": one["measured"],
            "scatter": one["scatter"],
            "twin": one["twin"],
            "twin_sd": one["twin_sd"],
            "any_coat": one["any_coat"],
            "any_coat_sd": one["any_coat_sd"],
            "steps": one["steps"],
            "within": "1 SD" if near <= 1.0 else "2 SD" if near <= 2.0 else "unexplained",
        }
        rows.append(row | _of_trials(one, trials.get(one["experiment"], ())))
    columns = (
        Column("row", "row"),
        Column("use", "use"),
        Column("paper", "paper", 4),
        Column("scatter", "SD of one measurement", 4),
        Column("twin", "twin, identified", 4),
        Column("twin_sd", "SD", 4),
        Column("any_coat", "with any coat", 4),
        Column("any_coat_sd", "SD", 4),
        Column("steps", "paper minus twin, in the paper's SD", 2),
        Column("within", "within the paper's"),
        Column("trials_mean", "trials: mean", 4),
        Column("trials_sd", "SD", 4),
        Column("refused", "refused"),
    )
    notes = (
        "Identified: given the fitted rows, with what these tell of scale errors and of the coat "
        "that a ball met in all trials. With any coat: another sensor of the same fields. SD: "
        "unknown fields, scale errors, coat, emulator. Rows that are predicted took no part in "
        "finding the fields.",
        "Refused: trials whose drawn sheet holds less than the drawn pressure, left out.",
    )
    return Table("identified", "Every row of the paper's tables", "", columns, tuple(rows), notes)


def _of_trials(one: Mapping[str, Any], trials: Sequence[Trial]) -> dict[str, Cell]:
    repeated = [trial for trial in trials if trial.number]
    names = [name.replace(_REGION, "") for name in one["figures"]]
    spreads = [s for n in names if (s := spread_of(values_of(repeated, n))) is not None]
    refused = sum(REFUSED in trial.figures for trial in repeated)
    if not spreads:
        return {"refused": refused} if refused else {}
    sds = [s.sd for s in spreads if s.sd is not None]
    pooled = float(np.sqrt(np.mean(np.square(sds)))) if sds else None
    if one["statistic"] == "sd":
        return {"trials_mean": pooled, "refused": refused}
    mean = float(np.mean([s.mean for s in spreads]))
    return {"trials_mean": mean, "trials_sd": pooled, "refused": refused}


def pictures_table(cases: Path) -> Table:
    """Return what the paper's pictures show of its objects, beside the cases NAME/METHOD here."""
    rows: list[dict[str, Cell]] = []
    for name, limit in problem().limits.items():
        one, specimen = identified()["limits"][name], problem().experiments[limit.experiment].base
        result = cases / specimen.rsplit("/", 1)[-1] / _METHOD / RESULT_FILE
        measured = read_json(result)["metrics"].get(limit.metric)
        rows.append(
            {
                "figure": str(limit.metric).replace("_", " "),
                "known": limit.words,
                "sd": limit.sd,
                "twin": one["twin"],
                "twin_sd": one["twin_sd"],
                "before": one["probability_before"],
                "probability": one["probability"],
                "measured": measured,
                "met": "yes" if measured is not None and limit.allows(measured) else "NO",
                "source": limit.source or "",
            }
        )
    columns = (
        Column("figure", "figure"),
        Column("known", "paper's picture"),
        Column("sd", "± (1 sd)", 2),
        Column("twin", "twin, identified", 2),
        Column("twin_sd", "SD", 2),
        Column("before", "met, by the priors alone", 2),
        Column("probability", "met, as identified", 2),
        Column("measured", "the chain, at the most probable values", 2),
        Column("met", "met by it"),
        Column("source", "source"),
    )
    return Table("pictures", "What the paper's pictures show", "", columns, tuple(rows))


def choices_table() -> Table:
    """Return the probabilities of the discrete choices, each over all others."""
    shares: dict[tuple[str, str], float] = {}
    for model in identified()["models"]:
        for alternative, choice in model["choices"].items():
            key = alternative, choice
            shares[key] = shares.get(key, 0.0) + model["probability"]
    rows: tuple[dict[str, Cell], ...] = tuple(
        {"choice": f"{a}: {c}".replace("_", " "), "probability": p, "source": _source(a)}
        for (a, c), p in sorted(shares.items(), key=lambda item: (item[0][0], -item[1]))
    )
    columns = (
        Column("choice", "choice"),
        Column("probability", "probability given the fitted rows"),
        Column("source", "what the paper says"),
    )
    return Table("identified_choices", "What is one or the other", "", columns, rows)


def _source(alternative: str) -> str:
    return problem().alternatives[alternative].source or ""


def worth_table() -> Table:
    """Return what one more measurement would decide, the most telling first."""
    free, worth = problem().free, identified()["worth"]
    rows: list[dict[str, Cell]] = [
        {"measurement": problem().worth[name].source, "sd": problem().worth[name].sd} | left
        for name, left in worth.items()
    ]
    columns = (
        Column("measurement", "measurement"),
        Column("sd", "± (1 sd)", 3),
        *(Column(name, field_words(name, one), 2) for name, one in free.items()),
    )
    words = "What would be left of the variance of each field; 1: nothing is gained."
    title = "What one caliper reading would decide"
    return Table("identified_worth", title, "", columns, tuple(rows), (words,))


def draw_ridges(_cases: Path, stem: Path) -> None:
    """Draw joint samples of the pairs of fields that trade off most."""
    pairs = _strongest_pairs()
    with printing(stem, 0.7 + 2.3 * len(pairs), 2.4) as figure:
        for number, (across, up) in enumerate(pairs):
            axes = axes_at(figure, 0.65 + 2.3 * number, 0.2, 1.55, 1.55)
            axes.plot(_draws(across), _draws(up), "o", ms=2.5, color=MEASURED)
            values = identified()["fields"]
            axes.plot(values[across]["value"], values[up]["value"], "+", ms=9, color=FIT)
            for name, setting in ((across, axes.set_xlabel), (up, axes.set_ylabel)):
                setting(field_words(name, problem().free[name]))
            one, other = problem().free[across], problem().free[up]
            axes.set(xscale=one.scale, yscale=other.scale)
            axes.set(xlim=(one.low, one.high), ylim=(other.low, other.high))
            mark(axes.xaxis, one)
            mark(axes.yaxis, other)
            plain_spines(axes)


def _strongest_pairs() -> list[tuple[str, str]]:
    def correlation(pair: tuple[str, str]) -> float:
        one, other = (_shares(problem().free[name], _draws(name)) for name in pair)
        return abs(float(np.corrcoef(one, other)[0, 1]))

    ranked = sorted(combinations(problem().free, 2), key=correlation, reverse=True)
    return ranked[:_RIDGE_PANELS]


def _shares(free: Free, values: FloatArray) -> FloatArray:
    return np.log(values) if free.scale == "log" else values


def _draws(name: str) -> FloatArray:
    return np.array(identified()["draws"][name])
