"""Virtual environments of other programs, in a folder of their own: never those of the lock."""

import subprocess
import sys
import venv
from dataclasses import dataclass
from pathlib import Path

FOLDER = Path(__file__).parents[2] / "out" / "peers"
STAMP = "packages.stamp"
_TIMEOUT_S = 1800


class PeerError(Exception):
    """An environment could not be made; the message is one line."""


@dataclass(frozen=True)
class Environment:
    """An environment with fixed versions of a program's packages.

    Attributes
    ----------
    name : name of its folder
    packages : requirements for pip; none: this program's own environment
    """

    name: str
    packages: tuple[str, ...] = ()

    @property
    def version(self) -> str:
        """Version of the program, that of its first package; "" without packages."""
        return self.packages[0].partition("==")[2] if self.packages else ""

    def python(self, parent: Path = FOLDER) -> Path:
        """Return the interpreter of the environment, which is made if it is missing.

        Raises
        ------
        PeerError : the folder has other content, or a package cannot be installed
        """
        if not self.packages:
            return Path(sys.executable)
        folder = parent / self.name
        stamp, required = folder / STAMP, "\n".join((sys.version, *self.packages))
        if not stamp.is_file() or stamp.read_text(encoding="utf-8") != required:
            self._make(folder)
            stamp.write_text(required, encoding="utf-8")
        return _interpreter(folder)

    def _make(self, folder: Path) -> None:
        print(f"installing {' '.join(self.packages)} in {folder}", flush=True)
        _make_empty(folder)
        pip = [
            str(_interpreter(folder)),
            "-m",
            "pip",
            "install",
            "--progress-bar",
            "off",
            "--retries",
            "2",
        ]
        try:
            done = subprocess.run(
                [*pip, *self.packages], capture_output=True, text=True, timeout=_TIMEOUT_S
            )
        except subprocess.TimeoutExpired:
            raise PeerError(f"pip did not end within {_TIMEOUT_S} s") from None
        if done.returncode:
            raise PeerError(f"pip cannot install {self.packages[0]}: {_reason(done.stderr)}")


def _make_empty(folder: Path) -> None:
    """Make a virtual environment with pip only; replace an earlier one, but no other folder."""
    try:
        if folder.is_dir() and any(folder.iterdir()) and not (folder / "pyvenv.cfg").is_file():
            raise PeerError(f"{folder} is not empty and no virtual environment: move its content")
        venv.create(folder, clear=True, with_pip=True)
    except (OSError, ValueError, subprocess.CalledProcessError) as error:
        raise PeerError(f"no virtual environment in {folder}: {error}") from None


def _interpreter(folder: Path) -> Path:
    windows = folder / "Scripts" / "python.exe"
    return windows if windows.exists() else folder / "bin" / "python"


def _reason(output: str) -> str:
    """Return the last error of pip, or the last line of its output."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    errors = [line.removeprefix("ERROR: ") for line in lines if line.startswith("ERROR:")]
    return (errors or lines or ["no message"])[-1]
