"""Manifests: the files of a folder that `twin` wrote; only these files are removed.

The first line of `twin-manifest.txt` is a comment with format, version and kind of the folder. Each
further line is `SHA256  PATH` of a file, in the format of `sha256sum -c twin-manifest.txt`. A line
is written before its file. A file counts as ours if its content has the digest of one of its lines:
a file that was edited since is the user's.
"""

import hashlib
import io
import os
import re
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TypeVar

from reconstruction.errors import InputError
from reconstruction.machine import threads
from reconstruction.reading import read_bytes
from reconstruction.writing import write_bytes
from twin.locks import lock_file
from twin.working import is_working

_File = TypeVar("_File", Path, str)
_Read = TypeVar("_Read")

MANIFEST_FILE = "twin-manifest.txt"
_HEAD = re.compile(r"# fringe-twin manifest (?P<version>\d+): (?P<kind>\w+)")
_VERSION = 1
_LINE = re.compile(r"(?P<digest>[0-9a-f]{64})  (?P<path>.+)")
# An empty file system of this kind is not quite empty.
_OF_THE_SYSTEM = {"lost+found"}


@dataclass(frozen=True)
class Manifest:
    """Content of a folder's manifest.

    Attributes
    ----------
    kind : `result`, replaced as a whole, or the command that adds files to the folder
    lines : digests of the written contents of each path; paths are relative, with slashes
    """

    kind: str
    lines: dict[str, set[str]]

    @property
    def folders(self) -> set[str]:
        """Folders that contain any of the files."""
        return {str(above) for path in self.lines for above in PurePosixPath(path).parents}


def read_manifest(folder: Path) -> Manifest | None:
    """Read the manifest of a folder; None if there is none.

    Raises
    ------
    InputError : it was written by a version that this one does not know, or cannot be read
    """
    path = folder / MANIFEST_FILE
    if not os.path.lexists(path):
        return None
    text = read_bytes(path).decode("utf-8", errors="surrogateescape")
    head, *rest = text.split("\n")
    header = _HEAD.fullmatch(head)
    if header is None:
        return None
    if int(header["version"]) != _VERSION:
        raise InputError(f"{path}: has version {header['version']}, known is {_VERSION}")
    lines: dict[str, set[str]] = {}
    for line in filter(None, map(_LINE.fullmatch, rest)):
        if _is_below(line["path"]):
            lines.setdefault(line["path"], set()).add(line["digest"])
    return Manifest(header["kind"], lines)


def _is_below(path: str) -> bool:
    """Return True if a path is inside its folder: files outside are never ours."""
    parts = PurePosixPath(path)
    return not parts.is_absolute() and ".." not in parts.parts


def files_of(folder: Path) -> list[str]:
    """Return the relative paths of all files below a folder, with slashes, sorted."""
    files = (path for path in folder.rglob("*") if not path.is_dir())
    return sorted(path.relative_to(folder).as_posix() for path in files)


def manifest_lines(folder: Path) -> list[str]:
    """Return a line for every file below a folder."""
    paths = files_of(folder)
    digests = _side_by_side(_digest, [folder / path for path in paths])
    return [f"{digest}  {path}" for digest, path in zip(digests, paths, strict=True)]


def write_manifest(path: Path, kind: str, lines: Sequence[str]) -> None:
    """Write a new manifest."""
    text = "\n".join([f"# fringe-twin manifest {_VERSION}: {kind}", *lines, ""])
    write_bytes(path, text.encode("utf-8", errors="surrogateescape"))


def enter(folder: Path, kind: str, lines: Sequence[str]) -> None:
    """Add missing lines to the manifest of a folder; create the manifest if there is none."""
    with (folder / MANIFEST_FILE).open("a+b", buffering=0) as file:
        with suppress(OSError):  # a file system without locks
            lock_file(file.fileno(), wait=True)
        file.seek(0)
        there = file.readall()
        known = set(there.decode("utf-8", errors="surrogateescape").split("\n"))
        head = [] if there else [f"# fringe-twin manifest {_VERSION}: {kind}"]
        torn = "\n" if there and not there.endswith(b"\n") else ""  # killed while writing
        added = "".join(f"{line}\n" for line in (*head, *lines) if line not in known)
        try:
            _write_all(file, f"{torn}{added}".encode("utf-8", errors="surrogateescape"))
        except OSError:
            file.truncate(len(there))
            if not there:
                (folder / MANIFEST_FILE).unlink()
            raise


def _write_all(file: io.FileIO, left: bytes) -> None:
    while left:
        left = left[file.write(left) :]


def is_ours(folder: Path, path: str, known: Manifest | None) -> bool:
    """Return True if a file below a folder has the content that `twin` wrote."""
    file, digests = folder / path, known.lines.get(path, set()) if known else set()
    return bool(digests) and not file.is_symlink() and file.is_file() and _digest(file) in digests


def ours(folder: Path, paths: Sequence[str], known: Manifest | None) -> set[str]:
    """Return the files, of those given, that have the content that `twin` wrote."""
    flags = _side_by_side(lambda path: is_ours(folder, path, known), paths)
    return {path for path, is_own in zip(paths, flags, strict=True) if is_own}


def foreign(
    folder: Path, known: Manifest | None, names: Collection[str] = (), *, changed: bool = True
) -> str | None:
    """Return a text on the first entry of a folder that `twin` did not write; None if all are ours.

    Parameters
    ----------
    names : check only these entries of the folder; default: all
    changed : also report files that `twin` wrote and that were changed since
    """
    paths = list(_entries(folder, "", known, names))
    own = ours(folder, paths, known)
    for path in paths:
        is_changed = known is not None and path in known.lines
        if path not in own and (changed or not is_changed):
            return f"{path}, changed since it was written" if is_changed else path
    return None


def _entries(
    root: Path, below: str, known: Manifest | None, names: Collection[str] = ()
) -> Iterator[str]:
    """Yield the entries of a folder; of its folders with known files, their entries instead."""
    for entry in sorted(os.scandir(root / below), key=lambda entry: entry.name):
        path = f"{below}{entry.name}"
        if (names and entry.name not in names) or (not below and _is_own_mark(entry)):
            continue
        if entry.is_dir(follow_symlinks=False) and known and path in known.folders:
            yield from _entries(root, f"{path}/", known)
        else:
            yield path


def _is_own_mark(entry: "os.DirEntry[str]") -> bool:
    if entry.name == MANIFEST_FILE:
        return entry.is_file(follow_symlinks=False) and (
            entry.stat().st_size == 0 or read_manifest(Path(entry.path).parent) is not None
        )
    return entry.name in _OF_THE_SYSTEM or is_working(Path(entry.path))


def _side_by_side(read: Callable[[_File], _Read], files: Sequence[_File]) -> list[_Read]:
    with ThreadPoolExecutor(threads()) as pool:
        return list(pool.map(read, files))


def _digest(file: Path) -> str:
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()
