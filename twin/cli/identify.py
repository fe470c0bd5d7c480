"""`twin identify`: estimate unknown fields of a sensor from measurements with it."""

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
    """Estimate unknown fields from measurements, with intervals and undetermined combinations.

    The problem names experiments, free fields with priors, discrete choices and measured rows. The
    twin simulates the experiments over the space of the fields, fits emulators to the figures, and
    samples the posterior distribution. Run it again to continue after an interruption.

    Parameters
    ----------
    problem
        TOML file, or the name of a shipped problem such as problems/slab.
    quick
        Use only 25 % of the simulations, with 50 % of the repeats, without refinement: a preview
        with wider intervals.
    """
    from twin.config.problem import load_problem
    from twin.identification.record import COMMAND, WRITTEN, write_identified
    from twin.identification.run import identify as find
    from twin.identification.summary import SUMMARY_FILE, write_summary
    from twin.output import adding, alone_in, claim
    from twin.report import REPORT_NAMES
    from twin.report.identified import write_identified as draw

    loaded, experiments = load_problem(problem)
    problem_to_solve = loaded.quick() if quick else loaded
    who = workers_of(workers, cluster)
    names = (*WRITTEN, SUMMARY_FILE, *REPORT_NAMES)
    claim(out, COMMAND, names, [problem])
    with alone_in(out), progress_bars() as watch:
        posterior = find(problem_to_solve, experiments, out, who, watch=watch, inputs=[problem])
        with adding(out, *names) as folder:
            write_identified(folder, posterior, experiments)
            write_summary(folder, posterior)
            draw(folder, posterior, watch)
    rows = [
        [
            name,
            f"{marginal.mean:.4g}",
            f"{marginal.sd:.2g}",
            f"{marginal.low_95:.4g} to {marginal.high_95:.4g}",
        ]
        for name, marginal in posterior.intervals().items()
    ]
    print_table(("field", "mean", "standard deviation", "95 % interval"), rows)
    say(f"wrote {out / 'report.html'}")
