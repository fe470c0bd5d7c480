"""`twin paper`: every table and figure of the paper, from one parameter set."""

from typing import Annotated

from cyclopts import Parameter

from reconstruction.errors import InputError
from twin.cli.app import Out, app
from twin.cli.console import progress_bars, say

QUICK_TRIALS, FULL_TRIALS = 5, 100


@app.command
def paper(
    *,
    out: Out,
    only: list[str] | None = None,
    trials: int | None = None,
    quick: bool = False,
    full: bool = False,
    workers: Annotated[int | None, Parameter(name=["--workers", "-j"])] = None,
) -> None:
    """Reproduce the paper's tables and figures, its numbers beside ours.

    What OUT/work holds already is not measured again: an interrupted run goes on where it stopped.

    Parameters
    ----------
    only
        Name of a group of tables or of a figure; give it several times for several.
    trials
        Repetitions of every repeated measurement: 100, with --quick the paper's 5.
    quick
        Five trials as in the paper; the same parameters.
    full
        Use all 1936 x 1464 camera pixels instead of 2 x 2 binning.
    workers
        Processes that measure side by side; default: one per two cores, at least two of two.
    """
    from twin.paper.run import Request, reproduce
    from twin.study.workers import default_count

    if trials is not None and not 2 <= trials <= 10000:
        raise InputError(f"--trials {trials}: allowed 2 to 10000")
    if workers is not None and workers < 1:
        raise InputError(f"--workers {workers}: allowed 1 or more")
    count = trials or (QUICK_TRIALS if quick else FULL_TRIALS)
    with progress_bars() as watch:
        request = Request(count, tuple(only or ()), full)
        done = reproduce(out, request, watch, default_count() if workers is None else workers)
    for line in done.lines:
        say(line)
    say(f"wrote {done.page}")
