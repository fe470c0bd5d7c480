"""Tables and figure on the identification of the paper's sensor.

Fields are properties of the sensor that the paper does not state. They were estimated from the rows
of the paper's tables by `twin identify`. The summary of this identification is stored in
scenes/paper/identified.toml; its `name` selects the problem that it belongs to. Values and SDs of
the rows are those of the problem, predictions those of the summary: rows that were not fitted have
no influence on the predictions.
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
from twin.config.rows import Row
from twin.output import RESULT_FILE
from twin.paper.plan import BALLS, experiment_of, identified
from twin.paper.statistics import spread_of, values_of
from twin.paper.trials import REFUSED, Trial
from twin.report.canvas import FIT, MEASURED, axes_at, plain_spines, printing
from twin.report.identified_figures import field_words, mark
from twin.report.table import Cell, Column, Table

PROBLEMS = {"paper": "paper/identify", "paper_next": "paper/identify_next"}
"""Problem file by the name of the problem, the latest last."""
# Part of a figure's name for a fit region. Experiments at the identified values are scored over the
# identified region, so that their figures' names do not have it.
_REGION = "within_{region_mm}_"
_RIDGE_PANELS = 3
# Method of the cases that correspond to the limits, which are on the coat.
_METHOD = "contact_fpp"


@lru_cache
def problem() -> SensorProblem:
    """Return the identification problem of the paper's sensor: fields, rows, alternatives."""
    return load_problem(PROBLEMS[identified()["name"]])[0]


def pending() -> str:
    """Return the note on a problem that is newer than the stored solution; empty if none is."""
    *_, latest = PROBLEMS
    if identified()["name"] == latest:
        return ""
    file = PROBLEMS[latest]
    return (
        f"Stored solution: {PROBLEMS[identified()['name']]}. The problem {file}, which holds out "
        "another row and has GelSight's region and integration as choices, has not been solved "
        f"yet: `twin identify {file} -o DIR` solves it."
    )


def cases_of_pictures() -> tuple[tuple[str, str], ...]:
    """Return specimen and method of every case that the table of limits needs."""
    experiments = [problem().experiments[limit.experiment] for limit in problem().limits.values()]
    return tuple((of.base.rsplit("/", 1)[-1], _METHOD) for of in experiments)


def fields_table() -> Table:
    """Return the table of prior, value and intervals of each field."""
    rows: list[dict[str, Cell]] = []
    for name, free in problem().free.items():
        known = identified()["fields"][name]
        rows.append(
            {
                "field": field_words(name, free),
                "prior": f"{free.low:g} to {free.high:g}",
                "value": known["value"],
                "central": f"{known['low_68']:.3g} to {known['high_68']:.3g}",
                "wide": f"{known['low_95']:.3g} to {known['high_95']:.3g}",
                "known": "hardly" if known["hardly_narrowed"] else "yes",
            }
        )
    rows.append(_assumed_pose())
    columns = (
        Column("field", "field"),
        Column("prior", "prior"),
        Column("value", "used here, most probable"),
        Column("central", "68 % interval"),
        Column("wide", "95 % interval"),
        Column("known", "narrowed by the rows"),
    )
    title = "Properties that the paper does not state"
    return Table("identified_fields", title, "", columns, tuple(rows))


def _assumed_pose() -> dict[str, Cell]:
    """Return the row of the camera's pose, which is assumed and in no identification free."""
    experiment = experiment_of(BALLS)
    origin = experiment.provenance["camera.pose.polar_deg"]
    low, high = origin.range or (None, None)
    return {
        "field": "camera and projector from the vertical (deg)",
        "prior": f"{low:g} to {high:g}",
        "value": experiment.camera.pose.polar_deg,
        "known": origin.source,
    }


