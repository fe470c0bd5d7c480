"""Commands that check the machine, write templates, list keys, and print completion scripts."""

import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from twin.cli.app import (
    FAILURE,
    MISSING_BACKEND,
    ExperimentFile,
    Settings,
    app,
    load,
    print_metrics,
    print_table,
    say,
)


@app.command
def doctor(*, warm: bool = False, clear: Annotated[bool, Parameter(negative="")] = False) -> int:
    """Check this machine: packages, Dr.Jit backend, LLVM or CUDA, data files, caches, disk.

    Parameters
    ----------
    warm
        Also compile the kernels of ordinary measurements, so that the first measurement does not.
    clear
        First remove all compiled kernels and the stored choice of the backend; they are made again
        when they are needed. The cache of Dr.Jit is that of all programs of this user.
    """
    if clear:
        from twin.caches import caches

        for cache in caches():
            say(f"{cache.name}: {cache.clear()} files removed")
    from twin.doctor import diagnose
    from twin.doctor import warm as compile_kernels

    findings = diagnose()
    if warm:
        findings += compile_kernels(lambda done: sys.stderr.write(f"compiled {done}\n"))
    rows = (
        (
            "ok" if finding.ok else "no",
            finding.name,
            finding.detail,
            "" if finding.ok else finding.advice,
        )
        for finding in findings
    )
    print_table(("", "check", "found", "remedy"), rows, {"ok": "green", "no": "red"})
    if all(finding.ok for finding in findings):
        return 0
    return (
        MISSING_BACKEND
        if any(f.name == "renderer backend" and not f.ok for f in findings)
        else FAILURE
    )


@app.command
def init(
    file: Annotated[
        Path | None,
        Parameter(help="file to write; default: experiment.toml, of a study study.toml"),
    ] = None,
    *,
    template: str = "gel",
    listed: Annotated[bool, Parameter(name="--list", negative="")] = False,
) -> None:
    """Write a commented template: a working experiment or study, for you to change.

    Parameters
    ----------
    file
        File to write; an existing file is never overwritten.
    template
        Name of the template: gel (default), part, sheet, gelsight, rig, study.
    listed
        Only list the templates.
    """
    from reconstruction.writing import write_text
    from twin.config.templates import read_template, templates
    from twin.files import creating

    if listed:
        print_table(
            ("template", "description"),
            ((entry.name, entry.description) for entry in templates()),
        )
        return
    text = read_template(template)
    command = "sweep" if template == "study" else "measure"
    target = file or Path("study.toml" if template == "study" else "experiment.toml")
    with creating(target) as part:
        write_text(part, text)
    say(f"wrote {target}; next: twin {command} {target} -o out")


@app.command
def keys(pattern: str | None = None, /) -> None:
    """List the keys of an experiment file: allowed values, default, meaning.

    Parameters
    ----------
    pattern
        Words that key or meaning must contain, for example thickness, "noise camera"; default: all.
    """
    from twin.cli.keys import lines_of, matching

    for line in lines_of(matching(pattern or "")):
        say(line)


@app.command
def layout(experiment: ExperimentFile, /, *, settings: Settings = None) -> None:
    """Print field, distance, depth of field, angle and sequence of an experiment; no rendering.

    The output also lists the keys that follow from the table [optics], and the shipped lenses that
    meet it; see docs/optics.md.
    """
    from twin.config.rig import derived_keys, lenses_meeting
    from twin.results.layout import known_warnings, layout_figures

    loaded = load(experiment, settings)
    print_metrics(dict(layout_figures(loaded)))
    values = loaded.model_dump()
    for path, key in derived_keys(values, loaded.name).items():
        say(f"{path} = {key.value:.6g}  # {key.source}")
    for line in known_warnings(loaded):
        sys.stderr.write(f"twin: warning: {line}\n")
    if loaded.optics.is_stated:
        say(f"lenses that meet [optics]: {', '.join(lenses_meeting(values)) or 'none shipped'}")


@app.command
def completion(shell: Literal["bash", "zsh", "fish"], /) -> None:
    """Print a script that completes commands and options in a shell.

    Parameters
    ----------
    shell
        bash: source <(twin completion bash); zsh: the same, after compinit; fish: twin completion
        fish | source.
    """
    say(app.generate_completion(prog_name="twin", shell=shell))
