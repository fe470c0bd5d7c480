"""Folders that commands write: whole or not there, and nothing of anybody else's removed.

Everything is written into a working folder (`twin.working`) and moved at the end; an interrupted
command leaves the earlier result, if any, untouched. The manifest (`twin.manifest`) tells what may
be replaced.

- A new folder appears by one renaming.
- An existing one, which may be a mount point or the target of a symbolic link, stays where it is.
  Its files are exchanged one by one, `result.json` last; a result without it is none. Signals wait
  until that is done. What is to be exchanged is planned in the working folder before: after a
  kill -9 whoever opens the folder next, to write or to read, ends the exchange (`end_exchange`).
"""

import json
import os
import platform
from collections.abc import Collection, Iterable, Iterator, Mapping, Set
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from reconstruction.errors import InputError
from reconstruction.machine import is_disk_full, unwritable
from reconstruction.reading import read_json
from twin.manifest import (
    MANIFEST_FILE,
    enter,
    files_of,
    foreign,
    manifest_lines,
    ours,
    read_manifest,
    write_manifest,
)
from twin.working import is_second, leftovers, remove_leftovers, signals_held, working_folder

RESULT_FILE = "result.json"
EXPERIMENT_FILE = "experiment.toml"
RESULT = "result"
"""Kind of a folder that is replaced as a whole."""

_NAMED_PACKAGES = ("fringe-twin", "mitsuba", "drjit", "numpy", "scipy", "numba")
_ADVICE = "choose another -o DIR"
_PLAN = "plan.json"


@contextmanager
def output_folder(target: Path, inputs: Iterable[Path] = ()) -> Iterator[Path]:
    """Yield a folder to write into; on success it becomes `target`, on failure it vanishes.

    Parameters
    ----------
    inputs : files and folders that the command reads; those that do not exist are passed over

    Raises
    ------
    InputError : `target` cannot be written, holds something that was not written by `twin` or was
        changed since, or is the current folder, home, an input, or a folder above these, or in an
        input; or another process is writing there
    OSError : the disk is full
    """
    real = _checked_place(target, inputs)
    _refuse_foreign(target, real)
    with ExitStack() as stack:
        with _telling(target):
            stack.callback(_remove_empty, _make_folders(real if real.is_dir() else real.parent))
            remove_leftovers(real.parent, real.name)
            folder = stack.enter_context(_working(real))
        _refuse_second(target, folder)
        with _full_disk_told(target):
            yield folder
        with _telling(target):
            _publish(folder, real)


@contextmanager
def adding(target: Path, *names: str) -> Iterator[Path]:
    """Yield a folder; on success what was written there is added to the existing `target`.

    Parameters
    ----------
    names : what will be added, at the top: looked at beforehand

    Raises
    ------
    InputError : `target` cannot be written, or holds a file of such a name that `twin` did not
        write
    OSError : the disk is full
    """
    real = Path(os.path.realpath(target))
    _refuse_in_the_way(target, real, names)
    with ExitStack() as stack:
        with _telling(target):
            folder = stack.enter_context(_working(real))
        with _full_disk_told(target):
            yield folder
        with _telling(target):
            _put(folder, real)


def claim(target: Path, kind: str, names: Collection[str], inputs: Iterable[Path] = ()) -> None:
    """Make `target` a folder that a command goes on in, or go on in it.

    What others put there stays, and is refused only where it is in the way.

    Parameters
    ----------
    kind : the command
    names : what it writes at the top

    Raises
    ------
    InputError : as `output_folder`; or the folder is one of another command
    OSError : the disk is full
    """
    real = _checked_place(target, inputs)
    known = read_manifest(real)
    if known is None:
        _refuse_foreign(target, real, kind)
    elif known.kind != kind:
        raise InputError(f"{target}: holds no earlier run of twin {kind}; {_ADVICE}")
    _refuse_in_the_way(target, real, names)
    with ExitStack() as stack, _telling(target):
        stack.callback(_remove_empty, _make_folders(real))
        _take_up(real)
        enter(real, kind, ())


