"""The README's table of measured figures, made from the baselines."""

import math
from collections.abc import Iterable

from benchmarks.regression.baselines import Baselines
from benchmarks.regression.cases import Case
from benchmarks.regression.figures import Estimate
from reconstruction.errors import InputError

BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"
HEAD = ("| what | target | measured +- u | how |", "|---|---|---|---|")


def table(cases: Iterable[Case], baselines: Baselines) -> str:
    """Return the table in Markdown: measured rows first, then the stated ones."""
    rows = [
        _row(
            figure.what,
            str(figure.target or ""),
            shown(baselines.figures[figure.name].estimate),
            _how(case),
        )
        for case in cases
        for figure in case.figures
        if figure.name in baselines.figures
    ]
    rows += [
        _row(row.what, row.target, row.measured, f"{row.how}, {row.date}")
        for row in baselines.stated
    ]
    return "\n".join((*_above(baselines), "", *HEAD, *rows))


def with_table(readme: str, made: str) -> str:
    """Return the README with the table between its two markers.

    Raises
    ------
    InputError
        Not exactly one pair of markers.
    """
    if readme.count(BEGIN) != 1 or readme.count(END) != 1 or readme.find(END) < readme.find(BEGIN):
        raise InputError(f"README.md: found no single pair of {BEGIN} and {END}; put them back")
    before, _, rest = readme.partition(BEGIN)
    return f"{before}{BEGIN}\n{made}\n{END}{rest.partition(END)[2]}"


def shown(estimate: Estimate) -> str:
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
        "`CASE` is run by `./run bench all --only CASE`; u is the standard uncertainty of the mean",
        "over seeds. `./run bench all --check` compares with these and the targets:",
        "`docs/benchmarks.md`.",
    )


def _how(case: Case) -> str:
    return f"`{case.name}`, {case.how}"


def _row(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"
