"""The tables of measured figures in README and docs/benchmarks.md, made from the baselines."""

import math
from collections.abc import Iterable

from benchmarks.regression.baselines import Baselines
from benchmarks.regression.cases import BenchmarkCase
from benchmarks.regression.figures import MeanOfRuns
from reconstruction.errors import InputError

BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"
HEAD = ("| figure | target | measured +- u | case |", "|---|---|---|---|")


def table(cases: Iterable[BenchmarkCase], baselines: Baselines, headlines: bool = False) -> str:
    """Return the table in Markdown: measured rows first, then the stated ones.

    Parameters
    ----------
    headlines : only the rows of the README
    """
    rows = [
        _row(
            figure.what,
            str(figure.target or ""),
            shown(baselines.figures[figure.name].estimate),
            _how(case),
        )
        for case in cases
        for figure in case.figures
        if figure.name in baselines.figures and (figure.headline or not headlines)
    ]
    rows += [
        _row(row.what, row.target, row.measured, f"{row.how}, {row.date}")
        for row in baselines.stated
        if row.headline or not headlines
    ]
    return "\n".join((*_above(baselines), "", *HEAD, *rows))


def with_table(page: str, made: str) -> str:
    """Return a page with the table between its two markers.

    Raises
    ------
    InputError
        Not exactly one pair of markers.
    """
    if page.count(BEGIN) != 1 or page.count(END) != 1 or page.find(END) < page.find(BEGIN):
        raise InputError(
            f"README.md or docs/benchmarks.md: found no single pair of {BEGIN} and {END}; put them "
            "back"
        )
    before, _, rest = page.partition(BEGIN)
    return f"{before}{BEGIN}\n{made}\n{END}{rest.partition(END)[2]}"


def shown(estimate: MeanOfRuns) -> str:
    """Return value and standard uncertainty, the latter to two digits; one alone to three."""
    value, u = estimate.value, estimate.standard_uncertainty
    if u <= 0.0:
        return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"
    scale = math.floor(math.log10(max(abs(value), u)))
    if scale > -3:
        return _to_two_digits(value, u)
    return f"({_to_two_digits(value / 10.0**scale, u / 10.0**scale)})e{scale}"


def _to_two_digits(value: float, u: float) -> str:
    decimals = max(1 - math.floor(math.log10(u)), 0)
    return f"{value:.{decimals}f} +- {u:.{decimals}f}"


def _above(baselines: Baselines) -> tuple[str, ...]:
    dates = sorted({one.date for one in baselines.figures.values()})
    span = " to ".join(dict.fromkeys([*dates[:1], *dates[-1:]]))
    versions = "; ".join(sorted({one.versions for one in baselines.figures.values()}))
    machines = "; ".join(sorted({one.machine for one in baselines.figures.values()}))
    return (
        f"On {machines}; {versions}; {span}.",
        "A case is measured again by `./run bench all --only CASE`; u is the standard uncertainty",
        "of the mean over the seeds. `./run bench all --check` compares with values and targets.",
    )


def _how(case: BenchmarkCase) -> str:
    return f"`{case.name}`, {case.how}"


def _row(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"
