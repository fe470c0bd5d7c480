"""Commands about this machine and the experiment file."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from twin.cli.app import FAILURE, MISSING_BACKEND, app
from twin.cli.console import say


@app.command
def doctor() -> int:
    """Check this machine: packages, Dr.Jit backend, LLVM or CUDA, data files, disk."""
    from rich.console import Console
    from rich.table import Table

    from twin.doctor import diagnose

    findings = diagnose()
    table = Table("", "check", "found", "what to do")
    for finding in findings:
        mark = "[green]ok[/]" if finding.ok else "[red]no[/]"
        table.add_row(mark, finding.name, finding.detail, "" if finding.ok else finding.advice)
    Console().print(table)
    if all(finding.ok for finding in findings):
        return 0
    return (
        MISSING_BACKEND
        if any(f.name == "renderer backend" and not f.ok for f in findings)
        else FAILURE
    )


@app.command
def init(
    file: Annotated[Path, Parameter(help="experiment file to write")] = Path("experiment.toml"),
) -> None:
    """Write a commented starter experiment.

    Parameters
    ----------
    file
        Where to write it; an existing file is never overwritten.
    """
    from twin.assets import asset_path
    from twin.output import creating

    starter = asset_path("scenes", "examples/starter").read_text(encoding="utf-8")
    with creating(file) as part:
        part.write_text(starter, encoding="utf-8")
    say(f"wrote {file}; next: twin measure {file} -o out")


@app.command
def keys() -> None:
    """List every key of an experiment file: type, allowed values, default, meaning."""
    from rich.console import Console
    from rich.table import Table

    from twin.config.reference import experiment_keys

    table = Table("key", "allowed", "default", "meaning")
    table.columns[0].no_wrap = True
    for key in experiment_keys():
        table.add_row(key.path, key.allowed, key.default, key.meaning)
    Console().print(table)
