"""The application: its options, its exit codes, and how a command's failure is told."""

import signal
import sys
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, CycloptsError, Parameter

from reconstruction.errors import InputError
from reconstruction.machine import is_disk_full

BAD_INPUT, MISSING_BACKEND, FAILURE = 2, 3, 1
BY_SIGNAL = 128
"""Exit code of a command that a signal ended, less the number of the signal."""

app = App(
    name="twin",
    help="Digital twin of a contact fringe-projection sensor: press, render, reconstruct, score.",
    version=lambda: metadata.version("fringe-twin"),
    version_flags=["--version"],
    help_flags=["--help", "-h"],
    suppress_keyboard_interrupt=False,  # `guarded` tells which signal it was
)

Out = Annotated[Path, Parameter(name=["--out", "-o"], help="folder for the result")]
Settings = Annotated[
    list[str] | None,
    Parameter(name=["--set", "-s"], help="KEY=VALUE by dotted path, for example camera.binning=2"),
]


def guarded(run: Callable[[], Any]) -> int:
    """Run a command; turn expected failures into one line and an exit code."""
    try:
        return int(run() or 0)
    except InputError as error:
        sys.stderr.write(f"twin: {error}\n")
        return BAD_INPUT
    except CycloptsError as error:
        sys.stderr.write(f"twin: {' '.join(str(error).split())} See twin --help.\n")
        return BAD_INPUT
    except KeyboardInterrupt as error:
        number = getattr(error, "number", signal.SIGINT)
        name = signal.Signals(number).name
        sys.stderr.write(f"twin: ended by {name}; nothing is left half-written\n")
        return BY_SIGNAL + number
    except OSError as error:
        if not is_disk_full(error):
            raise
        where = error.filename or "writing"
        sys.stderr.write(
            f"twin: {where}: no room left ({error.strerror}); make room, or write to another disk\n"
        )
        return FAILURE
    except RuntimeError as error:
        if type(error).__name__ != "MissingBackend":
            raise
        sys.stderr.write(f"twin: {error}\n")
        return MISSING_BACKEND
