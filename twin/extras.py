"""Install commands for optional dependencies: the extras of pyproject.toml.

The project is in no package index, so an extra is installed from the checkout.
"""

import shlex
import sys
from pathlib import Path

from reconstruction.errors import InputError


def missing(where: str, package: str, extra: str, note: str = "") -> InputError:
    """Return the error of an option with a missing package, with the install command.

    Parameters
    ----------
    where : the option or key that needs it
    package : its name in prose
    extra : of pyproject.toml
    note : additional remark after the command
    """
    more = f" ({note})" if note else ""
    return InputError(f"{where}: needs {package}, which is not installed; {install(extra)}{more}")


def install(extra: str = "") -> str:
    """Return the command that installs the project with an extra into this Python."""
    wanted, root = f"[{extra}]" if extra else "", _checkout()
    if root is None:
        return f"in a checkout of fringe-twin: {pip_install(f'.{wanted}')}"
    return pip_install("-e", f"{root}{wanted}")


def pip_install(*requirements: str) -> str:
    """Return the command that installs packages into this Python; `pip` may be of another one."""
    return shlex.join([sys.executable, "-m", "pip", "install", *requirements])


def _checkout() -> Path | None:
    """Return the checkout that this package runs from; None where it is installed elsewhere."""
    root = Path(__file__).resolve().parent.parent
    return root if (root / "pyproject.toml").is_file() else None
