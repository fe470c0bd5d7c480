"""Check the environment of a command before it starts: variables, limits, folder, streams.

The packages of this project read some environment variables when they are imported, and raise
errors that do not name the variable. A command therefore checks them first.
"""

import io
import os
import sys
from importlib.util import find_spec
from pathlib import Path

from reconstruction.errors import InputError
from reconstruction.machine import VARIABLE

LEAST_ADDRESS_SPACE_GIB = 0.75
"""Smallest address space, GiB, in which all packages can be loaded (measured: 0.7 GiB)."""

LEAST_OPEN_FILES, ENOUGH_OPEN_FILES = 16, 256
"""Open files that a command needs, and the limit that it sets for itself if it may."""

_WHOLE_NUMBERS = {VARIABLE: 1, "SOURCE_DATE_EPOCH": 0}
"""Smallest value of variables that packages read as whole numbers."""


def prepare_environment() -> None:
    """Replace closed streams, print any name, draw without screen, allow enough open files."""
    _open_closed_streams()
    _print_any_name()
    # A command draws into files. Matplotlib rejects an unknown name when it is imported.
    os.environ["MPLBACKEND"] = "agg"
    _raise_limit_of_open_files()


def check_environment() -> None:
    """Check variables, limits of the process, and the current folder.

    Raises
    ------
    InputError : a variable, a limit or the current folder makes the work impossible
    """
    for name, least in _WHOLE_NUMBERS.items():
        _check_whole_number(name, least)
    if os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
        sys.stderr.write(
            "twin: warning: NUMBA_DISABLE_JIT is set: kernels run without compilation, hundreds of"
            " times slower; remove it with: unset NUMBA_DISABLE_JIT\n"
        )
    _check_limits()
    _check_current_folder()


def _open_closed_streams() -> None:
    """Connect closed standard streams to the null device.

    Otherwise the next files that the process opens would have the numbers of these streams, and
    libraries would write their messages into them.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            null = os.open(os.devnull, os.O_RDONLY if number == 0 else os.O_WRONLY)
            if null != number:
                os.dup2(null, number)
                os.close(null)
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, "r" if number == 0 else "w", closefd=False))


def _print_any_name() -> None:
    """Escape what standard output cannot encode: bytes of a name that are no UTF-8, for example."""
    stdout = sys.stdout
    if isinstance(stdout, io.TextIOWrapper) and stdout.errors == "strict":
        stdout.reconfigure(errors="backslashreplace")


def _raise_limit_of_open_files() -> None:
    if find_spec("resource") is None:  # not on Windows
        return
    import resource

    current, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    enough = ENOUGH_OPEN_FILES if most == resource.RLIM_INFINITY else min(ENOUGH_OPEN_FILES, most)
    if current != resource.RLIM_INFINITY and current < enough:
        resource.setrlimit(resource.RLIMIT_NOFILE, (enough, most))


def _check_whole_number(name: str, least: int) -> None:
    value = os.environ.get(name)
    if value is None or (value.isascii() and value.isdecimal() and int(value) >= least):
        return
    raise InputError(
        f"environment variable {name}: found {value!r}, allowed a whole number, at least {least};"
        f" change it, or remove it with: unset {name}"
    )


def _check_limits() -> None:
    if find_spec("resource") is None:
        return
    import resource

    files = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if files != resource.RLIM_INFINITY and files < LEAST_OPEN_FILES:
        raise InputError(
            f"limit of open files: found {files}, allowed {LEAST_OPEN_FILES} or more; raise it"
            f" with: ulimit -n {ENOUGH_OPEN_FILES}"
        )
    space = resource.getrlimit(resource.RLIMIT_AS)[0]
    if space != resource.RLIM_INFINITY and space < LEAST_ADDRESS_SPACE_GIB * 2**30:
        raise InputError(
            f"limit of the address space: found {space / 2**30:.2g} GiB, allowed"
            f" {LEAST_ADDRESS_SPACE_GIB:g} GiB or more; raise it with: ulimit -v unlimited"
        )


def _check_current_folder() -> None:
    try:
        Path.cwd()
    except FileNotFoundError as error:
        raise InputError(
            "the current folder was removed; change to an existing folder: cd"
        ) from error
