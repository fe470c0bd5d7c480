"""How to install what an optional part of the twin needs: the extras of pyproject.toml.

The project is in no package index, so that an extra is installed from the checkout.
"""

import shlex
import sys
from pathlib import Path

from reconstruction.errors import InputError


def missing(where: str, package: str, extra: str, note: str = "") -> InputError:
    """Return the error of an option whose package is not installed, with the command that does it.

    Parameters
    ----------
    where : the option or key that needs it
    package : its name, as people write it
    extra : of pyproject.toml
    note : what to observe, behind the command
    """
    more = f" ({note})" if note else ""
    return InputError(f"{where}: needs {package}, which is not installed; {install(extra)}{more}")


def install(extra: str = "") -> str:
    """Return the command that installs the project with an extra into this Python."""
    wanted, root = f"[{extra}]" if extra else "", _checkout()
    if root is None:
        return f"in a checkout of fringe-twin: {pip_install(f'.{wanted}')}"
    return pip_install("-e", f"{root}{wanted}")


def pip_install(*what: str) -> str:
    """Return the command that installs packages into this Python; a bare pip may be another's."""
    return shlex.join([sys.executable, "-m", "pip", "install", *what])


def _checkout() -> Path | None:
    """Return the checkout that this package runs from; None where it is installed elsewhere."""
    root = Path(__file__).resolve().parent.parent
    return root if (root / "pyproject.toml").is_file() else None
