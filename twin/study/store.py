"""Store of a study: one folder per finished case, which is complete or does not exist.

    DIR/study.json, store.json     the study that was run last; versions
    DIR/cases/DIGEST/              result.json, experiment.toml, timings.json, requested arrays;
                                   or failure.json in place of result.json
    DIR/index.sqlite               the same figures for quick reading; built again if missing
    DIR/aside/DIGEST.N             damaged cases with files that `twin` did not write
    DIR/.parts/DIGEST.PID/         cases that are being written; never read
    DIR/.locks                     one byte range per case, locked by the process that computes it

A case is written under `.parts`, synchronised to the disk and then renamed. The case folders of a
killed run are therefore complete.

Each lock is a record lock of the operating system on one byte of the file `.locks` (`twin.locks`).
The system releases the lock when its process ends, for any reason. The locks also work between
several hosts if their shared file system has record locks (NFS 4, Lustre).
"""

import itertools
import os
import re
import shutil
import threading
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Any

from reconstruction.errors import InputError
from reconstruction.machine import unwritable
from reconstruction.reading import is_regular, read_json
from reconstruction.writing import make_durable, make_names_durable, write_text
from twin.config import Experiment, to_toml
from twin.locks import lock_byte, unlock_byte
from twin.manifest import MANIFEST_FILE, foreign, manifest_lines, read_manifest, write_manifest
from twin.output import (
    EXPERIMENT_FILE,
    RESULT,
    RESULT_FILE,
    adding,
    claim,
    versions,
    write_json,
)

# A file is opened only once per process: closing any of its handles would release all locks on it.
_open_files: dict[Path, int] = {}
# Record locks exclude other processes, but not other threads of the same process.
_held: set[tuple[Path, str]] = set()
_holding = threading.Lock()


def _claim(file: Path, digest: str) -> bool:
    with _holding:
        if (file, digest) in _held:
            return False
        try:
            if not lock_byte(_opened(file), int(digest, 16)):
                return False
        except OSError as error:
            raise InputError(
                f"{file}: cannot be locked ({error.strerror}); choose an -o DIR on a file system "
                "that has record locks"
            ) from None
        _held.add((file, digest))
        return True


def _release(file: Path, digest: str) -> None:
    with _holding:
        unlock_byte(_opened(file), int(digest, 16))
        _held.remove((file, digest))


def _opened(file: Path) -> int:
    if file not in _open_files:
        _open_files[file] = os.open(file, os.O_RDWR)
    return _open_files[file]


STORE_FILE, FAILURE_FILE, TIMINGS_FILE = "store.json", "failure.json", "timings.json"
COMMAND = "sweep"
# Used in place of a digest for the lock of a run on the whole store.
_RUN = "f" * 16
_CASES, _PARTS, _LOCKS, _ASIDE = "cases", ".parts", ".locks", "aside"
_NAMES = ("study.json",)
_PART = re.compile(r"[0-9a-f]+\.[0-9]+(\.old)?")


