"""Index of a store in SQLite: state and figures of every case, for quick reading.

The folders of the cases are authoritative. The index is updated from them whenever it is opened to
be read. Each row has a digest of its content and of size and time of its source files. If the
digest differs, the files are read again. A missing or damaged index is built again. If it cannot be
written, cases are read from their folders. SQLite's write-ahead log is not used, because it needs
shared memory, and several hosts may share a store.
"""

import hashlib
import json
import os
import sqlite3
from collections.abc import Iterable, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from reconstruction.errors import InputError
from reconstruction.reading import is_regular, read_json
from twin.manifest import MANIFEST_FILE, is_ours, read_manifest
from twin.output import RESULT_FILE
from twin.results.figures import Metrics
from twin.study.store import FAILURE_FILE, TIMINGS_FILE, Store
from twin.study.worker import Report

INDEX_FILE = "index.sqlite"
DAMAGED = "damaged"
_WAIT_S = 60.0
_TABLE = (
    "CREATE TABLE IF NOT EXISTS checked (digest TEXT PRIMARY KEY, state TEXT NOT NULL, "
    "reason TEXT NOT NULL, seconds REAL NOT NULL, figures TEXT NOT NULL, mark TEXT NOT NULL)"
)


@dataclass(frozen=True)
class Entry:
    """State and figures of one case in the index.

    A damaged case is never entered; its folder is read each time.

    Attributes
    ----------
    digest : name of the case
    state : "done", "failed", "unsaved" or `DAMAGED`
    reason : reason of a failure; empty if the case is done
    seconds : run time of the case, s
    figures : figures of the result by name; empty without a result
    """

    digest: str
    state: str
    reason: str
    seconds: float
    figures: Metrics


class Index:
    """The index of one store; several processes may enter cases at the same time."""

    def __init__(self, store: Store) -> None:
        self._store, self._path = store, store.folder / INDEX_FILE

    def enter(self, reports: Sequence[Report]) -> None:
        """Enter the results of a batch of cases into the index.

        Results that cannot be entered now (full disk, damaged index) are entered when the index is
        read next.
        """
        entries = [
            Entry(r.digest, r.state, r.reason, r.seconds, {})
            if r.state == "unsaved"
            else entry_of(self._store, r.digest)
            for r in reports
            if r.state not in ("elsewhere", "known")
        ]
        self._try_to_write([entry for entry in entries if entry is not None])

    def entries(self) -> dict[str, Entry]:
        """Return the entries of all cases by digest, after an update from the folders."""
        known = self._known()
        there = self._store.finished()
        stale = {d for d, e in known.items() if d not in there and e.state != "unsaved"}
        new = [d for d in there if d not in known or known[d].state == "unsaved"]
        fresh = [e for e in (entry_of(self._store, d) for d in sorted(new)) if e is not None]
        self._try_to_write(fresh, stale)
        entries = known | {entry.digest: entry for entry in fresh}
        return {digest: entry for digest, entry in entries.items() if digest not in stale}

    def _connection(self) -> sqlite3.Connection:
        connection = sqlite3.connect(self._path, timeout=_WAIT_S)
        connection.execute("PRAGMA synchronous=NORMAL")
        connection.execute(_TABLE)
        return connection

    def _known(self) -> dict[str, Entry]:
        try:
            return self._read()
        except sqlite3.OperationalError:  # index in use, or disk full or read-only
            return {}
        except (sqlite3.DatabaseError, ValueError):
            with suppress(OSError):
                self._path.unlink()
            return {}

    def _read(self) -> dict[str, Entry]:
        with closing(self._connection()) as connection:
            rows = connection.execute(
                "SELECT digest, state, reason, seconds, figures, mark FROM checked"
            )
            return {
                row[0]: Entry(row[0], row[1], row[2], row[3], json.loads(row[4]))
                for *row, mark in rows
                if mark == _mark(self._store, row)
            }

    def _try_to_write(self, entries: Sequence[Entry], stale: Iterable[str] = ()) -> None:
        with suppress(sqlite3.Error):
            self._write([entry for entry in entries if entry.state != DAMAGED], stale)

    def _write(self, entries: Iterable[Entry], stale: Iterable[str] = ()) -> None:
        contents = [
            (e.digest, e.state, e.reason, e.seconds, json.dumps(e.figures)) for e in entries
        ]
        rows = [(*row, _mark(self._store, row)) for row in contents]
        gone = [(digest,) for digest in stale]
        if not rows and not gone:
            return
        with closing(self._connection()) as connection, connection:
            connection.executemany("INSERT OR REPLACE INTO checked VALUES (?, ?, ?, ?, ?, ?)", rows)
            connection.executemany("DELETE FROM checked WHERE digest = ?", gone)


def _mark(store: Store, row: Sequence[Any]) -> str:
    """Return a digest of a row of the index and of size and time of the row's source files."""
    folder, parts = store.path_of(str(row[0])), list[Any](row)
    for name in (RESULT_FILE, FAILURE_FILE, TIMINGS_FILE, MANIFEST_FILE):
        with suppress(OSError, ValueError):
            state = (folder / name).stat()
            parts += [name, state.st_size, state.st_mtime_ns]
    return hashlib.blake2b(json.dumps(parts).encode(), digest_size=16).hexdigest()


def entry_of(store: Store, digest: str) -> Entry | None:
    """Read the entry of a case from its folder; return None if there is no folder.

    If a file is unreadable, the state of the case is `DAMAGED`, and the reason names the file.
    """
    folder = store.path_of(digest)
    if not os.path.lexists(folder):
        return None
    try:
        return _whole(folder, digest)
    except (InputError, OSError) as error:
        return Entry(digest, DAMAGED, f"{error}; run twin sweep again", 0.0, {})


def _whole(folder: Path, digest: str) -> Entry:
    seconds = _part(folder / TIMINGS_FILE, "case", float, {"case": 0.0})
    known = read_manifest(folder)
    for name in (RESULT_FILE, FAILURE_FILE):
        path = folder / name
        if not is_regular(path):
            continue
        if not is_ours(folder, name, known):
            raise InputError(f"{path}: was changed after it was written")
        if name == RESULT_FILE:
            return Entry(digest, "done", "", seconds, _part(path, "metrics", dict))
        return Entry(digest, "failed", _part(path, "failure", str), seconds, {})
    raise InputError(f"{folder}: holds neither {RESULT_FILE} nor {FAILURE_FILE}")


def _part(path: Path, key: str, kind: type, absent: dict[str, Any] | None = None) -> Any:
    """Return the value at `key` of a JSON file; `absent` is the content if there is no file."""
    content = read_json(path) if absent is None or is_regular(path) else absent
    if not isinstance(content.get(key), kind):
        raise InputError(f"{path}: has no '{key}'")
    return content[key]
