"""Report of an identification: fields, rows, alternative models, benefit of more measurements.

Fields are unknown properties of a sensor. They are estimated from rows, which are measured values.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from reconstruction.errors import counted
from twin.config.problem import Free
from twin.identification.findings import Marginal, Prediction, Ridge
from twin.identification.known import Identified
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.report.identified_figures import AGREES, draw_corner, draw_rows, field_words
from twin.report.page import (
    REPORT_FILE,
    Block,
    Figure,
    Grade,
    Note,
    Page,
    Section,
    Verdict,
    write_page,
)
from twin.report.table import Column, Row, Table
from twin.report.words import split_unit

_DISAGREES = 3.0
_USE = {"fitted": "fitted", "steered": "held out, steered a choice", "predicted": "held out"}


def write_identified(
    folder: Path,
    identified: Identified,
    watch: ProgressCallback = no_progress,
    into: Path | None = None,
) -> Path:
    """Write `report.html` and `figures/*.png` of an identification; return the path of the page.

    The files are written into `into`, or into `folder` if `into` is None.

    Raises
    ------
    InputError
        The page cannot be written.
    """
    return write_page((into or folder) / REPORT_FILE, page_of(identified), watch)


def page_of(identified: Identified) -> Page:
    """Return the report page of an identification."""
    problem = identified.problem
    fitted = len(problem.fitted)
    lead = (
        f"{problem.description or problem.name}: {counted(len(problem.free), 'unknown field')}, "
        f"{counted(fitted, 'row')} fitted, {len(problem.rows) - fitted} held out"
    )
    if len(identified.models) > 1:
        lead += f", {len(identified.models)} combinations of choices"
    return Page(
        kind="identification",
        title=problem.name.replace("_", " "),
        lead=f"{lead}.",
        sections=[section for section in _sections(identified) if section.blocks],
        verdicts=_verdicts(identified),
        numbered=True,
    )


def _sections(identified: Identified) -> list[Section]:
    return [
        Section("fields", "Unknown fields: prior and posterior", tuple(_fields(identified))),
        Section("rows", "Measured and predicted", tuple(_rows(identified))),
        Section("models", "Probability of the alternative models", tuple(_models(identified))),
        Section("worth", "Expected gain of one more measurement", tuple(_worth(identified))),
        Section("emulators", "Accuracy of the emulators", tuple(_emulators(identified))),
    ]


def _verdicts(identified: Identified) -> list[Verdict]:
    open_fields, named = identified.undetermined(), identified.ridges()
    reasons = [f"{name}: hardly constrained by the rows" for name in open_fields]
    reasons += [f"only in combination: {ridge_words(ridge)}" for ridge in named]
    known = len(identified.problem.free) - len(open_fields)
    grade: Grade = "good" if not reasons else "check" if known else "poor"
    return [
        Verdict(
            "Which unknown fields do the measured rows determine?",
            f"{known} of {len(identified.problem.free)} fields are narrowed",
            grade,
            tuple(reasons) or ("each field is determined separately",),
        ),
        _agreement(
            "Do the fitted rows agree with the twin?",
            [p for p in identified.best.predictions if p.fitted],
        ),
        *(
            [_agreement("Does the twin predict the held-out rows?", held)]
            if (held := [p for p in identified.best.predictions if not p.fitted])
            else []
        ),
    ]


def _agreement(question: str, rows: Sequence[Prediction]) -> Verdict:
    far = [row for row in rows if abs(row.deviation) > AGREES]
    worst = max((abs(row.deviation) for row in rows), default=0.0)
    return Verdict(
        question,
        f"{len(rows) - len(far)} of {len(rows)} within two standard deviations",
        "good" if not far else "check" if worst < _DISAGREES else "poor",
        tuple(f"{row.row}: unexplained, {row.deviation:+.1f} standard deviations" for row in far)
        or (f"largest difference: {worst:.1f} standard deviations",),
    )


def ridge_words(ridge: Ridge) -> str:
    """Return the text for a ridge, a joint change of fields that does not change the rows."""
    first, *rest = ridge.share.items()
    changes = [f"{name} {'down' if part * first[1] > 0 else 'up'}" for name, part in rest]
    return f"{first[0]} up with {', '.join(changes)} changes no row"


def _fields(identified: Identified) -> list[Block]:
    intervals, open_fields = identified.intervals(), identified.undetermined()
    rows = [
        _field_row(name, free, intervals[name], name in open_fields)
        for name, free in identified.problem.free.items()
    ]
    columns = (
        Column("field", "field"),
        Column("prior", "prior"),
        Column("mean", "mean", 4),
        Column("sd", "± (1 sd)", 4),
        Column("central", "68 % interval"),
        Column("wide", "95 % interval"),
        Column("known", "narrowed by the rows"),
        Column("source", "source of the prior"),
    )
    ridges = [
        Note(
            f"Not separable: {ridge_words(ridge)} (posterior over prior variance: of the "
            f"combination {ridge.variance_ratio:.2g}, of its best known single field "
            f"{ridge.open_ratio:.2g})"
        )
        for ridge in identified.ridges()
    ]
    figure = Figure(
        "corner",
        "",
        "Posterior of the unknown fields over all choices. Diagonal: density, and in orange the "
        "profile of the likelihood (largest over all other fields) of the most probable choices. "
        "Below: joint densities of pairs; a narrow slanted band is a pair of fields that the rows "
        "cannot separate. The axes span the range of the prior.",
        "Corner plot of the unknown fields",
        partial(draw_corner, identified),
    )
    return [Table("fields", "", "", columns, tuple(rows)), *ridges, figure, *_priors(identified)]


def _priors(identified: Identified) -> list[Block]:
    columns = (
        Column("field", "prior of"),
        Column("towards", "tilted to its"),
        Column("before", "mean before", 4),
        Column("mean", "mean after", 4),
        Column("row_steps", "largest change, in SD", 2),
        Column("row", "of the row"),
        Column("probability", "best choices", 3),
        Column("effective", "samples left", 0, "%"),
    )
    rows: list[Row] = [
        {
            "field": field_words(shift.field, identified.problem.free[shift.field]),
            "towards": f"{shift.towards} end",
            "before": shift.mean_before,
            "mean": shift.mean,
            "row_steps": shift.row_steps,
            "row": shift.row,
            "probability": shift.probability,
            "effective": 100.0 * shift.effective_share,
        }
        for shift in identified.prior_shifts()
    ]
    words = (
        "Sensitivity to the priors. One prior at a time is replaced by a linear ramp, from a "
        "factor of two at one end of its range to zero at the opposite end. The table lists the "
        "mean of the field before and after, the row with the largest change of its prediction, "
        "and the probability of the most probable choices."
    )
    return [words, Table("priors", "", "", columns, tuple(rows))]


def _field_row(name: str, free: Free, marginal: Marginal, is_open: bool) -> dict[str, str | float]:
    prior = f"{free.low:g} to {free.high:g}" + (", log scale" if free.scale == "log" else "")
    if free.mean is not None and free.sd is not None:
        prior = f"{free.mean:g} ± {free.sd:g} in {prior}"
    return {
        "field": field_words(name, free),
        "prior": prior,
        "mean": marginal.mean,
        "sd": marginal.sd,
        "central": f"{marginal.low_68:.4g} to {marginal.high_68:.4g}",
        "wide": f"{marginal.low_95:.4g} to {marginal.high_95:.4g}",
        "known": "hardly" if is_open else "yes",
        "source": free.source or "",
    }


def _rows(identified: Identified) -> list[Block]:
    columns = (
        Column("row", "row"),
        Column("use", "use"),
        Column("measured", "measured", 4),
        Column("measured_sd", "± (1 sd)", 4),
        Column("twin", "twin", 4),
        Column("twin_sd", "± (1 sd) ", 4),
        Column("any_coat", "with any coat", 4),
        Column("any_coat_sd", "± (1 sd)  ", 4),
        Column("steps", "difference, in SD of one", 2),
        Column("deviation", "normalised difference", 2),
        Column("rotated", "when held out", 2),
    )
    problem, rotated = identified.problem, identified.best.rotated
    rows = [
        {
            "row": prediction.row,
            "use": _USE[problem.rows[prediction.row].use],
            "measured": prediction.measured,
            "measured_sd": prediction.sd,
            "twin": prediction.twin.mean,
            "twin_sd": prediction.twin.sd,
            "any_coat": prediction.any_coat.mean,
            "any_coat_sd": prediction.any_coat.sd,
            "steps": prediction.steps,
            "deviation": prediction.deviation,
            "rotated": rotated[prediction.row].deviation if prediction.row in rotated else None,
        }
        for prediction in identified.best.predictions
    ]
    sources = [f"{n}: {row.source}" for n, row in problem.rows.items() if row.source]
    sources += [f"{n}: {row.steered}" for n, row in problem.rows.items() if row.steered]
    figure = Figure(
        "rows",
        "",
        "Measured minus predicted value, averaged over possible coats, divided by the standard "
        "deviation of the difference (measurement, unknown fields, nuisances, discrepancy, coat, "
        "emulator). Filled: fitted rows, open: held-out rows. Band: ± two standard deviations.",
        "Normalised difference of every row",
        partial(draw_rows, identified),
    )
    return [
        Table("rows", "", "", columns, tuple(rows), tuple(sources)),
        figure,
        *_limits(identified),
    ]


def _limits(identified: Identified) -> list[Block]:
    limits = identified.problem.limits
    if not limits:
        return []
    columns = (
        Column("limit", "limit"),
        Column("known", "known range"),
        Column("sd", "± (1 sd)", 3),
        Column("twin", "twin", 3),
        Column("twin_sd", "± (1 sd) ", 3),
        Column("before", "probability from the priors only", 0, "%"),
        Column("after", "probability given rows and limits", 0, "%"),
    )
    rows: list[Row] = [
        {
            "limit": limit.limit,
            "known": limits[limit.limit].words,
            "sd": limits[limit.limit].sd,
            "twin": limit.twin.mean,
            "twin_sd": limit.twin.sd,
            "before": 100.0 * limit.before,
            "after": 100.0 * limit.probability,
        }
        for limit in identified.limits()
    ]
    sources = tuple(f"{name}: {limit.source}" for name, limit in limits.items() if limit.source)
    words = (
        "Figures for which only a lower or an upper limit is known; they are fitted like the rows."
    )
    return [words, Table("limits", "", "", columns, tuple(rows), sources), *_bounds(identified)]


def _bounds(identified: Identified) -> list[Block]:
    """Return the table of the fields' 95 % intervals with other bounds of the limits."""
    free = identified.problem.free
    columns = (
        Column("limit", "limit"),
        Column("bound", "bound"),
        *(Column(name, field_words(name, field)) for name, field in free.items()),
        Column("evidence", "log evidence", 2),
    )
    rows: list[Row] = [
        {
            "limit": compared.limit,
            "bound": "without" if compared.bound is None else f"{compared.bound:g}",
            "evidence": compared.log_evidence,
            **{n: f"{m.low_95:.3g} to {m.high_95:.3g}" for n, m in compared.fields.items()},
        }
        for compared in identified.best.bounds
    ]
    words = "Influence of the bounds: 95 % intervals of the fields, for the most probable choices."
    return [words, Table("bounds", "", "", columns, tuple(rows))] if rows else []