class Store:
    """Store of the cases of a study; several processes may use one store at the same time."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder.absolute()
        self.cases = self.folder / _CASES

    def open(self, inputs: Iterable[Path] = ()) -> None:
        """Create the store if needed, and check that its cases are of the installed versions.

        Raises
        ------
        InputError : the folder is not a store, cannot be written, or was made by other versions;
            or it contains an input, see `twin.output.claim`
        """
        claim(self.folder, COMMAND, _NAMES, inputs)
        try:
            self._make()
        except OSError as error:
            raise unwritable(self.folder, error) from None
        self.check_versions()

    def exists(self) -> bool:
        """Return True if the folder is a store."""
        return is_regular(self.folder / STORE_FILE)

    def path_of(self, digest: str) -> Path:
        """Return the path of the folder of a case, finished or failed."""
        return self.cases / digest

    def finished(self) -> set[str]:
        """Return the digests of all cases in the store, including failed cases."""
        if not self.cases.is_dir():  # the first run was killed before the folder was made
            return set()
        return {entry.name for entry in os.scandir(self.cases)}

    def read(self, digest: str) -> dict[str, Any] | None:
        """Return the content of a case's result.json or failure.json; None if there is neither."""
        for name in (RESULT_FILE, FAILURE_FILE):
            path = self.path_of(digest) / name
            if is_regular(path):
                return read_json(path)
        return None

    def forget(self, digest: str) -> None:
        """Remove a case, damaged or not, in one atomic step, so that it will be computed again.

        A case folder with files that `twin` did not write is moved to `aside/`.
        """
        if not _is_own(self.path_of(digest)):
            self._put_aside(digest)
            return
        away = self.folder / _PARTS / f"{digest}.{os.getpid()}.old"
        shutil.rmtree(away, ignore_errors=True)
        try:
            self.path_of(digest).rename(away)
        except FileNotFoundError:
            return
        shutil.rmtree(away, ignore_errors=True)

    def _put_aside(self, digest: str) -> None:
        aside = self.folder / _ASIDE
        aside.mkdir(exist_ok=True)
        names = (f"{digest}.{number}" for number in itertools.count())
        with suppress(FileNotFoundError):
            free = next(name for name in names if not os.path.lexists(aside / name))
            self.path_of(digest).rename(aside / free)

    @contextmanager
    def writing(self, digest: str) -> Iterator[Path]:
        """Yield a folder that becomes the folder of the case if the block raises no exception."""
        with self.part(digest) as part:
            yield part
            self.publish(part, digest)

    @contextmanager
    def part(self, digest: str) -> Iterator[Path]:
        """Yield a folder for the files of a case; it is removed at the end unless published."""
        part = self.folder / _PARTS / f"{digest}.{os.getpid()}"
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir()
        try:
            yield part
        finally:
            shutil.rmtree(part, ignore_errors=True)

    def publish(self, part: Path, digest: str) -> None:
        """Synchronise the files of a part to the disk, and make it the folder of the case.

        Raises
        ------
        OSError : the device cannot store them
        """
        write_manifest(part / MANIFEST_FILE, RESULT, manifest_lines(part))
        make_durable(part)
        try:
            part.rename(self.path_of(digest))
        except OSError:
            if not self.path_of(digest).is_dir():  # another process was first: same content
                raise
        make_names_durable(self.cases)

    @contextmanager
    def claimed(self, digest: str) -> Iterator[bool]:
        """Lock a case during the block; yield False if another process or thread has locked it.

        Raises
        ------
        InputError : the file system has no record locks
        """
        file = self.folder / _LOCKS
        mine = _claim(file, digest)
        try:
            yield mine
        finally:
            if mine:
                _release(file, digest)

    def exclusive(self) -> AbstractContextManager[bool]:
        """Lock the store during the block; yield False if another run has locked it."""
        return self.claimed(_RUN)

    def abandoned(self) -> list[str]:
        """Remove the incomplete cases of ended processes; return the digests of these cases."""
        left = []
        for part in sorted((self.folder / _PARTS).iterdir()):
            if not _PART.fullmatch(part.name):
                continue
            digest = part.name.split(".")[0]
            with self.claimed(digest) as mine:
                if mine:
                    shutil.rmtree(part, ignore_errors=True)
                    left.append(digest)
        return left

    def _make(self) -> None:
        if not self.exists():
            with adding(self.folder, STORE_FILE) as made:
                content = {"schema_version": 1, "command": COMMAND, "versions": versions()}
                write_json(made / STORE_FILE, content)
        for folder in (self.cases, self.folder / _PARTS):
            folder.mkdir(exist_ok=True)
        if not (self.folder / _LOCKS).exists():  # closing it releases all its locks
            (self.folder / _LOCKS).touch()

    def check_versions(self) -> None:
        """Check that the cases of the store were computed with the installed versions.

        Raises
        ------
        InputError : the cases were computed with other versions
        """
        stored, now = read_json(self.folder / STORE_FILE).get("versions", {}), versions()
        changed = [name for name in now if name != "python" and stored.get(name) != now[name]]
        if changed:
            changes = ", ".join(f"{name} {stored.get(name)} (now {now[name]})" for name in changed)
            raise InputError(
                f"{self.folder}: its cases were computed with {changes}; choose another -o DIR, "
                "so that all figures of a table have the same versions"
            )


def _is_own(case: Path) -> bool:
    """Return True if `twin` wrote all files of a case folder, even if they were changed later."""
    try:
        return case.is_dir() and foreign(case, read_manifest(case), changed=False) is None
    except (InputError, OSError):  # the manifest is invalid, or cannot be read
        return False


def write_failure(
    folder: Path, experiment: Experiment, kind: str, reason: str, trace: str = ""
) -> None:
    """Write the reason of the failure of a case, and the experiment, into a folder."""
    write_text(folder / EXPERIMENT_FILE, to_toml(experiment))
    content = {"schema_version": 1, "kind": kind, "failure": reason, "trace": trace}
    write_json(folder / FAILURE_FILE, content)
