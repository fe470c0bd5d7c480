"""Print the backend of this machine: `python -m twin.optics.backend [--fresh]`."""

import argparse
import sys

from twin.optics.backend import MissingBackend, find_backend

_MISSING_EXIT = 3


def main() -> int:
    """Print the backend of this machine, or why there is none.

    Returns
    -------
    Exit status: 0, or 3 without a backend
    """
    parser = argparse.ArgumentParser(prog="python -m twin.optics.backend", description=main.__doc__)
    parser.add_argument("--fresh", action="store_true", help="probe again")
    arguments = parser.parse_args()
    try:
        sys.stdout.write(f"{find_backend(fresh=arguments.fresh)}\n")
    except MissingBackend as error:
        sys.stderr.write(f"{error}\n")
        return _MISSING_EXIT
    return 0


if __name__ == "__main__":
    sys.exit(main())
