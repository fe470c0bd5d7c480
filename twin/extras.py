"""Install commands for optional dependencies: the extras of pyproject.toml.

The project is in no package index, so an extra is installed from the checkout.
"""

import shlex
import sys
from pathlib import Path

from reconstruction.errors import InputError


def missing(where: str, package: str, extra: str, note: str = "") -> InputError:
    """Return the error for an option that needs a package which is not installed.

    The message contains the install command.

    Parameters
    ----------
    where : the option or key that needs the package
    package : name of the package in prose
    extra : name of the extra in pyproject.toml that installs the package
    note : additional remark after the command
    """
    more = f" ({note})" if note else ""
    return InputError(f"{where}: needs {package}, which is not installed; {install(extra)}{more}")


def install(extra: str = "") -> str:
    """Return the command that installs the project, with one extra, into the running Python."""
    wanted, root = f"[{extra}]" if extra else "", _checkout()
    if root is None:
        return f"in a checkout of fringe-twin: {pip_install(f'.{wanted}')}"
    return pip_install("-e", f"{root}{wanted}")


def pip_install(*requirements: str) -> str:
    """Return the command that installs packages into the running Python.

    The `pip` on PATH may belong to another Python.
    """
    return shlex.join([sys.executable, "-m", "pip", "install", *requirements])


def _checkout() -> Path | None:
    """Return the root of the checkout that contains this package; None if there is no checkout."""
    root = Path(__file__).resolve().parent.parent
    return root if (root / "pyproject.toml").is_file() else None
