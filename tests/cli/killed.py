"""Runs that are killed at each of their operations on files, one after the other.

    python -m tests.cli.killed HOW FOLDER

HOW is `new` (no earlier result), `replaced` or `added`. A child of this process, which has one
thread, ends itself by SIGKILL just before its n-th renaming, removal, opening for writing or new
folder, for n from 1 until it ends without being killed. Prints a JSON line for each n: the files in
the folder, the files after the next reader, and additional files after the next run.
"""

import json
import os
import shutil
import signal
import sys
from collections.abc import Callable, Mapping
from itertools import count
from pathlib import Path

from twin.manifest import MANIFEST_FILE
from twin.output import adding, end_exchange, output_folder, write_json

EARLIER = {"report": "first", "figures/a": "1", "old/b": "1"}
LATER = {"report": "second", "figures/a": "2", "new/c": "2"}
NEXT = {"report": "third"}
_CHANGES = ("os.rename", "os.remove", "os.mkdir", "os.rmdir")


def put(folder: Path, texts: Mapping[str, str]) -> None:
    """Write files of a result."""
    for name, text in texts.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)


def write(out: Path, texts: Mapping[str, str]) -> None:
    """Make, or replace, a result."""
    with output_folder(out) as folder:
        put(folder, texts)
        write_json(folder / "result.json", texts)


def add(out: Path) -> None:
    """Add to a result."""
    with adding(out, *LATER) as folder:
        put(folder, LATER)


def contents(folder: Path) -> dict[str, str]:
    """Return every file that is not hidden, except the manifest."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    named = {str(path.relative_to(folder)): path for path in files if path.name != MANIFEST_FILE}
    return {name: path.read_text() for name, path in named.items() if not name.startswith(".")}


def is_killed_at(number: int, work: Callable[[], None]) -> bool:
    """Run in a child that kills itself before its n-th operation; True if it was killed."""
    child = os.fork()
    if child == 0:
        left = number

        def hook(event: str, arguments: tuple[object, ...]) -> None:
            nonlocal left
            writes = event == "open" and bool(int(arguments[2] or 0) & (os.O_WRONLY | os.O_RDWR))
            if event not in _CHANGES and not writes:
                return
            left -= 1
            if left == 0:
                os.kill(os.getpid(), signal.SIGKILL)

        sys.addaudithook(hook)
        work()
        os._exit(0)
    ended = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if ended not in (0, -signal.SIGKILL):
        raise RuntimeError(f"ended by {ended}")
    return ended != 0


def main(how: str, place: Path) -> None:
    """Kill, read and run again until a run is not killed."""
    out = place / "out"
    for number in count(1):
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        if how != "new":
            write(out, EARLIER)
        if not is_killed_at(number, lambda: add(out) if how == "added" else write(out, LATER)):
            break
        at_once = contents(out)
        end_exchange(out)
        read = contents(out)
        write(out, NEXT)
        paths = {str(path.relative_to(place)) for path in place.rglob("*")}
        left = sorted(paths - {"out", *(f"out/{name}" for name in (*NEXT, "result.json"))})
        print(json.dumps({"at_once": at_once, "read": read, "left": left}))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
