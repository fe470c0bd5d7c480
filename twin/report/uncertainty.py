"""The report of an uncertainty: distributions with their intervals, convergence, ranked budgets."""

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
    "Of one measurement, not of a mean of several; units are those at the ends of the names. "
    "Nominal: without any deviation, with the true rig. Intervals: {coverage:.0%}, JCGM 101, 7.7. "
    "Digits: how many of the standard uncertainty, and as far of the mean and the interval's ends, "
    "the number of trials supports (JCGM 101, 7.9)."
)


def write_uncertainty_page(
    folder: Path,
    watch: ProgressCallback = no_progress,
    into: Path | None = None,
    measurands: Sequence[str] = (),
) -> Path:
    """Write `report.html` and `figures/*.png` into the store of trials.

    Parameters
    ----------
    folder : the -o DIR of `twin uncertainty`, or of a sweep of trials; nothing else is read
    into : existing folder to write into instead
    measurands : names; by default those of the study, or the main ones

    Raises
    ------
    InputError : the folder holds no trials, too few are finished, or the page cannot be written
    """
    watch(STAGE, 0.0)
    page = _page(read_uncertainty(folder, measurands))
    return write_page((into or folder) / REPORT_FILE, page, watch)


def _page(found: Uncertainty) -> Page:
    study, name = found.table.record.study, found.experiment.name.replace("_", " ")
    about = f": {study.description}" if study.description else ""
    drawn = study.sampling.calibration == "drawn"
    rig = "a new calibration in each" if drawn else "all with the true rig"
    shown = found.measurands.values()
    return Page(
        kind="uncertainty",
        title=name,
        lead=f"{counted(found.trials, 'trial')}{about}; {rig}.",
        sections=[_results(found), *map(_section, shown), _inputs(found)],
        warned="Trials that failed, and warnings" if found.failures or found.table.remarks else "",
        warnings=[*_failed(found), *remark_lines(found.table)],
        wide=True,
    )


def _failed(found: Uncertainty) -> list[str]:
    return [f"{counted(n, 'trial')} failed: {reason}" for reason, n in found.failures.items()]


def _results(found: Uncertainty) -> Section:
    columns = tuple(
        Column(key, heading, kind="" if key == "name" else "number")
        for key, heading in _HEADINGS.items()
    )
    rows = tuple(_result_row(one) for one in found.measurands.values())
    coverage = next(iter(found.measurands.values())).distribution.coverage
    note = _HOW_TO_READ.format(coverage=coverage)
    return Section("results", "Results", (Table("results", "", "", columns, rows, (note,)),))


def _section(one: Measurand) -> Section:
    label, unit = label_of(one.name)
    blocks: list[Block] = [*_figures(one), *map(Note, _told(one))]
    if one.parts:
        blocks.append(_budget_table(one))
    if one.correlations:
        blocks.append(_correlation_table(one))
    title = f"{label[:1].upper()}{label[1:]}, {unit}" if unit else label
    return Section(one.name, title, tuple(blocks))


def _budget_table(one: Measurand) -> Table:
    rows: tuple[Row, ...] = tuple(
        {
            "name": part.name.replace("_", " "),
            "group": part.group,
            "key": part.key,
            "u": f"{part.u:.3g}",
            "share": 100.0 * share,
        }
        for part, share in zip(one.parts, shares(one.parts), strict=True)
    )
    columns = (
        Column("name", "source"),
        Column("group", "of", kind="text"),
        Column("key", "varied", kind="code"),
        Column("u", "standard uncertainty", unit=split_unit(one.name)[1], kind="number"),
        Column("share", "share of variance", 1, "%"),
    )
    return Table(f"budget_of_{one.name}", "Ranked budget", "", columns, rows)


def _correlation_table(one: Measurand) -> Table:
    rows: tuple[Row, ...] = tuple(
        {"name": found.name.replace("_", " "), "linear": found.linear, "rank": found.rank}
        for found in one.correlations
    )
    columns = (
        Column("name", "input"),
        Column("linear", "correlation", 2),
        Column("rank", "of ranks", 2),
    )
    return Table(f"correlations_of_{one.name}", "Correlation over the trials", "", columns, rows)


