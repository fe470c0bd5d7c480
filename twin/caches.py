"""Caches of compiled code on this machine: their folders and sizes, and how to clear them.

| cache | content | bounded by |
|---|---|---|
| numba | kernels of this project, by Numba | the number of kernels |
| Dr.Jit | kernels of the renderer, of all programs of this user | Dr.Jit, which removes old ones |
| backend | the tested library of the renderer, a JSON file | one entry per machine and setting |

A cache without entries costs a compilation. Files of another kind in the folders are not touched.
"""

import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import reconstruction

_PACKAGES = (Path(reconstruction.__file__).parent, Path(__file__).parent)
CLEAR = "twin doctor --clear"


@dataclass(frozen=True)
class CodeCache:
    """A cache: a name, the folders that may contain its files, and the patterns of these files."""

    name: str
    folders: tuple[Path, ...]
    patterns: tuple[str, ...]

    def files(self) -> Iterator[Path]:
        """Yield the files of the cache; also what is in the place of a file, such as a folder."""
        for folder in self.folders:
            for pattern in self.patterns:
                with suppress(OSError):
                    yield from sorted(folder.glob(pattern))

    def size_bytes(self) -> int:
        """Return the size of all files; those that end meanwhile count as 0."""
        total = 0
        for file in self.files():
            with suppress(OSError):
                total += file.lstat().st_size
        return total

    def clear(self) -> int:
        """Remove the files, and return their number; those that cannot be removed remain."""
        removed = 0
        for file in self.files():
            with suppress(OSError):
                if file.is_dir() and not file.is_symlink():
                    file.rmdir()
                else:
                    file.unlink()
                removed += 1
        return removed

    def strangers(self) -> list[Path]:
        """Return the folders that belong to another user than this one and the superuser."""
        user = os.geteuid() if hasattr(os, "geteuid") else 0  # not on Windows
        owners = {user, 0} if user else set()
        return [path for path in self.folders if owners and _owner(path) not in (None, *owners)]


def _owner(folder: Path) -> int | None:
    try:
        return folder.stat().st_uid
    except OSError:
        return None


def caches() -> tuple[CodeCache, ...]:
    """Return the caches of compiled code that the commands of this project use."""
    from twin.optics.backend import cache_file

    drjit = Path(os.environ.get("DRJIT_CACHE_DIR") or Path("~/.drjit").expanduser())
    stored = cache_file()
    return (
        CodeCache("numba cache", tuple(_numba_folders()), ("*.nbi", "*.nbc")),
        CodeCache("dr.jit cache", (drjit,), ("*.llvm.*bin", "*.cuda.*bin", "*.optix.*bin")),
        CodeCache("backend cache", (stored.parent,), (stored.name,)),
    )


def _numba_folders() -> Iterator[Path]:
    """Yield the existing folders of kernels: of each package folder, here or in a shared folder."""
    from numba.core.caching import _CacheLocator

    sources = {file.parent for package in _PACKAGES for file in package.rglob("*.py")}
    for folder in sorted(sources):
        named = _CacheLocator.get_suitable_cache_subpath(str(folder / "kernels.py"))
        places = (folder / "__pycache__", *(above / named for above in numba_folders()))
        yield from (place for place in places if place.is_dir())


def numba_folders() -> list[Path]:
    """Return the folders in which Numba makes a folder for each source folder, first choice first.

    They are used if the variable NUMBA_CACHE_DIR names one, or if the package is not writable.
    """
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())
    return [Path(chosen)] if chosen else [base / "numba"]