def identified_rows_table(trials: Mapping[str, Sequence[Trial]]) -> Table:
    """Return the table of all rows: the paper's value, the identified prediction and the trials."""
    rows: list[dict[str, Cell]] = []
    for name, known in identified()["rows"].items():
        row = problem().rows[name]
        judged = judged_difference(row, known)
        near = abs(judged)
        cells: dict[str, Cell] = {
            "row": name,
            "use": row.use,
            "paper": row.value,
            "scatter": row.scatter,
            "twin": known["twin"],
            "twin_sd": known["twin_sd"],
            "any_coat": known["any_coat"],
            "any_coat_sd": known["any_coat_sd"],
            "judged": judged,
            "within": "1 SD" if near <= 1.0 else "2 SD" if near <= 2.0 else "unexplained",
        }
        rows.append(cells | _of_trials(known, trials.get(known["experiment"], ())))
    columns = (
        Column("row", "row"),
        Column("use", "use"),
        Column("paper", "paper", 4),
        Column("scatter", "SD of one measurement", 4),
        Column("twin", "twin, identified", 4),
        Column("twin_sd", "SD", 4),
        Column("any_coat", "with any coat", 4),
        Column("any_coat_sd", "SD", 4),
        Column("judged", "paper minus twin, in SD", 2),
        Column("within", "within"),
        Column("trials_mean", "trials: mean", 4),
        Column("trials_sd", "SD", 4),
        Column("refused", "refused"),
    )
    notes = (
        "Identified: prediction conditioned on the fitted rows, including correlated errors of "
        "scale and of the coat common to a ball's trials. With any coat: prediction for another "
        "sensor with the same fields. SD: from unknown fields, scale errors, coat and emulator. "
        "Predicted rows were not used to identify the fields; steered: not fitted either, but a "
        "choice of model or evaluation was made after a comparison with the row.",
        "Paper minus twin: of predicted and steered rows in the paper's SD of one measurement. Of "
        "fitted rows, whose prediction given themselves cannot fail: paper minus prediction with "
        "any coat, without the row itself where it was held out in turn, in SD of the difference.",
        *_steered_notes(),
        "Refused: trials without a stable equilibrium of the drawn sheet at the drawn pressure; "
        "they are omitted.",
    )
    return Table("identified", "Every row of the paper's tables", "", columns, tuple(rows), notes)


def _steered_notes() -> list[str]:
    """Return one note for each choice that rows steered, with the names of these rows."""
    by_choice: dict[str, list[str]] = {}
    for name, row in problem().rows.items():
        if row.steered:
            by_choice.setdefault(row.steered, []).append(name)
    return [f"{', '.join(names)}: {choice}." for choice, names in by_choice.items()]


def judged_difference(row: Row, known: Mapping[str, Any]) -> float:
    """Return the difference of the paper's value from the stored prediction, in SD.

    A row that was not fitted: from the prediction given the fitted rows, in the paper's SD of one
    measurement. A fitted row: from the prediction with any coat, in SD of the difference; if the
    row was held out in turn, from the prediction by the other rows.
    """
    if row.use != "fitted":
        return float((row.value - known["twin"]) / row.scatter)
    given_itself = (row.value - known["any_coat"]) / np.hypot(known["any_coat_sd"], row.sd)
    return float(known.get("deviation_when_held_out", given_itself))


def _of_trials(known: Mapping[str, Any], trials: Sequence[Trial]) -> dict[str, Cell]:
    repeated = [trial for trial in trials if trial.number]
    names = [name.replace(_REGION, "") for name in known["figures"]]
    spreads = [s for n in names if (s := spread_of(values_of(repeated, n))) is not None]
    refused = sum(REFUSED in trial.figures for trial in repeated)
    if not spreads:
        return {"refused": refused} if refused else {}
    sds = [s.sd for s in spreads if s.sd is not None]
    pooled = float(np.sqrt(np.mean(np.square(sds)))) if sds else None
    if known["statistic"] == "sd":
        return {"trials_mean": pooled, "refused": refused}
    mean = float(np.mean([s.mean for s in spreads]))
    return {"trials_mean": mean, "trials_sd": pooled, "refused": refused}


def pictures_table(cases: Path) -> Table:
    """Return the table of limits assumed from the paper's text, with the values measured here.

    Parameters
    ----------
    cases : folder of the measured cases NAME/METHOD
    """
    rows: list[dict[str, Cell]] = []
    for name, limit in problem().limits.items():
        known, specimen = identified()["limits"][name], problem().experiments[limit.experiment].base
        result = cases / specimen.rsplit("/", 1)[-1] / _METHOD / RESULT_FILE
        measured = read_json(result)["metrics"].get(limit.metric)
        rows.append(
            {
                "figure": str(limit.metric).replace("_", " "),
                "known": limit.words,
                "sd": limit.sd,
                "twin": known["twin"],
                "twin_sd": known["twin_sd"],
                "before": known["probability_before"],
                "probability": known["probability"],
                "measured": measured,
                "met": "yes" if measured is not None and limit.allows(measured) else "NO",
                "source": limit.source or "",
            }
        )
    columns = (
        Column("figure", "figure"),
        Column("known", "assumed limit"),
        Column("sd", "± (1 sd)", 2),
        Column("twin", "twin, identified", 2),
        Column("twin_sd", "SD", 2),
        Column("before", "probability under the priors", 2),
        Column("probability", "probability as identified", 2),
        Column("measured", "whole chain, at the most probable values", 2),
        Column("met", "met by the whole chain"),
        Column("source", "source"),
    )
    return Table("pictures", "Limits assumed from the paper's text", "", columns, tuple(rows))


