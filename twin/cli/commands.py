"""All commands, and the run of one command line."""

import sys

# These modules register their commands with the application.
from twin.cli import calibration as calibration
from twin.cli import captures as captures
from twin.cli import dataset as dataset
from twin.cli import forward as forward
from twin.cli import inverse as inverse
from twin.cli import results as results
from twin.cli import scan as scan
from twin.cli import start as start
from twin.cli import studies as studies
from twin.cli.app import app, guarded
from twin.cli.environment import check_environment
from twin.cli.plugins import load_plugins
from twin.cli.talk import choose_level, introduce


def run_line(arguments: list[str] | None = None) -> int:
    """Run one command line (default: the arguments of the process) and return its exit code."""
    words = choose_level(sys.argv[1:] if arguments is None else arguments)
    return guarded(lambda: _dispatch(words), words)


def _dispatch(words: list[str]) -> int | None:
    check_environment()
    introduce()
    written = calibration.with_repeated_options(load_plugins(words))
    done = app(written, exit_on_error=False, print_error=False, result_action="return_value")
    return None if done is None else int(done)
