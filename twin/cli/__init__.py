"""Command line of the twin.

The signals of a command have their handlers before any package that takes long is imported: the
commands are in `twin.cli.commands`, and import the packages that they need.
"""

import gc

from reconstruction.machine import keep_freed_memory
from twin.cli.environment import prepare_environment
from twin.working import end_by_signal, end_process, end_within, unwind_on_signals

__all__ = ["main", "run"]

SIGNAL_DELAY_S = 1.2
"""Time, s, from a signal to the end of the process if the current call does not return."""

OBJECTS_PER_COLLECTION = 50_000
"""New objects between two garbage collections; at the default of 700 imports take 20 % longer."""


def run(arguments: list[str] | None = None) -> int:
    """Run one command line (default: the arguments of the process) and return its exit code."""
    from twin.cli.commands import run_line

    return run_line(arguments)


def main() -> None:
    """Entry point of the `twin` command."""
    try:
        prepare_environment()  # first: the pipe of `end_within` must not get a stream's number
        end_within(SIGNAL_DELAY_S)
        unwind_on_signals()
        gc.set_threshold(OBJECTS_PER_COLLECTION)
        keep_freed_memory()
        code = run()
    except KeyboardInterrupt as error:
        code = end_by_signal(error)
    end_process(code)
