"""Command lines of the twin in forked children, which need no imports of their own."""

import io
import os
import sys
from collections.abc import Callable
from pathlib import Path


def command(arguments: list[str]) -> int:
    """Run a command line of the twin as its program does; return the exit code."""
    from twin.cli import run
    from twin.working import unwind_on_signals

    unwind_on_signals()
    return run(arguments)


def preload() -> None:
    """Import the modules that the commands need; starts no thread."""
    import h5netcdf  # noqa: F401
    import trimesh  # noqa: F401

    import twin.cli.commands
    import twin.pipeline.captures
    import twin.pipeline.press
    import twin.report
    import twin.study.sweep  # noqa: F401


def forked(action: Callable[[], int], folder: Path) -> int:
    """Run an action in a forked child, with its own session, in a folder; return its process id.

    The child's exit code is the returned number. Its messages are written to `stderr` there.
    """
    child = os.fork()
    if child:
        return child
    code = 1
    try:
        os.setsid()
        os.chdir(folder)
        for number, name in enumerate((os.devnull, os.devnull, "stderr")):
            flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC if number else os.O_RDONLY
            os.dup2(os.open(name, flags, 0o600), number)
        # The parent may have replaced its streams.
        sys.stdout, sys.stderr = (
            io.TextIOWrapper(io.FileIO(n, "w"), "utf-8", "backslashreplace") for n in (1, 2)
        )
        try:
            code = action()
        except BaseException:
            sys.excepthook(*sys.exc_info())  # type: ignore[arg-type]
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code)
