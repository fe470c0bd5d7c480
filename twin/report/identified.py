"""The report of an identification: what is known of a sensor, what is not, and what would tell."""

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


def write_identified(
    folder: Path, found: Identified, watch: ProgressCallback = no_progress, into: Path | None = None
) -> Path:
    """Write `report.html` and `figures/*.png`.

    Raises
    ------
    InputError
        The page cannot be written.
    """
    return write_page((into or folder) / REPORT_FILE, page_of(found), watch)


def page_of(found: Identified) -> Page:
    """Return the page of an identification."""
    problem = found.problem
    fitted = len(problem.fitted)
    lead = (
        f"{problem.description or problem.name}: {counted(len(problem.free), 'unknown field')}, "
        f"{counted(fitted, 'row')} fitted, {len(problem.rows) - fitted} held out"
    )
    if len(found.models) > 1:
        lead += f", {len(found.models)} combinations of choices"
    return Page(
        kind="identification",
        title=problem.name.replace("_", " "),
        lead=f"{lead}.",
        sections=[section for section in _sections(found) if section.blocks],
        verdicts=_verdicts(found),
        numbered=True,
    )


def _sections(found: Identified) -> list[Section]:
    return [
        Section("fields", "What the rows say of the unknown fields", tuple(_fields(found))),
        Section("rows", "Measured and predicted", tuple(_rows(found))),
        Section("models", "Which choices hold", tuple(_models(found))),
        Section("worth", "What one more measurement would decide", tuple(_worth(found))),
        Section("emulators", "How well the simulations are learned", tuple(_emulators(found))),
    ]


def _verdicts(found: Identified) -> list[Verdict]:
    open_fields, named = found.undetermined(), found.ridges()
    told = [f"{name}: the rows say little of it" for name in open_fields]
    told += [f"only in combination: {ridge_words(one)}" for one in named]
    known = len(found.problem.free) - len(open_fields)
    grade: Grade = "good" if not told else "check" if known else "poor"
    return [
        Verdict(
            "What is known?",
            f"{known} of {len(found.problem.free)} fields are narrowed",
            grade,
            tuple(told) or ("every field by itself",),
        ),
        _agreement("Do the fitted rows agree?", [p for p in found.best.predictions if p.fitted]),
        *(
            [_agreement("Are the held-out rows predicted?", held)]
            if (held := [p for p in found.best.predictions if not p.fitted])
            else []
        ),
    ]


def _agreement(question: str, rows: Sequence[Prediction]) -> Verdict:
    far = [one for one in rows if abs(one.deviation) > AGREES]
    worst = max((abs(one.deviation) for one in rows), default=0.0)
    return Verdict(
        question,
        f"{len(rows) - len(far)} of {len(rows)} within two standard deviations",
        "good" if not far else "check" if worst < _DISAGREES else "poor",
        tuple(f"{one.row}: unexplained, {one.deviation:+.1f} standard deviations" for one in far)
        or (f"farthest: {worst:.1f} standard deviations",),
    )


def ridge_words(ridge: Ridge) -> str:
    """Say a ridge: which fields, moved which way, leave the rows as they are."""
    first, *rest = ridge.share.items()
    ways = [f"{name} {'down' if part * first[1] > 0 else 'up'}" for name, part in rest]
    return f"{first[0]} up with {', '.join(ways)} changes no row"


def _fields(found: Identified) -> list[Block]:
    intervals, open_fields = found.intervals(), found.undetermined()
    rows = [
        _field_row(name, free, intervals[name], name in open_fields)
        for name, free in found.problem.free.items()
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
            f"Not separable: {ridge_words(one)} (posterior over prior variance across it "
            f"{one.variance_ratio:.2g}, of the best known of its fields alone {one.open_ratio:.2g})"
        )
        for one in found.ridges()
    ]
    figure = Figure(
        "corner",
        "",
        "Posterior of the unknown fields over all choices. Diagonal: density, and in orange the "
        "profile of the likelihood (largest over all other fields) of the most probable choices. "
        "Below: pairs; a narrow slanted band is a combination that the rows cannot take apart. The "
        "axes span the prior's range.",
        "Corner plot of the unknown fields",
        partial(draw_corner, found),
    )
    return [Table("fields", "", "", columns, tuple(rows)), *ridges, figure, *_priors(found)]


def _priors(found: Identified) -> list[Block]:
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
            "field": field_words(one.field, found.problem.free[one.field]),
            "towards": f"{one.towards} end",
            "before": one.mean_before,
            "mean": one.mean,
            "row_steps": one.row_steps,
            "row": one.row,
            "probability": one.probability,
            "effective": 100.0 * one.effective_share,
        }
        for one in found.prior_shifts()
    ]
    words = (
        "What the priors do to the conclusions: each is tilted in turn, twice as dense at one end "
        "and none at the other. Means, the row whose prediction moves most, and the probability of "
        "the most probable choices."
    )
    return [words, Table("priors", "", "", columns, tuple(rows))]


def _field_row(name: str, free: Free, one: Marginal, is_open: bool) -> dict[str, str | float]:
    prior = f"{free.low:g} to {free.high:g}" + (", log scale" if free.scale == "log" else "")
    if free.mean is not None and free.sd is not None:
        prior = f"{free.mean:g} ± {free.sd:g} in {prior}"
    return {
        "field": field_words(name, free),
        "prior": prior,
        "mean": one.mean,
        "sd": one.sd,
        "central": f"{one.low_68:.4g} to {one.high_68:.4g}",
        "wide": f"{one.low_95:.4g} to {one.high_95:.4g}",
        "known": "hardly" if is_open else "yes",
        "source": free.source or "",
    }