def _models(identified: Identified) -> list[Block]:
    if len(identified.models) == 1:
        return []
    names = list(identified.problem.alternatives)
    columns = (
        *(Column(name, name.replace("_", " ")) for name in names),
        Column("prior", "prior probability"),
        Column("probability", "probability given the rows"),
        Column("evidence", "log evidence", 2),
        Column("evidence_sd", "its standard error", 2),
    )
    rows: list[Row] = [
        dict(model.combination)
        | {
            "prior": model.prior,
            "probability": model.probability,
            "evidence": model.posterior.log_evidence,
            "evidence_sd": model.posterior.log_evidence_sd,
        }
        for model in identified.models
    ]
    return [Table("models", "", "", columns, tuple(rows))]


def _worth(identified: Identified) -> list[Block]:
    ranked = identified.worth()
    if not ranked:
        return []
    fields = list(identified.problem.free)
    columns = (
        Column("row", "measurement"),
        Column("sd", "± (1 sd)", 4),
        Column("expected_sd", "twin ± (1 sd)", 4),
        *(Column(name, split_unit(name)[0].replace("_", " "), 2) for name in fields),
        Column("gain", "information", 2, "nats"),
    )
    rows: list[Row] = [
        {
            "row": candidate.row,
            "sd": identified.problem.worth[candidate.row].sd,
            "expected_sd": candidate.expected_sd,
            **candidate.shrink,
            "gain": candidate.gain,
        }
        for candidate in ranked
    ]
    words = (
        "Remaining share of the present variance of each field (1: no gain) after a measurement "
        "with the stated standard deviation; the most informative measurement first."
    )
    return [words, Table("worth", "", "", columns, tuple(rows)), *_decisions(identified)]


