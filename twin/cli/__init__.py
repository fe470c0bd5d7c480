"""Command line of the twin. Heavy packages are imported inside the commands."""

import sys

# These enter their commands into the application.
from twin.cli import captures as captures
from twin.cli import forward as forward
from twin.cli import identify as identify
from twin.cli import start as start
from twin.cli import studies as studies
from twin.cli.app import app, guarded
from twin.working import unwind_on_signals

__all__ = ["main", "run"]


def run(arguments: list[str] | None = None) -> int:
    """Run one command line (default: the process' own arguments) and return its exit code."""
    return guarded(
        lambda: app(arguments, exit_on_error=False, print_error=False, result_action="return_value")
    )


def main() -> None:
    """Entry point of the `twin` command."""
    unwind_on_signals()
    sys.exit(run())