def bounds_table() -> Table:
    """Return the table of the fields' 95 % intervals with other bounds of the limits.

    The stored bound is always in the table; others are if the summary contains them.
    """
    free, summary = problem().free, identified()
    stored = {(b["limit"], b.get("bound")): b["fields"] for b in summary.get("bounds", ())}
    rows: list[dict[str, Cell]] = []
    missing = False
    for name, limit in problem().limits.items():
        stored.setdefault((name, limit.value), summary["fields"])
        for bound in (None, *sorted({limit.value, *limit.compare_at})):
            fields = stored.get((name, bound), {})
            missing = missing or not fields
            words = "without" if bound is None else limit.at(bound).words
            row: dict[str, Cell] = {"limit": name.replace("_", " "), "bound": words}
            row |= {n: f"{f['low_95']:.3g} to {f['high_95']:.3g}" for n, f in fields.items()}
            rows.append(row)
    columns = (
        Column("limit", "limit"),
        Column("bound", "bound"),
        *(Column(name, field_words(name, field)) for name, field in free.items()),
    )
    note = (
        "Empty rows are not in the stored solution: `twin identify "
        f"{PROBLEMS[summary['name']]} -o DIR` computes them. Lowest pressure at which the nominal "
        "sheet has the share: docs/paper.md."
    )
    title = "Influence of a limit's bound: 95 % intervals of the fields"
    return Table("identified_bounds", title, "", columns, tuple(rows), (note,) if missing else ())


def choices_table() -> Table:
    """Return the table of probabilities of the discrete choices.

    The probability of a choice is summed over all combinations with other alternatives.
    """
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
        Column("source", "statement of the paper"),
    )
    return Table("identified_choices", "Discrete alternatives", "", columns, rows)


def _source(alternative: str) -> str:
    return problem().alternatives[alternative].source or ""


def worth_table() -> Table:
    """Return the table of the remaining share of each field's variance after one more measurement.

    The most informative measurement is in the first row.
    """
    free, worth = problem().free, identified()["worth"]
    rows: list[dict[str, Cell]] = [
        {"measurement": problem().worth[name].source, "sd": problem().worth[name].sd} | left
        for name, left in worth.items()
    ]
    columns = (
        Column("measurement", "measurement"),
        Column("sd", "± (1 sd)", 3),
        *(Column(name, field_words(name, field), 2) for name, field in free.items()),
    )
    words = "Remaining share of the variance of each field; 1: no reduction."
    title = "Expected reduction of variances by one caliper reading"
    return Table("identified_worth", title, "", columns, tuple(rows), (words,))


def decisions_table() -> Table:
    """Return the table of how well one more measurement decides a discrete alternative.

    The best decision is in the first row. A solution without stored decisions has no rows.
    """
    rows: tuple[dict[str, Cell], ...] = tuple(
        {
            "measurement": problem().worth[decision["row"]].source,
            "alternative": decision["alternative"].replace("_", " "),
            "before": decision["before"],
            "after": decision["after"],
        }
        for decision in identified().get("decisions", ())
    )
    columns = (
        Column("measurement", "measurement"),
        Column("alternative", "alternative"),
        Column("before", "probability of the best choice now", 2),
        Column("after", "expected after the measurement", 2),
    )
    words = "Probability that the most probable choice is the true one, on average over readings."
    title = "Which measurement would decide an alternative"
    return Table("identified_decisions", title, "", columns, rows, (words,))


def draw_ridges(_cases: Path, stem: Path) -> None:
    """Draw joint posterior samples of the pairs of fields with the largest correlation."""
    pairs = _strongest_pairs()
    with printing(stem, 0.7 + 2.3 * len(pairs), 2.4) as figure:
        for number, (across, up) in enumerate(pairs):
            axes = axes_at(figure, 0.65 + 2.3 * number, 0.2, 1.55, 1.55)
            axes.plot(_draws(across), _draws(up), "o", ms=2.5, color=MEASURED)
            values = identified()["fields"]
            axes.plot(values[across]["value"], values[up]["value"], "+", ms=9, color=FIT)
            for name, setting in ((across, axes.set_xlabel), (up, axes.set_ylabel)):
                setting(field_words(name, problem().free[name]))
            x, y = problem().free[across], problem().free[up]
            axes.set(xscale=x.scale, yscale=y.scale)
            axes.set(xlim=(x.low, x.high), ylim=(y.low, y.high))
            mark(axes.xaxis, x)
            mark(axes.yaxis, y)
            plain_spines(axes)


def _strongest_pairs() -> list[tuple[str, str]]:
    def correlation(pair: tuple[str, str]) -> float:
        x, y = (_shares(problem().free[name], _draws(name)) for name in pair)
        return abs(float(np.corrcoef(x, y)[0, 1]))

    ranked = sorted(combinations(problem().free, 2), key=correlation, reverse=True)
    return ranked[:_RIDGE_PANELS]


def _shares(free: Free, values: FloatArray) -> FloatArray:
    return np.log(values) if free.scale == "log" else values


def _draws(name: str) -> FloatArray:
    return np.array(identified()["draws"][name])