def _inputs(found: Uncertainty) -> Section:
    rows = []
    for name, one in found.inputs().items():
        nominal = one.nominal_in(found.experiment)
        rows.append(
            {
                "name": name.replace("_", " "),
                "key": one.key,
                "distribution": one.distribution.replace("_", " "),
                "nominal": f"{nominal:.5g}",
                "u": f"{standard_uncertainty(one, nominal):.3g}",
                "source": one.source,
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
    note = "And the camera's noise. Trials with their inputs and all figures: trials.nc."
    table = Table("inputs", "", "", columns, tuple(rows), (note,))
    return Section("inputs", "What differs from trial to trial", (table,))


def _told(one: Measurand) -> list[str]:
    """Say in sentences how far the numbers can be trusted."""
    found, told = one.distribution, []
    stability = found.stability
    if stability is None:
        told.append("The trials do not differ in this figure.")
    elif stability.digits:
        digits = "one digit" if stability.digits == 1 else f"{stability.digits} digits"
        told.append(
            f"The number of trials supports {digits} of the standard uncertainty (JCGM 101, 7.9)."
        )
    else:
        told.append(
            f"The number of trials supports no digit of the standard uncertainty yet (JCGM 101, "
            f"7.9): twice the standard error of the {stability.weakest} is "
            f"{max(stability.errors):.2g}, allowed {stability.tolerance:.2g}. About "
            f"{stability.trials_for_one_digit} trials would support one digit."
        )
    if found.symmetric is None:
        told.append(f"Too few trials for a coverage interval of {found.coverage:.0%}.")
    if one.from_budget is not None:
        told.append(
            f"The parts of the budget combine to {one.from_budget:.3g}, the trials give "
            f"{found.standard_uncertainty:.3g}; where these differ by more than the trials' own "
            "scatter, inputs interact or act far from linearly."
        )
    if one.undetermined:
        told.append(f"Not determined, a step has no value: {', '.join(one.undetermined)}.")
    if one.missing:
        have = counted(one.missing, "trial has", "trials have")
        told.append(f"{have} no value; left out.")
    return told


def _result_row(one: Measurand) -> dict[str, str]:
    found = one.distribution
    return {
        "name": one.name,
        "n": str(found.values.size),
        "nominal": _number(one.nominal),
        "mean": _number(found.mean),
        "u": f"{found.standard_uncertainty:.3g}",
        "symmetric": _interval(found.symmetric),
        "shortest": _interval(found.shortest),
        "digits": NONE if found.stability is None else str(found.stability.digits),
    }


def _number(value: float | None) -> str:
    return NONE if value is None else f"{value:.5g}"


def _interval(found: Interval | None) -> str:
    return NONE if found is None else f"{found.low:.5g} to {found.high:.5g}"


def _figures(one: Measurand) -> list[Figure]:
    percent = f"{one.distribution.coverage:.0%}"
    found = [
        Figure(
            f"distribution_{one.name}",
            "",
            f"Left: the trials, with their mean and, shaded, the probabilistically symmetric "
            f"{percent} interval; below it the shortest one. Right: mean (line) and mean "
            "± standard uncertainty (band) after so many trials; they should have become level.",
            f"histogram of {one.name} over the trials and its convergence",
            partial(draw_distribution, one=one),
        )
    ]
    if one.parts:
        found.append(
            Figure(
                f"budget_{one.name}",
                "",
                "Standard uncertainty that each source alone adds, the largest first; lines: all "
                "of them combined, and the standard deviation of the trials." + _sobol_words(one),
                f"ranked uncertainty budget of {one.name}",
                partial(draw_budget, one=one),
            )
        )
    return found


def _sobol_words(one: Measurand) -> str:
    if not one.effects:
        return ""
    return (
        " Right: Sobol' indices of the pressed face alone; bars: first order with 95 % bootstrap "
        "intervals, diamonds: total, with interactions."
    )


def draw_distribution(path: Path, one: Measurand) -> None:
    """Draw the histogram with the coverage intervals, and how mean and spread settle."""
    with drawing(path, 8.6, 3.1) as figure:
        _draw_histogram(axes_at(figure, 0.6, 0.35, 3.6, 2.2), one)
        _draw_convergence(axes_at(figure, 5.0, 0.35, 3.4, 2.2), one)


def _draw_histogram(axes: Axes, one: Measurand) -> None:
    found = one.distribution
    axes.hist(found.values, bins="auto" if np.ptp(found.values) else 1, color=MEASURED_FILL)
    axes.axvline(found.mean, color=MEASURED, label="mean")
    if one.nominal is not None:
        axes.axvline(one.nominal, color=NOMINAL, ls="--", label="nominal")
    if found.symmetric is not None:
        axes.axvspan(
            found.symmetric.low, found.symmetric.high, color=MEASURED_FILL, alpha=0.3, lw=0
        )
    if found.shortest is not None:
        ends = [found.shortest.low, found.shortest.high]
        axes.plot(ends, [0.02, 0.02], color=FIT, lw=3, transform=axes.get_xaxis_transform())
    chart(axes, "", _axis_label(one.name), "trials")
    legend_above(axes, 2)


def _draw_convergence(axes: Axes, one: Measurand) -> None:
    values = one.distribution.values
    count = np.arange(2, values.size + 1)
    mean = np.cumsum(values)[1:] / count
    # About the first value: the sum of squares loses its digits where the mean is large.
    apart = values - values[0]
    variance = (np.cumsum(apart**2)[1:] - count * (mean - values[0]) ** 2) / (count - 1)
    spread = np.sqrt(np.maximum(variance, 0.0))
    axes.fill_between(count, mean - spread, mean + spread, color=MEASURED_FILL, alpha=0.5, lw=0)
    axes.plot(count, mean, color=MEASURED)
    chart(axes, "", "trials so far", _axis_label(one.name))
    axes.ticklabel_format(axis="y", useOffset=False)


def draw_budget(path: Path, one: Measurand) -> None:
    """Draw what each source adds, the largest first; beside it Sobol' indices if there are any."""
    parts = one.parts[:_MOST_BARS]
    height = 0.26 * len(parts)
    with drawing(path, 8.6, height + 1.1) as figure:
        axes = axes_at(figure, 2.0, 0.4, 3.2 if one.effects else 6.2, height)
        at = np.arange(len(parts))[::-1]
        axes.barh(at, [part.u for part in parts], color=MEASURED_FILL, height=0.7)
        axes.set_yticks(at, [part.name.replace("_", " ") for part in parts])
        axes.axvline(one.from_budget or 0.0, color=FAINT, ls="--", label="combined")
        u = one.distribution.standard_uncertainty
        axes.axvline(u, color=FIT, label="of the trials")
        axes.set(xlabel=f"standard uncertainty, {split_unit(one.name)[1]}", xlim=(0, None))
        legend_above(axes, 2)
        plain_spines(axes)
        if one.effects:
            _draw_effects(axes_at(figure, 6.4, 0.4, 2.0, height), one)


def _draw_effects(axes: Axes, one: Measurand) -> None:
    ordered = sorted(one.effects, key=lambda effect: -(effect.total or 0.0))
    draw_effect_bars(axes, [replace(e, axis=e.axis.replace("_", " ")) for e in ordered])
    axes.set(xlabel="Sobol' index", xlim=(min(0.0, *(e.value for e in ordered)), 1.05))


def _axis_label(name: str) -> str:
    label, unit = label_of(name)
    return f"{label}, {unit}" if unit else label


def result_lines(found: Uncertainty) -> list[Mapping[str, str]]:
    """Return mean, standard uncertainty, interval and main source of every measurand, as text."""
    rows: list[Mapping[str, str]] = []
    for one in found.measurands.values():
        first = one.parts[0].name.replace("_", " ") if one.parts else NONE
        rows.append(_result_row(one) | {"first": first})
    return rows
