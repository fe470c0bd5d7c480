"""Result folders that are either whole or not there.

Everything is written under a temporary name beside the target and renamed at the end; an
interrupted command leaves the earlier result, if any, untouched.
"""

import json
import os
import platform
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from reconstruction.errors import InputError

RESULT_FILE = "result.json"
EXPERIMENT_FILE = "experiment.toml"

_NAMED_PACKAGES = ("fringe-twin", "mitsuba", "drjit", "numpy", "scipy", "numba")


@contextmanager
def output_folder(target: Path) -> Iterator[Path]:
    """Yield a folder to write into; on success it becomes `target`, on failure it vanishes.

    Raises
    ------
    InputError
        `target` cannot be written, or is something other than an earlier result.
    """
    target = target.absolute()
    _refuse_foreign(target)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        working = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
    except OSError as error:
        raise InputError(
            f"{target}: cannot be written ({error.strerror}); choose another -o DIR"
        ) from None
    try:
        working.chmod(0o755)
        yield working
        _swap(working, target)
    finally:
        shutil.rmtree(working, ignore_errors=True)


def _refuse_foreign(target: Path) -> None:
    if target.is_dir():
        if (target / RESULT_FILE).is_file() or not any(target.iterdir()):
            return
        raise InputError(
            f"{target}: exists and is no earlier result (no {RESULT_FILE}); choose another -o DIR"
        )
    if target.exists():
        raise InputError(f"{target}: is a file; choose another -o DIR")


def _swap(working: Path, target: Path) -> None:
    if not target.exists():
        working.rename(target)
        return
    retired = Path(tempfile.mkdtemp(prefix=f".{target.name}.old.", dir=target.parent))
    target.rename(retired / "result")
    working.rename(target)
    shutil.rmtree(retired, ignore_errors=True)


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write JSON with sorted keys; NaN and infinity are errors, not numbers."""
    path.write_text(
        json.dumps(content, indent=2, sort_keys=True, allow_nan=False) + "\n", encoding="utf-8"
    )


def replace_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write JSON whole or not at all: under a temporary name, to the disk, then renamed."""
    part = path.with_name(f".{path.name}.part")
    write_json(part, content)
    with part.open("rb") as file:
        os.fsync(file.fileno())
    part.replace(path)


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object.

    Raises
    ------
    InputError
        The file is missing, damaged or no object.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give the folder of a finished result") from None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None
    if not isinstance(content, dict):
        raise InputError(f"{path}: found {type(content).__name__}, allowed a JSON object")
    return content


def versions() -> dict[str, str]:
    """Versions of everything that can change a number in a result."""
    return dict(_versions())


@cache
def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for name in _NAMED_PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "absent"
    return found
