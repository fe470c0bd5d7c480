"""Commands that are killed while they write, and what whoever comes next finds.

Each command writes one of two results, A or B. B is begun on a folder that holds nothing, or A, in
a forked child, and killed: at a random moment of its usual time, or before a random one of its
changes to files (renaming, removal, new folder, opening for writing), which falls more often into
the exchange of files. After each kill the folder must hold A or B as an undisturbed run writes
them, every file with the digest of its manifest, and `twin report` must read it. After some kills
B runs to its end: the folder then holds B, and no working folder is left in it or beside it.
"""

import hashlib
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from benchmarks.fuzz import command, preload
from benchmarks.fuzz_stock import SMALL
from twin.manifest import MANIFEST_FILE, files_of, is_ours, read_manifest
from twin.output import end_exchange

_CHANGES = ("os.rename", "os.remove", "os.mkdir", "os.rmdir")
_MOST_IN_A_ROW = 5


@dataclass(frozen=True)
class KillTarget:
    """A command and its two results.

    Attributes
    ----------
    first, second : arguments that lead to A and B; {out} stands for the folder
    grows : A is there before, since the command adds to it
    prepared : folder below the stock that `grows` begins from
    judged : what of the folder is A's or B's, at its top; empty: all
    is_read : `twin report` reads the result
    """

    first: tuple[str, ...]
    second: tuple[str, ...]
    grows: bool = False
    prepared: str = ""
    judged: tuple[str, ...] = ()
    is_read: bool = False


_OUT = ("-o", "{out}")
# Drawn pictures are three quarters of its time, and exchanged like any other file.
_MEASURE = ("measure", "slab.toml", *_OUT, "--no-report", "-s")
_HARDNESS = ("paper", *_OUT, "--only", "hardness", "--trials")
TARGETS = {
    "measure": KillTarget(
        (*_MEASURE, "camera.auto_level=0.5"),
        (*_MEASURE, "camera.auto_level=0.6"),
        is_read=True,
    ),
    "reconstruct": KillTarget(
        ("reconstruct", "capture", *_OUT),
        ("reconstruct", "capture", *_OUT, "--filter-taps", "0"),
    ),
    "paper": KillTarget((*_HARDNESS, "2"), (*_HARDNESS, "3")),
    "sweep report": KillTarget(
        ("sweep", "report", "{out}"),
        ("sweep", "report", "{out}", "-b", "good_share"),
        grows=True,
        prepared="swept",
        judged=("report.html", "figures"),
    ),
}


@dataclass(frozen=True)
class KilledRun:
    """What a kill left: "nothing", "earlier", "later" or "mixed"; see `KillTarget` for the rest."""

    at_once: str
    read: str
    is_readable: bool


# ---- one command -------------------------------------------------------------------------------