@contextmanager
def alone_in(target: Path) -> Iterator[None]:
    """Hold a claimed folder for as long as a command goes on in it.

    Raises
    ------
    InputError : another process holds it
    """
    with ExitStack() as stack:
        with _telling(target):
            folder = stack.enter_context(_working(Path(os.path.realpath(target))))
        _refuse_second(target, folder)
        yield


def _refuse_second(target: Path, folder: Path) -> None:
    if is_second(folder):
        raise InputError(f"{target}: another twin is writing there; wait for it, or {_ADVICE}")


def _checked_place(target: Path, inputs: Iterable[Path]) -> Path:
    """Resolve links; refuse what is at or above what must stay, or inside an input."""
    real = Path(os.path.realpath(target))
    kept = {"the current folder": Path.cwd(), "your home": Path("~").expanduser()}
    kept |= {f"the input {path}": path for path in inputs if path.exists()}
    for what, path in kept.items():
        there = Path(os.path.realpath(path))
        if real == there or real in there.parents:
            above = "is" if real == there else "holds"
            raise InputError(f"{target}: {above} {what}; {_ADVICE}")
        if what.startswith("the input") and there in real.parents:
            raise InputError(f"{target}: lies inside {what}; {_ADVICE}")
    return real


def _refuse_foreign(target: Path, real: Path, kind: str = RESULT) -> None:
    """Refuse a target that holds anything that was not written by `twin`."""
    if real.exists() and not real.is_dir():
        raise InputError(f"{target}: is a file; {_ADVICE}")
    if not real.is_dir():
        return
    known = read_manifest(real)
    if known is not None and known.kind != RESULT:
        raise InputError(f"{target}: belongs to twin {known.kind}; {_ADVICE}")
    with _telling(target):
        found = foreign(real, known)
    if found is None:
        return
    earlier = "earlier result" if kind == RESULT else f"earlier run of twin {kind}"
    reason = f"not written by twin: {found}" if known else f"no {MANIFEST_FILE}; found {found}"
    raise InputError(f"{target}: is no {earlier} ({reason}); move it away, or {_ADVICE}")


def _refuse_in_the_way(target: Path, real: Path, names: Collection[str]) -> None:
    """Refuse where one of these names is somebody else's."""
    if names and real.is_dir():
        found = foreign(real, read_manifest(real), names)
        if found is not None:
            raise InputError(
                f"{target}: {found} is in the way (not written by twin); move or delete it"
            )


@contextmanager
def _working(real: Path) -> Iterator[Path]:
    """Yield a folder to write into, on the file system of the target."""
    _take_up(real)
    with working_folder(real if real.is_dir() else real.parent, real.name) as folder:
        yield folder


def _publish(folder: Path, real: Path) -> None:
    """Make the content of `folder` the result at `real`."""
    if real.is_dir():
        known = read_manifest(real)
        _put(folder, real, ours(real, list(known.lines), known) if known else set())
    else:
        _remove_empty(sorted((p for p in folder.rglob("*") if p.is_dir()), reverse=True))
        write_manifest(folder / MANIFEST_FILE, RESULT, manifest_lines(folder))
        folder.rename(real)


def _put(folder: Path, real: Path, gone: Set[str] | None = None) -> None:
    """Move the files of `folder` to `real`, where the files `gone` make room for a whole result.

    A file that appeared there while the command ran is not overwritten.
    """
    new, lines = files_of(folder), manifest_lines(folder)
    _refuse_blocked(real, set(new) - (gone or set()))
    if gone is not None:
        write_manifest(folder.parent / MANIFEST_FILE, RESULT, lines)
    enter(real, RESULT, lines)
    for path in new:
        (real / path).parent.mkdir(parents=True, exist_ok=True)
    write_json(folder.parent / f"{_PLAN}.part", {"goes": sorted(set(gone or ()) - set(new))})
    with signals_held():
        (folder.parent / f"{_PLAN}.part").replace(folder.parent / _PLAN)
        _exchange(folder, real)


def _refuse_blocked(real: Path, new: Iterable[str]) -> None:
    there = sorted(path for path in new if os.path.lexists(real / path))
    own = ours(real, there, read_manifest(real))
    for path in there:
        if path not in own:
            raise InputError(f"{real / path}: is in the way (not written by twin); move it away")


