"""Output folders of commands: each is complete or absent, and no file of the user is removed.

A command writes into a working folder (`twin.working`). Its content becomes the result when the
command succeeds. An interrupted command does not change an earlier result. Only files that are
listed in the manifest (`twin.manifest`) are replaced.

- If the target does not exist, the working folder is renamed in one step.
- If the target exists, it is not moved, because it may be a mount point or the target of a symbolic
  link. Its files are exchanged one by one, `result.json` last. A folder without that file is not
  taken as a result. Signals are delayed until the end of the exchange. Before the exchange its plan
  is written into the working folder. After a kill -9 the next command that opens the folder, to
  write or to read, completes the exchange (`end_exchange`).
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
from reconstruction.writing import make_durable, make_names_durable, write_text
from twin.files import naming_unwritable
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
from twin.working import PLAN, is_second, leftovers, remove_leftovers, signals_held, working_folder

RESULT_FILE = "result.json"
EXPERIMENT_FILE = "experiment.toml"
RESULT = "result"
"""Kind, in the manifest, of a folder that is replaced as a whole."""

_NAMED_PACKAGES = ("fringe-twin", "mitsuba", "drjit", "numpy", "scipy", "numba")
_ADVICE = "choose another -o DIR"


@contextmanager
def output_folder(target: Path, inputs: Iterable[Path] = ()) -> Iterator[Path]:
    """Yield a working folder; on success its content becomes `target`, on failure it is removed.

    Parameters
    ----------
    target : the output folder; it may exist
    inputs : files and folders that the command reads; those that do not exist are ignored

    Raises
    ------
    InputError : `target` cannot be written, or another process is writing there. Or `target`
        contains files that `twin` did not write, or that were changed afterwards. Or `target` is
        the current folder, the home folder, an input, a folder above one of these, or inside an
        input
    OSError : the disk is full
    """
    real = check_output(target, inputs)
    with ExitStack() as stack:
        with _naming_target(target):
            stack.callback(_remove_empty, _make_folders(real if real.is_dir() else real.parent))
            remove_leftovers(real.parent, real.name)
            folder = stack.enter_context(_working(real))
        _refuse_second(target, folder)
        with _failing_to_write(target, folder):
            yield folder
        with _naming_target(target):
            _publish(folder, real)


def check_output(target: Path, inputs: Iterable[Path] = ()) -> Path:
    """Return `target` with links resolved, after the checks of `output_folder`.

    A command that computes for long calls it first.

    Raises
    ------
    InputError : for the reasons of `output_folder`, except that the place cannot be written
    """
    real = _checked_place(target, inputs)
    _refuse_foreign(target, real)
    return real


@contextmanager
def adding(target: Path, *names: str) -> Iterator[Path]:
    """Yield a working folder; on success its files are added to the existing folder `target`.

    Parameters
    ----------
    names : names of the files and folders, directly in `target`, that will be added; they are
        checked before the block

    Raises
    ------
    InputError : `target` cannot be written, or contains a file with one of these names that `twin`
        did not write
    OSError : the disk is full
    """
    real = Path(os.path.realpath(target))
    _refuse_in_the_way(target, real, names)
    with ExitStack() as stack:
        with _naming_target(target):
            folder = stack.enter_context(_working(real))
        with _failing_to_write(target, folder):
            yield folder
        with _naming_target(target):
            _put(folder, real)


def claim(target: Path, kind: str, names: Collection[str], inputs: Iterable[Path] = ()) -> None:
    """Create or reuse `target` as a folder to which one command adds files in several runs.

    Files of the user remain there. If such a file has a name that the command writes, InputError is
    raised.

    Parameters
    ----------
    target : the output folder; it may exist
    kind : name of the command
    names : names of files and folders, directly in `target`, that the command writes
    inputs : files and folders that the command reads; see `output_folder`

    Raises
    ------
    InputError : for the reasons of `output_folder`; or the folder belongs to another command
    OSError : the disk is full
    """
    real = _checked_place(target, inputs)
    known = read_manifest(real)
    if known is None:
        _refuse_foreign(target, real, kind)
    elif known.kind != kind:
        raise InputError(f"{target}: holds no earlier run of twin {kind}; {_ADVICE}")
    _refuse_in_the_way(target, real, names)
    with ExitStack() as stack, _naming_target(target):
        stack.callback(_remove_empty, _make_folders(real))
        _take_up(real)
        enter(real, kind, ())


@contextmanager
def alone_in(target: Path) -> Iterator[None]:
    """Lock a folder of `claim` during a `with` block, so that no second process writes into it.

    Raises
    ------
    InputError : another process has locked the folder
    """
    with ExitStack() as stack:
        with _naming_target(target):
            folder = stack.enter_context(_working(Path(os.path.realpath(target))))
        _refuse_second(target, folder)
        yield


@contextmanager
def claimed(
    target: Path, kind: str, names: Collection[str], inputs: Iterable[Path] = ()
) -> Iterator[None]:
    """Claim a folder, see `claim`, and lock it during a `with` block, see `alone_in`.

    After an error a folder to which no file was added loses its manifest, and is removed if it did
    not exist before.

    Raises
    ------
    InputError, OSError : for the reasons of `claim` and `alone_in`
    """
    real = Path(os.path.realpath(target))
    made = [folder for folder in (real, *real.parents) if not folder.exists()]
    claim(target, kind, names, inputs)
    with ExitStack() as stack:
        stack.callback(_remove_empty, made)
        stack.enter_context(alone_in(target))
        try:
            yield
        except BaseException:
            if foreign(real, None) is None:
                (real / MANIFEST_FILE).unlink(missing_ok=True)
            raise


def _refuse_second(target: Path, folder: Path) -> None:
    if is_second(folder):
        raise InputError(f"{target}: another twin is writing there; wait for it, or {_ADVICE}")


def _checked_place(target: Path, inputs: Iterable[Path]) -> Path:
    """Return `target` with links resolved; raise InputError if the run could harm other folders.

    It must not be the current folder, the home folder, an input, or a folder above one of these. It
    must not be inside an input either.
    """
    real = Path(os.path.realpath(target))
    protected = {"the current folder": Path.cwd(), "your home": Path("~").expanduser()}
    protected |= {f"the input {path}": path for path in inputs if path.exists()}
    for label, path in protected.items():
        there = Path(os.path.realpath(path))
        if real == there or real in there.parents:
            above = "is" if real == there else "holds"
            raise InputError(f"{target}: {above} {label}; {_ADVICE}")
        if label.startswith("the input") and there in real.parents:
            raise InputError(f"{target}: is inside {label}; {_ADVICE}")
    return real


def _refuse_foreign(target: Path, real: Path, kind: str = RESULT) -> None:
    """Raise InputError if `target` contains files that `twin` did not write, or is a file."""
    if real.exists() and not real.is_dir():
        raise InputError(f"{target}: is a file; {_ADVICE}")
    if not real.is_dir():
        return
    known = read_manifest(real)
    if known is not None and known.kind != RESULT:
        raise InputError(f"{target}: belongs to twin {known.kind}; {_ADVICE}")
    with _naming_target(target):
        entry = foreign(real, known)
    if entry is None:
        return
    earlier = "earlier result" if kind == RESULT else f"earlier run of twin {kind}"
    reason = f"not written by twin: {entry}" if known else f"no {MANIFEST_FILE}; found {entry}"
    raise InputError(f"{target}: is no {earlier} ({reason}); move it away, or {_ADVICE}")


def _refuse_in_the_way(target: Path, real: Path, names: Collection[str]) -> None:
    """Raise InputError if `target` has an entry of one of these names that `twin` did not write."""
    if names and real.is_dir():
        entry = foreign(real, read_manifest(real), names)
        if entry is not None:
            raise InputError(
                f"{target}: {entry} is in the way (not written by twin); move or delete it"
            )


@contextmanager
def _working(real: Path) -> Iterator[Path]:
    """Yield an empty folder to write into, on the same file system as the target."""
    _take_up(real)
    with working_folder(real if real.is_dir() else real.parent, real.name) as folder:
        yield folder


def _publish(folder: Path, real: Path) -> None:
    """Make the content of the working folder `folder` the result at `real`."""
    if real.is_dir():
        known = read_manifest(real)
        _put(folder, real, ours(real, list(known.lines), known) if known else set())
    else:
        _remove_empty(sorted((p for p in folder.rglob("*") if p.is_dir()), reverse=True))
        write_manifest(folder / MANIFEST_FILE, RESULT, manifest_lines(folder))
        make_durable(folder)
        folder.rename(real)
        make_names_durable(real.parent)


def _put(folder: Path, real: Path, gone: Set[str] | None = None) -> None:
    """Move the files of `folder` to `real`, and remove the files `gone` from `real`.

    `gone` is given if `folder` contains a whole result, and None if files are added. A file of the
    user that was created in `real` while the command ran is not overwritten.
    """
    new, lines = files_of(folder), manifest_lines(folder)
    _refuse_blocked(real, set(new) - (gone or set()))
    # All steps that need disk space are done first, so that a full disk does not change the
    # earlier result.
    if gone is not None:
        write_manifest(folder.parent / MANIFEST_FILE, RESULT, lines)
    prepared = folder.parent / f"{PLAN}.part"
    write_json(prepared, {"goes": sorted(set(gone or ()) - set(new))})
    make_durable(folder.parent)
    enter(real, RESULT, lines)
    with ExitStack() as stack:
        for above in sorted({(real / path).parent for path in new}):
            stack.callback(_remove_empty, _make_folders(above))
        with signals_held():
            prepared.replace(folder.parent / PLAN)
            _exchange(folder, real)
    make_names_durable(real)


def _refuse_blocked(real: Path, new: Iterable[str]) -> None:
    there = sorted(path for path in new if os.path.lexists(real / path))
    own = ours(real, there, read_manifest(real))
    for path in there:
        if path not in own:
            raise InputError(f"{real / path}: is in the way (not written by twin); move it away")


def _exchange(folder: Path, real: Path) -> None:
    """Do the remaining steps of the plan of an exchange of files.

    `result.json` is removed first and written last. If the system fails in between, the plan and
    the files remain, so that a later command can complete the exchange (`twin.working.PLAN`).
    """
    try:
        _exchange_files(folder, real)
    except OSError as error:
        unfinished = "only some files are exchanged; the next command on this folder completes it"
        raise OSError(error.errno, f"{error.strerror}; {unfinished}", error.filename) from None


def _exchange_files(folder: Path, real: Path) -> None:
    new, known = files_of(folder), read_manifest(real)
    goes = ours(real, read_json(folder.parent / PLAN)["goes"], known)
    for path in (*(path for path in new if path == RESULT_FILE), *goes):
        (real / path).unlink(missing_ok=True)
    for path in sorted(new, key=lambda path: path == RESULT_FILE):
        (folder / path).replace(real / path)
    _remove_empty(real / path for path in sorted(known.folders if known else (), reverse=True))
    if (folder.parent / MANIFEST_FILE).exists():
        (folder.parent / MANIFEST_FILE).replace(real / MANIFEST_FILE)
    (folder.parent / PLAN).unlink()


def end_exchange(folder: Path) -> None:
    """Complete the exchange of files that a killed run left; call this before the folder is read.

    Raises
    ------
    InputError : a file that `twin` did not write has the name of a file to be moved
    """
    with suppress(OSError):  # no write permission: the folder contains no result
        _take_up(Path(os.path.realpath(folder)))


def _take_up(real: Path) -> None:
    for left in leftovers(real):
        if (left.parent / PLAN).is_file():
            _refuse_blocked(real, files_of(left))
            with signals_held():
                _exchange(left, real)
    remove_leftovers(real)


def _make_folders(folder: Path) -> list[Path]:
    """Create a folder and its missing parents; return the created folders, innermost first."""
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
def _naming_target(target: Path) -> Iterator[None]:
    """Convert an OSError of the block to an InputError with the target and a remedy."""
    try:
        yield
    except OSError as error:
        converted = unwritable(target, error)
        raise (
            InputError(f"{converted}; {_ADVICE}")
            if isinstance(converted, InputError)
            else converted
        ) from None


@contextmanager
def _failing_to_write(target: Path, folder: Path) -> Iterator[None]:
    """Convert an OSError on the working folder to an error that names the target.

    Other errors are passed on. If the working folder was removed during the run, every OSError and
    InputError is converted to an InputError that reports this.
    """
    try:
        yield
    except (OSError, InputError) as error:
        if not folder.is_dir():
            raise InputError(
                f"{target}: its working folder {folder.parent.name} was removed during the run; "
                f"run again, or {_ADVICE}"
            ) from None
        if isinstance(error, OSError) and _is_about(error, folder):
            with _naming_target(target):
                raise
        raise


def _is_about(error: OSError, folder: Path) -> bool:
    """Return True if an error names a file below a folder, or is a full disk without file name."""
    if error.filename is None:
        return is_disk_full(error)
    return folder in Path(os.fsdecode(error.filename)).parents


def write_json(path: Path, content: Mapping[str, Any], *, durable: bool = False) -> None:
    """Write a JSON file with sorted keys; raise ValueError for NaN and infinity.

    Parameters
    ----------
    durable : True: synchronise the new file to the device before it replaces an earlier one
    """
    text = json.dumps(content, indent=2, sort_keys=True, allow_nan=False)
    write_text(path, f"{text}\n", durable=durable)


def write_outcome(folder: Path, command: str, figures: Mapping[str, Any], **named: str) -> None:
    """Write `result.json` with the figures of a command.

    The file also contains the name of the command, the versions of packages, and the entries
    `named`.
    """
    content = {"command": command, "metrics": figures, "versions": versions(), **named}
    write_json(folder / RESULT_FILE, {"schema_version": 1, **content})


def replace_json(path: Path, content: Mapping[str, Any]) -> None:
    """Replace a JSON file in one atomic step and synchronise it to the device.

    Raises
    ------
    InputError : the file cannot be written
    OSError : the disk is full
    """
    with naming_unwritable(path):
        write_json(path, content, durable=True)


def versions() -> dict[str, str]:
    """Return the version of Python and of each package that can change a number in a result."""
    return dict(_versions())


@cache
def _versions() -> dict[str, str]:
    known = {"python": platform.python_version()}
    for name in _NAMED_PACKAGES:
        try:
            known[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            known[name] = "absent"
    return known
