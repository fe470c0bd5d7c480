"""`twin identify`: find what is not known of a sensor from what was measured with it."""

from pathlib import Path

from twin.cli.app import Cluster, Out, WorkerCount, app, print_table, progress_bars, say, workers_of


@app.command
def identify(
    problem: Path,
    /,
    *,
    out: Out,
    quick: bool = False,
    workers: WorkerCount = None,
    cluster: Cluster = None,
) -> None:
    """Find the values of unknown fields that agree with measurements, and what stays open.

    The problem names experiments, free fields with priors, discrete choices and measured rows. The
    twin simulates the experiments over the space of the fields, learns its own figures from that,
    and samples what the rows leave of the priors. Run it again to go on after an interruption.

    Parameters
    ----------
    problem
        TOML file, or the name of a shipped problem such as problems/slab.
    quick
        A quarter of the simulations, repeated half as often, none refined: wider intervals,
        for a first look.
    """
    from twin.config.problem import load_problem
    from twin.identification.record import COMMAND, WRITTEN, write_identified
    from twin.identification.run import identify as find
    from twin.identification.summary import SUMMARY_FILE, write_summary
    from twin.output import adding, alone_in, claim
    from twin.report import REPORT_NAMES
    from twin.report.identified import write_identified as draw

    loaded, experiments = load_problem(problem)
    asked = loaded.quick() if quick else loaded
    who = workers_of(workers, cluster)
    names = (*WRITTEN, SUMMARY_FILE, *REPORT_NAMES)
    claim(out, COMMAND, names, [problem])
    with alone_in(out), progress_bars() as watch:
        found = find(asked, experiments, out, who, watch=watch, inputs=[problem])
        with adding(out, *names) as folder:
            write_identified(folder, found, experiments)
            write_summary(folder, found)
            draw(folder, found, watch)
    rows = [
        [name, f"{one.mean:.4g}", f"{one.sd:.2g}", f"{one.low_95:.4g} to {one.high_95:.4g}"]
        for name, one in found.intervals().items()
    ]
    print_table(("field", "mean", "standard deviation", "95 % interval"), rows)
    say(f"wrote {out / 'report.html'}")
