"""The report of an uncertainty: distributions with their intervals, convergence, ranked budgets."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from twin.pipeline.progress import Watcher, nobody
from twin.report import appendix
from twin.report.canvas import (
    FAINT,
    FIT,
    MEASURED,
    MEASURED_FILL,
    NOMINAL,
    axes_at,
    drawing,
    legend_above,
    plain_spines,
)
from twin.report.fields import split_unit
from twin.report.html import Plate, draw_pictures, template, write_page
from twin.report.study import REPORT_FILE
from twin.study.draws import standard_uncertainty
from twin.uncertainty.budget import shares
from twin.uncertainty.distribution import Interval
from twin.uncertainty.results import Measurand, Uncertainty, read_uncertainty

_MOST_BARS = 12


def write_uncertainty_page(
    folder: Path,
    watch: Watcher = nobody,
    into: Path | None = None,
    measurands: Sequence[str] = (),
) -> Path:
    """Write `report.html` and `figures/*.png` into the store of trials.

    Parameters
    ----------
    folder : the -o DIR of `twin uncertainty`, or of a sweep of trials; nothing else is read
    into : existing folder to write into instead
    measurands : names; by default those of the study, or the main ones

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        The folder holds no trials, too few are finished, or the page cannot be written.
    """
    found = read_uncertainty(folder, measurands)
    path = (into or folder) / REPORT_FILE
    pictures = draw_pictures(path.parent, _plates(found), watch)
    record = found.table.record
    text = template("uncertainty.html").render(
        name=record.base.name,
        about=record.study.description,
        trials=found.trials,
        calibration=record.study.sampling.calibration,
        failures=found.failures,
        rows=[_result_row(one) for one in found.measurands.values()],
        parts=[_part(one) for one in found.measurands.values()],
        pictures=pictures,
        inputs=_inputs(found),
        settings=appendix.settings(found.experiment),
    )
    write_page(path, text)
    watch("report", 1.0)
    return path


@dataclass(frozen=True)
class _Part:
    """One measurand as the template takes it."""

    name: str
    title: str
    told: list[str]
    budget: list[tuple[str, str, str, str, str]]
    correlations: list[tuple[str, str, str]]


def _part(one: Measurand) -> _Part:
    label, unit = split_unit(one.name)
    budget = [
        (part.name.replace("_", " "), part.group, part.key, f"{part.u:.3g}", f"{100 * share:.1f}")
        for part, share in zip(one.parts, shares(one.parts), strict=True)
    ]
    correlations = [
        (c.name.replace("_", " "), f"{c.linear:+.2f}", f"{c.rank:+.2f}") for c in one.correlations
    ]
    return _Part(one.name, f"{label.replace('_', ' ')}, {unit}", _told(one), budget, correlations)


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
        told.append(f"{one.missing} trials have no value and are left out.")
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
        "digits": "–" if found.stability is None else str(found.stability.digits),
    }


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.5g}"


def _interval(found: Interval | None) -> str:
    return "–" if found is None else f"{found.low:.5g} to {found.high:.5g}"


def _inputs(found: Uncertainty) -> list[dict[str, Any]]:
    base, rows = found.experiment, []
    for name, one in found.inputs().items():
        nominal = one.nominal_in(base)
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
    return rows


def _plates(found: Uncertainty) -> list[Plate]:
    return [plate for one in found.measurands.values() for plate in _plates_of(one)]


def _plates_of(one: Measurand) -> list[Plate]:
    percent = f"{one.distribution.coverage:.0%}"
    plates = [
        Plate(
            f"distribution_{one.name}",
            partial(draw_distribution, one=one),
            f"histogram of {one.name} over the trials and its convergence",
            f"Left: the trials, with their mean and, shaded, the probabilistically symmetric "
            f"{percent} interval; below it the shortest one. Right: mean (line) and mean "
            "± standard uncertainty (band) after so many trials; they should have become level.",
        )
    ]
    if one.parts:
        plates.append(
            Plate(
                f"budget_{one.name}",
                partial(draw_budget, one=one),
                f"ranked uncertainty budget of {one.name}",
                "Standard uncertainty that each source alone adds, the largest first; lines: all "
                "of them combined, and the standard deviation of the trials." + _sobol_words(one),
            )
        )
    return plates


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
    axes.set(xlabel=_axis_label(one.name), ylabel="trials")
    legend_above(axes, 2)
    plain_spines(axes)


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
    axes.set(xlabel="trials so far", ylabel=_axis_label(one.name))
    axes.ticklabel_format(axis="y", useOffset=False)
    plain_spines(axes)


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
    effects = sorted(one.effects, key=lambda effect: -(effect.total or 0.0))
    at = np.arange(len(effects))[::-1]
    value = np.array([effect.value for effect in effects])
    reach = [
        [max(e.value - e.low, 0.0) for e in effects],
        [max(e.high - e.value, 0.0) for e in effects],
    ]
    axes.barh(at, value, xerr=reach, color=MEASURED_FILL, ecolor=FAINT, height=0.7)
    axes.plot([effect.total or 0.0 for effect in effects], at, "D", color=MEASURED, ms=4)
    axes.set_yticks(at, [effect.axis.replace("_", " ") for effect in effects])
    axes.set(xlabel="Sobol' index", xlim=(min(0.0, float(value.min())), 1.05))
    plain_spines(axes)


def _axis_label(name: str) -> str:
    label, unit = split_unit(name)
    text = label.replace("_", " ")
    return f"{text}, {unit}" if unit else text


def result_lines(found: Uncertainty) -> list[Mapping[str, str]]:
    """Return mean, standard uncertainty, interval and main source of every measurand, as text."""
    rows: list[Mapping[str, str]] = []
    for one in found.measurands.values():
        first = one.parts[0].name.replace("_", " ") if one.parts else "–"
        rows.append(_result_row(one) | {"first": first})
    return rows
