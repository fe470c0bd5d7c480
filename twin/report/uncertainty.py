"""Report of uncertainty: distributions over the trials, intervals, convergence, ranked budgets."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from reconstruction.errors import counted
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.propagation.budget import shares
from twin.propagation.distribution import Interval
from twin.propagation.results import Measurand, Uncertainty, read_uncertainty
from twin.report.canvas import (
    FAINT,
    FIT,
    MEASURED,
    MEASURED_FILL,
    NOMINAL,
    axes_at,
    chart,
    drawing,
    legend_above,
    plain_spines,
)
from twin.report.page import REPORT_FILE, STAGE, Block, Figure, Note, Page, Section, write_page
from twin.report.study import remark_lines
from twin.report.study_figures import draw_effect_bars
from twin.report.table import Column, Row, Table
from twin.report.words import NONE, label_of, split_unit
from twin.study.trials import standard_uncertainty

_MOST_BARS = 12
_HEADINGS = {
    "name": "figure",
    "n": "trials",
    "nominal": "nominal",
    "mean": "mean",
    "u": "standard uncertainty",
    "symmetric": "symmetric interval",
    "shortest": "shortest interval",
    "digits": "digits supported",
}
_HOW_TO_READ = (
    "Values are for a single measurement, not for a mean of several; units are the suffixes of the "
    "names. Nominal: without any deviation, with the true rig. Intervals: {coverage:.0%}, JCGM "
    "101, 7.7. Digits: number of digits of the standard uncertainty that the number of trials "
    "supports (JCGM 101, 7.9); mean and interval are valid to the same decimal place."
)


def write_uncertainty_page(
    folder: Path,
    watch: ProgressCallback = no_progress,
    into: Path | None = None,
    measurands: Sequence[str] = (),
) -> Path:
    """Write `report.html` and `figures/*.png` into the store of trials; return the page's path.

    Parameters
    ----------
    folder : the -o DIR of `twin uncertainty`, or of a sweep of trials; no other file is read
    into : existing folder for the page and its figures; None: `folder`
    measurands : names of the measured values on the page; empty: those of the study, or the main
        ones

    Raises
    ------
    InputError : the folder contains no trials, too few are finished, or the page cannot be written
    """
    watch(STAGE, 0.0)
    page = _page(read_uncertainty(folder, measurands))
    return write_page((into or folder) / REPORT_FILE, page, watch)


def _page(uncertainty: Uncertainty) -> Page:
    study, name = uncertainty.table.record.study, uncertainty.experiment.name.replace("_", " ")
    about = f": {study.description}" if study.description else ""
    drawn = study.sampling.calibration == "drawn"
    rig = "a new calibration in each" if drawn else "all with the true rig"
    shown = uncertainty.measurands.values()
    return Page(
        kind="uncertainty",
        title=name,
        lead=f"{counted(uncertainty.trials, 'trial')}{about}; {rig}.",
        sections=[_results(uncertainty), *map(_section, shown), _inputs(uncertainty)],
        warned="Trials that failed, and warnings"
        if uncertainty.failures or uncertainty.table.remarks
        else "",
        warnings=[*_failed(uncertainty), *remark_lines(uncertainty.table)],
        wide=True,
    )


def _failed(uncertainty: Uncertainty) -> list[str]:
    return [f"{counted(n, 'trial')} failed: {reason}" for reason, n in uncertainty.failures.items()]


def _results(uncertainty: Uncertainty) -> Section:
    columns = tuple(
        Column(key, heading, kind="" if key == "name" else "number")
        for key, heading in _HEADINGS.items()
    )
    rows = tuple(_result_row(measurand) for measurand in uncertainty.measurands.values())
    coverage = next(iter(uncertainty.measurands.values())).distribution.coverage
    note = _HOW_TO_READ.format(coverage=coverage)
    return Section("results", "Results", (Table("results", "", "", columns, rows, (note,)),))


def _section(measurand: Measurand) -> Section:
    label, unit = label_of(measurand.name)
    blocks: list[Block] = [*_figures(measurand), *map(Note, _remarks(measurand))]
    if measurand.parts:
        blocks.append(_budget_table(measurand))
    if measurand.correlations:
        blocks.append(_correlation_table(measurand))
    title = f"{label[:1].upper()}{label[1:]}, {unit}" if unit else label
    return Section(measurand.name, title, tuple(blocks))


def _budget_table(measurand: Measurand) -> Table:
    rows: tuple[Row, ...] = tuple(
        {
            "name": part.name.replace("_", " "),
            "group": part.group,
            "key": part.key,
            "u": f"{part.u:.3g}",
            "share": 100.0 * share,
        }
        for part, share in zip(measurand.parts, shares(measurand.parts), strict=True)
    )
    columns = (
        Column("name", "source"),
        Column("group", "of", kind="text"),
        Column("key", "varied", kind="code"),
        Column("u", "standard uncertainty", unit=split_unit(measurand.name)[1], kind="number"),
        Column("share", "share of variance", 1, "%"),
    )
    return Table(f"budget_of_{measurand.name}", "Ranked budget", "", columns, rows)


def _correlation_table(measurand: Measurand) -> Table:
    rows: tuple[Row, ...] = tuple(
        {
            "name": correlation.name.replace("_", " "),
            "linear": correlation.linear,
            "rank": correlation.rank,
        }
        for correlation in measurand.correlations
    )
    columns = (
        Column("name", "input"),
        Column("linear", "correlation", 2),
        Column("rank", "of ranks", 2),
    )
    return Table(
        f"correlations_of_{measurand.name}", "Correlation over the trials", "", columns, rows
    )


def _inputs(uncertainty: Uncertainty) -> Section:
    rows = []
    for name, varied in uncertainty.inputs().items():
        nominal = varied.nominal_in(uncertainty.experiment)
        rows.append(
            {
                "name": name.replace("_", " "),
                "key": varied.key,
                "distribution": varied.distribution.replace("_", " "),
                "nominal": f"{nominal:.5g}",
                "u": f"{standard_uncertainty(varied, nominal):.3g}",
                "source": varied.source,
            }
        )
    columns = (
        Column("name", "input"),
        Column("key", "key", kind="code"),
        Column("distribution", "distribution", kind="text"),
        Column("nominal", "nominal", kind="number"),
        Column("u", "standard uncertainty", kind="number"),
        Column("source", "source", kind="text"),
    )
    note = (
        "The camera noise also differs in each trial. Inputs and figures of all trials: trials.nc."
    )
    table = Table("inputs", "", "", columns, tuple(rows), (note,))
    return Section("inputs", "Inputs varied between trials", (table,))


def _remarks(measurand: Measurand) -> list[str]:
    """Return notes on convergence and completeness of the trials, and on missing contributions."""
    distribution, remarks = measurand.distribution, []
    stability = distribution.stability
    if stability is None:
        remarks.append("The trials do not differ in this figure.")
    elif stability.digits:
        digits = "one digit" if stability.digits == 1 else f"{stability.digits} digits"
        remarks.append(
            f"The number of trials supports {digits} of the standard uncertainty (JCGM 101, 7.9)."
        )
    else:
        remarks.append(
            f"The number of trials supports no digit of the standard uncertainty yet (JCGM 101, "
            f"7.9): two standard errors of the {stability.weakest} is "
            f"{max(stability.errors):.2g}, allowed {stability.tolerance:.2g}. About "
            f"{stability.trials_for_one_digit} trials would support one digit."
        )
    if distribution.symmetric is None:
        remarks.append(f"Too few trials for a coverage interval of {distribution.coverage:.0%}.")
    if measurand.from_budget is not None:
        remarks.append(
            f"The parts of the budget combine to {measurand.from_budget:.3g}, the trials give "
            f"{distribution.standard_uncertainty:.3g}; where these differ by more than the trials' "
            "own scatter, inputs interact or their effect is strongly nonlinear."
        )
    if measurand.undetermined:
        remarks.append(f"Not determined, a step has no value: {', '.join(measurand.undetermined)}.")
    if measurand.missing:
        have = counted(measurand.missing, "trial has", "trials have")
        remarks.append(f"{have} no value; left out.")
    return remarks


def _result_row(measurand: Measurand) -> dict[str, str]:
    distribution = measurand.distribution
    return {
        "name": measurand.name,
        "n": str(distribution.values.size),
        "nominal": _number(measurand.nominal),
        "mean": _number(distribution.mean),
        "u": f"{distribution.standard_uncertainty:.3g}",
        "symmetric": _interval(distribution.symmetric),
        "shortest": _interval(distribution.shortest),
        "digits": NONE if distribution.stability is None else str(distribution.stability.digits),
    }


def _number(value: float | None) -> str:
    return NONE if value is None else f"{value:.5g}"


def _interval(interval: Interval | None) -> str:
    return NONE if interval is None else f"{interval.low:.5g} to {interval.high:.5g}"


def _figures(measurand: Measurand) -> list[Figure]:
    percent = f"{measurand.distribution.coverage:.0%}"
    figures = [
        Figure(
            f"distribution_{measurand.name}",
            "",
            f"Left: histogram of the trials with their mean, the probabilistically symmetric "
            f"{percent} interval (shaded) and the shortest {percent} interval (bar at the bottom). "
            "Right: mean (line) and mean ± standard uncertainty (band) over the number of trials; "
            "both should be constant at the end.",
            f"histogram of {measurand.name} over the trials and its convergence",
            partial(draw_distribution, measurand=measurand),
        )
    ]
    if measurand.parts:
        figures.append(
            Figure(
                f"budget_{measurand.name}",
                "",
                "Standard uncertainty due to each source, the largest first. Lines: all sources "
                "combined, and the standard deviation of the trials." + _sobol_words(measurand),
                f"ranked uncertainty budget of {measurand.name}",
                partial(draw_budget, measurand=measurand),
            )
        )
    return figures


def _sobol_words(measurand: Measurand) -> str:
    if not measurand.effects:
        return ""
    return (
        " Right: Sobol' indices of the pressed face only; bars: first order with 95 % bootstrap "
        "intervals, diamonds: total, with interactions."
    )


def draw_distribution(path: Path, measurand: Measurand) -> None:
    """Draw the histogram of the trials with coverage intervals, and the convergence, as PNG.

    Convergence is the mean and the standard uncertainty over the number of trials.
    """
    with drawing(path, 8.6, 3.1) as figure:
        _draw_histogram(axes_at(figure, 0.6, 0.35, 3.6, 2.2), measurand)
        _draw_convergence(axes_at(figure, 5.0, 0.35, 3.4, 2.2), measurand)


def _draw_histogram(axes: Axes, measurand: Measurand) -> None:
    distribution = measurand.distribution
    axes.hist(
        distribution.values, bins="auto" if np.ptp(distribution.values) else 1, color=MEASURED_FILL
    )
    axes.axvline(distribution.mean, color=MEASURED, label="mean")
    if measurand.nominal is not None:
        axes.axvline(measurand.nominal, color=NOMINAL, ls="--", label="nominal")
    if distribution.symmetric is not None:
        axes.axvspan(
            distribution.symmetric.low,
            distribution.symmetric.high,
            color=MEASURED_FILL,
            alpha=0.3,
            lw=0,
        )
    if distribution.shortest is not None:
        ends = [distribution.shortest.low, distribution.shortest.high]
        axes.plot(ends, [0.02, 0.02], color=FIT, lw=3, transform=axes.get_xaxis_transform())
    chart(axes, "", _axis_label(measurand.name), "trials")
    legend_above(axes, 2)


def _draw_convergence(axes: Axes, measurand: Measurand) -> None:
    values = measurand.distribution.values
    count = np.arange(2, values.size + 1)
    mean = np.cumsum(values)[1:] / count
    # Relative to the first value, because the sum of squares loses digits if the mean is large.
    offset = values - values[0]
    variance = (np.cumsum(offset**2)[1:] - count * (mean - values[0]) ** 2) / (count - 1)
    spread = np.sqrt(np.maximum(variance, 0.0))
    axes.fill_between(count, mean - spread, mean + spread, color=MEASURED_FILL, alpha=0.5, lw=0)
    axes.plot(count, mean, color=MEASURED)
    chart(axes, "", "trials so far", _axis_label(measurand.name))
    axes.ticklabel_format(axis="y", useOffset=False)


def draw_budget(path: Path, measurand: Measurand) -> None:
    """Draw the contributions of all sources as PNG, the largest first, and any Sobol' indices.

    A contribution is a standard uncertainty.
    """
    parts = measurand.parts[:_MOST_BARS]
    height = 0.26 * len(parts)
    with drawing(path, 8.6, height + 1.1) as figure:
        axes = axes_at(figure, 2.0, 0.4, 3.2 if measurand.effects else 6.2, height)
        at = np.arange(len(parts))[::-1]
        axes.barh(at, [part.u for part in parts], color=MEASURED_FILL, height=0.7)
        axes.set_yticks(at, [part.name.replace("_", " ") for part in parts])
        axes.axvline(measurand.from_budget or 0.0, color=FAINT, ls="--", label="combined")
        u = measurand.distribution.standard_uncertainty
        axes.axvline(u, color=FIT, label="of the trials")
        axes.set(xlabel=f"standard uncertainty, {split_unit(measurand.name)[1]}", xlim=(0, None))
        legend_above(axes, 2)
        plain_spines(axes)
        if measurand.effects:
            _draw_effects(axes_at(figure, 6.4, 0.4, 2.0, height), measurand)


def _draw_effects(axes: Axes, measurand: Measurand) -> None:
    ordered = sorted(measurand.effects, key=lambda effect: -(effect.total or 0.0))
    draw_effect_bars(axes, [replace(e, axis=e.axis.replace("_", " ")) for e in ordered])
    axes.set(xlabel="Sobol' index", xlim=(min(0.0, *(e.value for e in ordered)), 1.05))


def _axis_label(name: str) -> str:
    label, unit = label_of(name)
    return f"{label}, {unit}" if unit else label


def result_lines(uncertainty: Uncertainty) -> list[Mapping[str, str]]:
    """Return mean, standard uncertainty, intervals and main source of every measurand, as text."""
    rows: list[Mapping[str, str]] = []
    for measurand in uncertainty.measurands.values():
        first = measurand.parts[0].name.replace("_", " ") if measurand.parts else NONE
        rows.append(_result_row(measurand) | {"first": first})
    return rows