def _rows(found: Identified) -> list[Block]:
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
    problem, rotated = found.problem, found.best.rotated
    rows = [
        {
            "row": one.row,
            "use": "fitted" if one.fitted else "held out",
            "measured": one.measured,
            "measured_sd": one.sd,
            "twin": one.twin.mean,
            "twin_sd": one.twin.sd,
            "any_coat": one.any_coat.mean,
            "any_coat_sd": one.any_coat.sd,
            "steps": one.steps,
            "deviation": one.deviation,
            "rotated": rotated[one.row].deviation if one.row in rotated else None,
        }
        for one in found.best.predictions
    ]
    sources = [f"{n}: {row.source}" for n, row in problem.rows.items() if row.source]
    figure = Figure(
        "rows",
        "",
        "Measured minus predicted with any coat, over the standard deviation of the difference "
        "(measurement, unknown fields, nuisances, discrepancy, coat, emulator). Filled: fitted, "
        "open: held out. The band is two standard deviations.",
        "Normalised difference of every row",
        partial(draw_rows, found),
    )
    return [Table("rows", "", "", columns, tuple(rows), tuple(sources)), figure, *_limits(found)]


def _limits(found: Identified) -> list[Block]:
    limits = found.problem.limits
    if not limits:
        return []
    columns = (
        Column("limit", "limit"),
        Column("known", "known of it"),
        Column("sd", "± (1 sd)", 3),
        Column("twin", "twin", 3),
        Column("twin_sd", "± (1 sd) ", 3),
        Column("before", "met, by the priors alone", 0, "%"),
        Column("after", "met, given rows and limits", 0, "%"),
    )
    rows: list[Row] = [
        {
            "limit": one.limit,
            "known": limits[one.limit].words,
            "sd": limits[one.limit].sd,
            "twin": one.twin.mean,
            "twin_sd": one.twin.sd,
            "before": 100.0 * one.before,
            "after": 100.0 * one.probability,
        }
        for one in found.limits()
    ]
    sources = tuple(f"{name}: {one.source}" for name, one in limits.items() if one.source)
    words = "Figures of which only one side is known; they are fitted as the rows are."
    return [words, Table("limits", "", "", columns, tuple(rows), sources)]


def _models(found: Identified) -> list[Block]:
    if len(found.models) == 1:
        return []
    names = list(found.problem.alternatives)
    columns = (
        *(Column(name, name.replace("_", " ")) for name in names),
        Column("prior", "prior probability"),
        Column("probability", "probability given the rows"),
        Column("evidence", "log evidence", 2),
        Column("evidence_sd", "its standard error", 2),
    )
    rows: list[Row] = [
        dict(one.combination)
        | {
            "prior": one.prior,
            "probability": one.probability,
            "evidence": one.posterior.log_evidence,
            "evidence_sd": one.posterior.log_evidence_sd,
        }
        for one in found.models
    ]
    return [Table("models", "", "", columns, tuple(rows))]


def _worth(found: Identified) -> list[Block]:
    ranked = found.worth()
    if not ranked:
        return []
    fields = list(found.problem.free)
    columns = (
        Column("row", "measurement"),
        Column("sd", "± (1 sd)", 4),
        Column("expected_sd", "twin ± (1 sd)", 4),
        *(Column(name, split_unit(name)[0].replace("_", " "), 2) for name in fields),
        Column("gain", "information", 2, "nats"),
    )
    rows: list[Row] = [
        {
            "row": one.row,
            "sd": found.problem.worth[one.row].sd,
            "expected_sd": one.expected_sd,
            **one.shrink,
            "gain": one.gain,
        }
        for one in ranked
    ]
    words = (
        "What would be left of today's variance of each field (1: nothing gained) if this were "
        "measured so well; the most telling first."
    )
    return [words, Table("worth", "", "", columns, tuple(rows))]


def _emulators(found: Identified) -> list[Block]:
    columns = (
        Column("row", "figure"),
        Column("rmse", "cross-validated error, RMS", 5),
        Column("sd", "the row's standard deviation", 5),
        Column("missing", "simulations without it", 1, "%"),
    )
    every = found.problem.figures
    rows: list[Row] = [
        {
            "row": name,
            "rmse": one.cross_validated_rmse,
            "sd": every[name].sd,
            "missing": 100.0 * one.missing,
        }
        for name, one in found.best.emulators.items()
    ]
    notes = ("The error of one noisy simulation that the emulator has not seen (leave one out).",)
    coarse = [
        n for n, one in found.best.emulators.items() if one.cross_validated_rmse > every[n].sd
    ]
    told = Note(
        f"Learned less well than measured: {', '.join(coarse)}. The intervals are honest about it, "
        "and would be narrower with more simulations (design.count) or narrower priors."
    )
    table = Table("emulators", "", "", columns, tuple(rows), notes)
    return [table, *([told] if coarse else []), _sampling(found)]


def _sampling(found: Identified) -> Note:
    """Say how far the chains can be trusted: those of the choices that were sampled worst."""
    worst = min((one.posterior for one in found.models), key=lambda one: one.independent)
    told = (
        f"The chains ran {worst.steps} steps, autocorrelation time {worst.correlation_time:.0f} "
        f"steps: about {worst.independent:.0f} independent samples."
    )
    if all(one.posterior.is_converged for one in found.models):
        return Note(told)
    return Note(f"{told} That is too short: take the intervals as rough.", kind="failure")
