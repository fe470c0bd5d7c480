"""Command that covers a large part with overlapping patches."""

from pathlib import Path

from twin.cli.app import Out, Report, app, print_metrics, progress_bars, say


@app.command
def scan(plan: Path, /, *, out: Out, report: Report = True) -> None:
    """Measure or read overlapping patches of a large part; register and fuse them to one map.

    Finished patches in OUT are not measured again.

    Parameters
    ----------
    plan
        TOML file, or the name of a shipped plan such as scans/plate; see docs/scan.md.
    """
    from twin.config.scan import load_scan
    from twin.output import adding
    from twin.pipeline.scan import run_scan
    from twin.report import REPORT_NAMES
    from twin.report.scan import write_scan_page

    loaded = load_scan(plan)
    with progress_bars() as watch:
        done = run_scan(loaded, out, watch, [plan, *loaded.results])
        if report:
            with adding(out, *REPORT_NAMES) as drawn:
                write_scan_page(out, watch, drawn)
    print_metrics(done.figures)
    say(f"wrote {out}")
