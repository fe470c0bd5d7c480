"""Manifests: which files of a folder were written by `twin`, so that nothing else is removed.

`twin-manifest.txt` opens with a comment that tells format, version and kind of the folder; then
comes a line `SHA256  PATH` per file, as `sha256sum -c twin-manifest.txt` checks them. A line is
entered before its file is put there. A file counts as ours while it has the content of one of its
lines: what was edited since is the user's.
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
    """What a folder's manifest says.

    Attributes
    ----------
    kind : `result`, replaced as a whole, or the command that goes on in it
    lines : digests of each path's contents that were written; paths are relative, with slashes
    """

    kind: str
    lines: dict[str, set[str]]

    @property
    def folders(self) -> set[str]:
        """Folders that hold one of the files."""
        return {str(above) for path in self.lines for above in PurePosixPath(path).parents}


def read_manifest(folder: Path) -> Manifest | None:
    """Read the manifest of a folder; None when it has none.

    Raises
    ------
    InputError : it was written by a version that this one does not know, or cannot be read
    """
    path = folder / MANIFEST_FILE
    if not os.path.lexists(path):
        return None
    text = read_bytes(path).decode("utf-8", errors="surrogateescape")
    head, *rest = text.split("\n")
    found = _HEAD.fullmatch(head)
    if found is None:
        return None
    if int(found["version"]) != _VERSION:
        raise InputError(f"{path}: has version {found['version']}, known is {_VERSION}")
    lines: dict[str, set[str]] = {}
    for line in filter(None, map(_LINE.fullmatch, rest)):
        if _is_below(line["path"]):
            lines.setdefault(line["path"], set()).add(line["digest"])
    return Manifest(found["kind"], lines)


def _is_below(path: str) -> bool:
    """Tell whether a path stays within its folder: nothing beside it is ours."""
    parts = PurePosixPath(path)
    return not parts.is_absolute() and ".." not in parts.parts


def files_of(folder: Path) -> list[str]:
    """Return the relative paths of all files below a folder, with slashes, sorted."""
    found = (path for path in folder.rglob("*") if not path.is_dir())
    return sorted(path.relative_to(folder).as_posix() for path in found)


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
    """Add lines that it lacks to the manifest of a folder, and start it where there is none."""
    with (folder / MANIFEST_FILE).open("a+b", buffering=0) as file:
        with suppress(OSError):  # a file system without locks
            lock_file(file.fileno(), wait=True)
        file.seek(0)
        there = file.readall()
        known = set(there.decode("utf-8", errors="surrogateescape").split("\n"))
        head = [] if there else [f"# fringe-twin manifest {_VERSION}: {kind}"]
        torn = "\n" if there and not there.endswith(b"\n") else ""  # killed while it wrote
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
    """Tell whether a file below a folder has the content that was written."""
    file, digests = folder / path, known.lines.get(path, set()) if known else set()
    return bool(digests) and not file.is_symlink() and file.is_file() and _digest(file) in digests


def ours(folder: Path, paths: Sequence[str], known: Manifest | None) -> set[str]:
    """Return those of some files below a folder that have the content that was written."""
    told = _side_by_side(lambda path: is_ours(folder, path, known), paths)
    return {path for path, is_own in zip(paths, told, strict=True) if is_own}


def foreign(
    folder: Path, known: Manifest | None, names: Collection[str] = (), *, changed: bool = True
) -> str | None:
    """Return in words the first thing in a folder that `twin` did not write; None without any.

    Parameters
    ----------
    names : look only at these entries of the folder; by default at all
    changed : a file that was written, but changed since, counts too
    """
    found = list(_found(folder, "", known, names))
    own = ours(folder, found, known)
    for path in found:
        is_changed = known is not None and path in known.lines
        if path not in own and (changed or not is_changed):
            return f"{path}, changed since it was written" if is_changed else path
    return None


def _found(
    root: Path, below: str, known: Manifest | None, names: Collection[str] = ()
) -> Iterator[str]:
    """Yield what is in a folder; of folders of its own, what is in them."""
    for entry in sorted(os.scandir(root / below), key=lambda entry: entry.name):
        path = f"{below}{entry.name}"
        if (names and entry.name not in names) or (not below and _is_own_mark(entry)):
            continue
        if entry.is_dir(follow_symlinks=False) and known and path in known.folders:
            yield from _found(root, f"{path}/", known)
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
