"""The tables of measured figures in README and docs, made from the baselines."""

import math
from collections.abc import Iterable, Iterator

from benchmarks.regression.baselines import Baselines
from benchmarks.regression.figures import BenchmarkCase, MeanOfRuns
from reconstruction.errors import InputError

BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"
HEAD = ("figure", "target", "measured +- u", "case")


def table(cases: Iterable[BenchmarkCase], baselines: Baselines, headlines: bool = False) -> str:
    """Return the table in Markdown: measured rows first, then the stated rows.

    Parameters
    ----------
    headlines : the rows of the README, each with its case; else every row, a case named once
    """
    rows = list(_rows(cases, baselines, headlines))
    if headlines:
        lines = (f"| {' | '.join(row)} |" for row in (HEAD, *rows))
    else:
        cases_above = [HEAD[-1], *(row[-1] for row in rows)]
        named_once = [
            (*row[:-1], row[-1] * (row[-1] != above))
            for row, above in zip(rows, cases_above, strict=False)
        ]
        lines = (f"|{'|'.join(row)}|" for row in (HEAD, *named_once))
    head, *rest = lines
    return "\n".join((*_above(baselines), "", head, "|---|---|---|---|", *rest))


def _rows(
    cases: Iterable[BenchmarkCase], baselines: Baselines, headlines: bool
) -> Iterator[tuple[str, ...]]:
    for case in cases:
        for figure in case.figures:
            known = baselines.figures.get(figure.name)
            if known and (figure.headline or not headlines):
                origin = f"`{case.name}`, {case.conditions}"
                yield figure.label, str(figure.target or ""), shown(known.estimate), origin
    for row in baselines.stated:
        if row.headline or not headlines:
            yield row.label, row.target, row.measured, f"{row.command}, {row.date}"


def with_table(page: str, made: str) -> str:
    """Return a page with the table between its two markers.

    Raises
    ------
    InputError
        Not exactly one pair of markers.
    """
    if page.count(BEGIN) != 1 or page.count(END) != 1 or page.find(END) < page.find(BEGIN):
        raise InputError(
            f"README.md, docs/benchmarks.md or docs/peers.md: found no single pair of {BEGIN} and "
            f"{END}; put them back"
        )
    before, _, rest = page.partition(BEGIN)
    return f"{before}{BEGIN}\n{made}\n{END}{rest.partition(END)[2]}"


def shown(estimate: MeanOfRuns) -> str:
    """Return value and standard uncertainty, to two digits of the latter, or three digits."""
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
    dates = sorted({known.date for known in baselines.figures.values()})
    span = " to ".join(dict.fromkeys([*dates[:1], *dates[-1:]]))
    versions = "; ".join(sorted({known.versions for known in baselines.figures.values()}))
    machines = "; ".join(sorted({known.machine for known in baselines.figures.values()}))
    return (
        f"On {machines}; {versions}; {span}.",
        "A case is measured again by `./run bench all --only CASE`; u is the standard uncertainty",
        "of the mean over the seeds. `./run bench all --check` compares",
        "new values with those below and with the targets.",
    )