class CommandKiller:
    """Kills one command again and again, below a folder of its own."""

    def __init__(self, target: KillTarget, stock: Path, scratch: Path, seed: int) -> None:
        self._target, self._scratch = target, scratch
        self._out, self._rng = scratch / "here" / "out", random.Random(seed)
        shutil.copytree(stock, scratch, dirs_exist_ok=True)
        self._earlier = self._undisturbed(target.first, "first")
        self._later = self._undisturbed(target.second, "second")
        started = time.monotonic()
        again = self._undisturbed(target.second, "again")
        self._seconds = time.monotonic() - started
        # Wall-clock times differ from run to run.
        self._kept = {n for n, one in self._later.items() if again.get(n) == one}
        self._changes = int((scratch / "changes").read_text())

    def kills(self, count: int) -> Iterator[KilledRun]:
        """Kill so often; now and then the run comes to its end in between.

        Raises
        ------
        RuntimeError : a run after a kill does not end with its result alone in the folder
        """
        done = 0
        while done < count:
            self._reset(with_earlier=self._target.grows or self._rng.random() < 0.7)
            for _ in range(min(self._rng.randint(1, _MOST_IN_A_ROW), count - done)):
                if self._killed():
                    done += 1
                    yield self._judged()
            self._ends_well()

    def _undisturbed(self, arguments: tuple[str, ...], name: str) -> dict[str, str]:
        self._reset(with_earlier=self._target.grows and name != "first")
        if self._run(arguments) != 0:
            raise RuntimeError(f"{' '.join(arguments)}: does not run undisturbed")
        kept = self._scratch / name
        shutil.copytree(self._out, kept, symlinks=True)
        return self._digests(kept)

    def _reset(self, *, with_earlier: bool) -> None:
        shutil.rmtree(self._out.parent, ignore_errors=True)
        self._out.parent.mkdir()
        source = self._scratch / ("first" if with_earlier else self._target.prepared or "first")
        if with_earlier or self._target.grows:
            shutil.copytree(source, self._out, symlinks=True)

    def _killed(self) -> bool:
        """Start the second run and kill it; tell whether it was not quicker."""
        before = after = None
        if self._rng.random() < 0.5:
            after = self._rng.uniform(0.0, self._seconds)
        else:
            before = self._rng.randint(1, self._changes)
        return self._run(self._target.second, before, after) == -signal.SIGKILL

    def _run(
        self, arguments: tuple[str, ...], before: int | None = None, after_s: float | None = None
    ) -> int:
        """Run in a forked child; kill it before a change to files, or after a time."""
        child = os.fork()
        if child == 0:
            _be_child(self._scratch, [one.format(out=self._out) for one in arguments], before)
        if after_s is not None:
            time.sleep(after_s)
            os.kill(child, signal.SIGKILL)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        with suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
        return code

    def _judged(self) -> KilledRun:
        at_once = self._state()
        end_exchange(self._out)
        read, is_readable = self._state(), True
        if self._target.is_read and read != "nothing":
            # A copy: the report would be added.
            copied = shutil.copytree(self._out, self._scratch / "read", dirs_exist_ok=True)
            is_readable = self._run(("report", str(copied))) == 0
            shutil.rmtree(copied)
        return KilledRun(at_once, read, is_readable)

    def _state(self) -> str:
        found, known = self._digests(self._out), read_manifest(self._out)
        named = known.lines if known else {}
        whole = all(is_ours(self._out, path, known) for path in found if path in named)
        for name, wanted in (("earlier", self._earlier), ("later", self._later)):
            kept = {path: wanted[path] for path in wanted if path in self._kept}
            there = {path: one for path, one in found.items() if path in self._kept}
            if whole and there == kept and found.keys() == wanted.keys():
                return name
        return "mixed" if found else "nothing"

    def _digests(self, folder: Path) -> dict[str, str]:
        """Return what is judged, working folders and the manifest apart."""
        tops = self._target.judged
        names = [name for name in files_of(folder) if name != MANIFEST_FILE]
        names = [one for one in names if not tops or one.split("/")[0] in tops]
        names = [one for one in names if not one.startswith(".")]
        return {one: hashlib.sha256((folder / one).read_bytes()).hexdigest() for one in names}

    def _ends_well(self) -> None:
        if self._run(self._target.second) != 0 or self._state() != "later":
            raise RuntimeError(f"{' '.join(self._target.second)}: not run again after a kill")
        hidden = [path for path in self._out.parent.rglob("*") if path.name.endswith(".part")]
        hidden += list(self._out.glob(".parts/*"))
        if hidden:
            raise RuntimeError(f"{' '.join(self._target.second)}: {hidden[0].name} is left")


def _be_child(folder: Path, arguments: list[str], before: int | None) -> None:
    code, changes = 1, 0

    def hook(event: str, given: tuple[object, ...]) -> None:
        nonlocal changes
        writes = event == "open" and bool(int(given[2] or 0) & (os.O_WRONLY | os.O_RDWR))  # type: ignore[call-overload]
        if event not in _CHANGES and not writes:
            return
        changes += 1
        if changes == before:
            os.killpg(0, signal.SIGKILL)

    try:
        os.setsid()
        os.chdir(folder)
        for number in (1, 2):
            os.dup2(os.open("said", os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), number)
        sys.addaudithook(hook)
        code = command(arguments)
        (folder / "changes").write_text(str(changes))
    finally:
        os._exit(code)


# ---- all commands ------------------------------------------------------------------------------


def make_kill_stock(folder: Path, run: Path) -> None:
    """Make what the commands read: a small experiment, a capture, a store of two cases."""
    from twin.config import load_experiment
    from twin.config.loading import to_toml

    folder.mkdir(parents=True)
    (folder / "slab.toml").write_text(to_toml(load_experiment("examples/slab_ball", SMALL)))
    shutil.copytree(Path(__file__).parents[1] / "docs" / "example_capture", folder / "capture")
    axis = '[[axis]]\npath = "coating.base_albedo"\nvalues = [0.3, 0.5]\n'
    (folder / "study.toml").write_text(f'name = "kill"\nbase = "slab.toml"\n{axis}')
    sweep = (str(run), "sweep", "study.toml", "-o", "swept", "-j", "1")
    subprocess.run(sweep, cwd=folder, check=True, capture_output=True)


def kill_commands(
    scratch: Path, kills: int, seed: int, names: Sequence[str] = tuple(TARGETS)
) -> dict[str, object]:
    """Kill every named command an equal number of times; returns the figures of all."""
    make_kill_stock(scratch / "stock", Path(sys.executable).with_name("twin"))
    preload()
    counts, found = Counter[str](), list[KilledRun]()
    for number, name in enumerate(names):
        place = scratch / name.replace(" ", "_")
        killer = CommandKiller(TARGETS[name], scratch / "stock", place, 1000 * seed + number)
        for one in killer.kills(kills // len(names) + (number < kills % len(names))):
            counts[name] += 1
            found.append(one)
            print(name, one, flush=True)
    states = Counter(one.read for one in found)
    return {
        "commands": dict(counts),
        **{name: states[name] for name in ("nothing", "earlier", "later", "mixed")},
        "ended_by_the_next": sum(one.at_once == "mixed" != one.read for one in found),
        "unreadable": sum(not one.is_readable for one in found),
    }
