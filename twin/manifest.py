"""Manifests: lists of the files in a folder that `twin` wrote; only these files are removed.

The first line of `twin-manifest.txt` is a comment with the format, its version and the kind of the
folder. Each further line is `SHA256  PATH` of a file, in the format of `sha256sum -c
twin-manifest.txt`. The line of a file is written before the file. A file is taken as written by
`twin` if its SHA-256 digest is in one of the lines of its path. A file that was edited afterwards
is therefore the user's file.
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
# Folder that the operating system itself puts into an empty file system.
_OF_THE_SYSTEM = {"lost+found"}


@dataclass(frozen=True)
class Manifest:
    """Content of the manifest of a folder.

    Attributes
    ----------
    kind : `result` for a folder that is replaced as a whole; else the name of the command that adds
        files to the folder
    lines : SHA-256 digests (hexadecimal) of all contents that `twin` wrote to each path; paths are
        relative to the folder, with slashes
    """

    kind: str
    lines: dict[str, set[str]]

    @property
    def folders(self) -> set[str]:
        """Relative paths of all folders that contain a listed file, directly or in subfolders."""
        return {str(above) for path in self.lines for above in PurePosixPath(path).parents}


def read_manifest(folder: Path) -> Manifest | None:
    """Read the manifest of a folder; return None if there is no manifest.

    Raises
    ------
    InputError : the manifest cannot be read, or its format has another version
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
    """Return True if a relative path of a manifest is inside the folder, as `twin` writes it."""
    parts = PurePosixPath(path)
    return not parts.is_absolute() and ".." not in parts.parts


def files_of(folder: Path) -> list[str]:
    """Return the sorted paths of all files below a folder, relative to it, with slashes."""
    files = (path for path in folder.rglob("*") if not path.is_dir())
    return sorted(path.relative_to(folder).as_posix() for path in files)


def manifest_lines(folder: Path) -> list[str]:
    """Return the manifest line `SHA256  PATH` of every file below a folder."""
    paths = files_of(folder)
    digests = _side_by_side(_digest, [folder / path for path in paths])
    return [f"{digest}  {path}" for digest, path in zip(digests, paths, strict=True)]


def write_manifest(path: Path, kind: str, lines: Sequence[str]) -> None:
    """Write a new manifest with the kind of its folder and its lines."""
    text = "\n".join([f"# fringe-twin manifest {_VERSION}: {kind}", *lines, ""])
    write_bytes(path, text.encode("utf-8", errors="surrogateescape"))


def enter(folder: Path, kind: str, lines: Sequence[str]) -> None:
    """Append missing lines to the manifest of a folder; create the manifest if there is none."""
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
    """Return True if the file `path` below a folder has a content that `twin` wrote."""
    file, digests = folder / path, known.lines.get(path, set()) if known else set()
    return bool(digests) and not file.is_symlink() and file.is_file() and _digest(file) in digests


def ours(folder: Path, paths: Sequence[str], known: Manifest | None) -> set[str]:
    """Return those of the given relative paths at which files are as `twin` wrote them."""
    flags = _side_by_side(lambda path: is_ours(folder, path, known), paths)
    return {path for path, is_own in zip(paths, flags, strict=True) if is_own}


def foreign(
    folder: Path, known: Manifest | None, names: Collection[str] = (), *, changed: bool = True
) -> str | None:
    """Return a text on the first entry of a folder that `twin` did not write; None if none.

    Parameters
    ----------
    names : names of the entries of the folder that are checked; default: all
    changed : True: also report files that `twin` wrote and that were changed afterwards
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
    """Yield the relative paths of the entries below a folder, without the twin's own marks.

    A subfolder that contains files of the manifest is replaced by its entries.
    """
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