def _decisions(identified: Identified) -> list[Block]:
    decisions = identified.decisions
    if not decisions:
        return []
    columns = (
        Column("row", "measurement"),
        Column("alternative", "alternative"),
        Column("before", "best choice now", 3),
        Column("after", "best choice after the measurement", 3),
    )
    rows: tuple[Row, ...] = tuple(
        {"row": d.row, "alternative": d.alternative, "before": d.before, "after": d.after}
        for d in decisions
    )
    words = (
        "Probability that the most probable choice of an alternative is the true one: now, and "
        "expected after the measurement; the measurement that decides best first."
    )
    return [words, Table("decisions", "", "", columns, rows)]


def _emulators(identified: Identified) -> list[Block]:
    columns = (
        Column("row", "figure"),
        Column("rmse", "cross-validated error, RMS", 5),
        Column("sd", "the row's standard deviation", 5),
        Column("missing", "simulations without it", 1, "%"),
    )
    every = identified.problem.figures
    rows: list[Row] = [
        {
            "row": name,
            "rmse": emulator.cross_validated_rmse,
            "sd": every[name].sd,
            "missing": 100.0 * emulator.missing,
        }
        for name, emulator in identified.best.emulators.items()
    ]
    notes = ("Error for one noisy simulation that was left out of the training (leave-one-out).",)
    coarse = [
        n
        for n, emulator in identified.best.emulators.items()
        if emulator.cross_validated_rmse > every[n].sd
    ]
    remark = Note(
        f"Emulator error larger than the row's standard deviation: {', '.join(coarse)}. The "
        "intervals include it; more simulations (design.count) or narrower priors reduce it."
    )
    table = Table("emulators", "", "", columns, tuple(rows), notes)
    return [table, *([remark] if coarse else []), _sampling(identified)]


def _sampling(identified: Identified) -> Note:
    """Return a note on the convergence of the Markov chains.

    The note is on the probable combination of choices with the fewest independent samples.
    """
    posteriors = [model.posterior for model in identified.probable]
    worst = min(posteriors, key=lambda posterior: posterior.independent)
    words = (
        f"The chains ran {worst.steps} steps, autocorrelation time {worst.correlation_time:.0f} "
        f"steps: about {worst.independent:.0f} independent samples."
    )
    if all(posterior.is_converged for posterior in posteriors):
        return Note(words)
    return Note(f"{words} The chains are too short: the intervals are approximate.", kind="failure")
