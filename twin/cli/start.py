"""Commands about this machine and the experiment file."""

import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from twin.cli.app import FAILURE, MISSING_BACKEND, app, print_table, say


@app.command
def doctor(*, warm: bool = False) -> int:
    """Check this machine: packages, Dr.Jit backend, LLVM or CUDA, data files, disk.

    Parameters
    ----------
    warm
        Also compile the kernels of ordinary measurements, which the first one else waits for.
    """
    from twin.doctor import diagnose
    from twin.doctor import warm as compile_kernels

    findings = diagnose()
    if warm:
        findings += compile_kernels(lambda done: sys.stderr.write(f"compiled {done}\n"))
    rows = (
        ("ok" if one.ok else "no", one.name, one.detail, "" if one.ok else one.advice)
        for one in findings
    )
    print_table(("", "check", "found", "what to do"), rows, {"ok": "green", "no": "red"})
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
    from twin.config.loading import experiment_keys

    print_table(
        ("key", "allowed", "default", "meaning"),
        ((key.path, key.allowed, key.default, key.meaning) for key in experiment_keys()),
    )