def _exchange(folder: Path, real: Path) -> None:
    """Carry out what is left of a plan, the result's own file first away and last there."""
    new, known = files_of(folder), read_manifest(real)
    goes = ours(real, read_json(folder.parent / _PLAN)["goes"], known)
    for path in (*(path for path in new if path == RESULT_FILE), *goes):
        (real / path).unlink(missing_ok=True)
    for path in sorted(new, key=lambda path: path == RESULT_FILE):
        (folder / path).replace(real / path)
    _remove_empty(real / path for path in sorted(known.folders if known else (), reverse=True))
    if (folder.parent / MANIFEST_FILE).exists():
        (folder.parent / MANIFEST_FILE).replace(real / MANIFEST_FILE)


def end_exchange(folder: Path) -> None:
    """End the exchange of files at which a run was killed; to call before a folder is read.

    Raises
    ------
    InputError : a file that `twin` did not write is in the way
    """
    with suppress(OSError):  # no right to write there: the folder holds no result
        _take_up(Path(os.path.realpath(folder)))


def _take_up(real: Path) -> None:
    for left in leftovers(real):
        if (left.parent / _PLAN).is_file():
            _refuse_blocked(real, files_of(left))
            with signals_held():
                _exchange(left, real)
    remove_leftovers(real)


def _make_folders(folder: Path) -> list[Path]:
    """Make a folder and what is missing above it; returns those made, the innermost first."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        _remove_empty(missing)
        raise
    return missing


def _remove_empty(folders: Iterable[Path]) -> None:
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()


@contextmanager
def _telling(target: Path) -> Iterator[None]:
    """Say which target cannot be written, and what to do."""
    try:
        yield
    except OSError as error:
        told = unwritable(target, error)
        raise (InputError(f"{told}; {_ADVICE}") if isinstance(told, InputError) else told) from None


@contextmanager
def _full_disk_told(target: Path) -> Iterator[None]:
    """Name the target where the disk is full; other errors of a command are its own."""
    try:
        yield
    except OSError as error:
        if is_disk_full(error):
            raise unwritable(target, error) from None
        raise


@contextmanager
def creating(path: Path) -> Iterator[Path]:
    """Yield where to write a file that then appears as `path`, whole or not at all.

    Raises
    ------
    InputError : there is such a file already, or it cannot be written
    OSError : the disk is full
    """
    _refuse_existing(path)
    with ExitStack() as stack:
        try:
            remove_leftovers(path.parent, path.name)
            folder = stack.enter_context(working_folder(path.parent, path.name))
            yield folder / path.name
            _refuse_existing(path)
            (folder / path.name).replace(path)
        except OSError as error:
            raise unwritable(path, error) from None


def _refuse_existing(path: Path) -> None:
    if os.path.lexists(path):
        raise InputError(f"{path}: exists already; give another name, or delete it")


@contextmanager
def replacing(path: Path, kind: type[InputError] = InputError) -> Iterator[Path]:
    """Yield where to write a file that then takes the place of `path`, whole or not at all.

    Raises
    ------
    InputError : it cannot be written; `kind` where another one is asked for
    OSError : the disk is full
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")  # others may write it, too
    try:
        yield part
        part.replace(path)
    except OSError as error:
        raise unwritable(path, error, kind) from None
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write JSON with sorted keys; NaN and infinity are errors, not numbers."""
    path.write_text(
        json.dumps(content, indent=2, sort_keys=True, allow_nan=False) + "\n", encoding="utf-8"
    )


def write_outcome(folder: Path, command: str, figures: Mapping[str, Any], **named: str) -> None:
    """Write result.json: the figures, which command and versions made them, and what names them."""
    content = {"command": command, "metrics": figures, "versions": versions(), **named}
    write_json(folder / RESULT_FILE, {"schema_version": 1, **content})


def replace_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write JSON whole or not at all: under a temporary name, to the disk, then renamed."""
    with replacing(path) as part:
        write_json(part, content)
        with part.open("rb") as file:
            os.fsync(file.fileno())


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
