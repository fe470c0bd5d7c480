"""Commands that are killed while they write, and the state of the folder after each kill.

Each command writes one of two results, A or B. B is started on a folder that is empty, or has A, in
a forked child, and killed: at a random moment of its usual run time, or before a random change of
files (renaming, removal, new folder, opening for writing), which is more often during the exchange
of files. After each kill the folder must have A or B as an undisturbed run writes them, every file
with the digest of its manifest, and `twin report` must read it. After some kills B runs to its end:
the folder then has B, and no working folder remains in it or next to it.
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

from benchmarks._forked import command, forked, preload
from benchmarks.fuzz_stock import CAPTURE, SMALL
from twin.manifest import MANIFEST_FILE, files_of, is_ours, read_manifest
from twin.output import end_exchange

_CHANGES = ("os.rename", "os.remove", "os.mkdir", "os.rmdir")
_MOST_IN_A_ROW = 5


@dataclass(frozen=True)
class KillTarget:
    """A command and its two results.

    Attributes
    ----------
    first, second : command lines that write A and B; {out} is the folder
    prepared : folder below the stock to which A is added before B; empty: B replaces A
    judged : files and folders at the top of the result that are compared; empty: all
    is_read : `twin report` reads the result
    """

    first: str
    second: str
    prepared: str = ""
    judged: tuple[str, ...] = ()
    is_read: bool = False


# Drawn pictures take 75 % of the run time, and are exchanged as all other files.
_MEASURE = "measure slab.toml -o {out} --no-report -s camera.auto_level="
_HARDNESS = "paper -o {out} --only hardness --trials "
_RECONSTRUCT, _REPORT = "reconstruct capture -o {out}", "sweep report {out}"
_PAGES = ("report.html", "figures")
TARGETS = {
    "measure": KillTarget(f"{_MEASURE}0.5", f"{_MEASURE}0.6", is_read=True),
    "reconstruct": KillTarget(_RECONSTRUCT, f"{_RECONSTRUCT} --filter-taps 0"),
    "paper": KillTarget(f"{_HARDNESS}2", f"{_HARDNESS}3"),
    "sweep report": KillTarget(_REPORT, f"{_REPORT} -b good_share", "swept", _PAGES),
}


@dataclass(frozen=True)
class KilledRun:
    """State after a kill, before and after the exchange of files is completed.

    A state is "nothing", "earlier", "later" or "mixed".
    """

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
        # Files with wall-clock times differ from run to run and are not compared.
        self._kept = {n for n, digest in self._later.items() if again.get(n) == digest}
        self._changes = int((scratch / "changes").read_text())

    def kills(self, count: int) -> Iterator[KilledRun]:
        """Kill so often; after one to five kills the command runs to its end.

        Raises
        ------
        RuntimeError : a run after a kill does not end with its result only in the folder
        """
        done = 0
        while done < count:
            self._reset(with_earlier=bool(self._target.prepared) or self._rng.random() < 0.7)
            for _ in range(min(self._rng.randint(1, _MOST_IN_A_ROW), count - done)):
                if self._killed():
                    done += 1
                    yield self._judged()
            self._check_end()

    def _undisturbed(self, line: str, name: str) -> dict[str, str]:
        self._reset(with_earlier=bool(self._target.prepared) and name != "first")
        if self._run(line) != 0:
            raise RuntimeError(f"{line}: fails without a kill")
        kept = self._scratch / name
        shutil.copytree(self._out, kept, symlinks=True)
        return self._digests(kept)

    def _reset(self, *, with_earlier: bool) -> None:
        shutil.rmtree(self._out.parent, ignore_errors=True)
        self._out.parent.mkdir()
        source = "first" if with_earlier else self._target.prepared
        if source:
            shutil.copytree(self._scratch / source, self._out, symlinks=True)

    def _killed(self) -> bool:
        """Start the second run and kill it; return False if it ended before."""
        before = after = None
        if self._rng.random() < 0.5:
            after = self._rng.uniform(0.0, self._seconds)
        else:
            before = self._rng.randint(1, self._changes)
        return self._run(self._target.second, before, after) == -signal.SIGKILL

    def _run(self, line: str, before: int | None = None, after_s: float | None = None) -> int:
        """Run in a forked child; kill it before a change of files, or after a time."""
        arguments = [part.format(out=self._out) for part in line.split()]
        child = forked(lambda: _counted(arguments, before), self._scratch)
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
            # A copy, since the report would be added.
            copied = shutil.copytree(self._out, self._scratch / "read", dirs_exist_ok=True)
            is_readable = self._run(f"report {copied}") == 0
            shutil.rmtree(copied)
        return KilledRun(at_once, read, is_readable)

    def _state(self) -> str:
        observed, known = self._digests(self._out), read_manifest(self._out)
        named = known.lines if known else {}
        whole = all(is_ours(self._out, path, known) for path in observed if path in named)
        for name, expected in (("earlier", self._earlier), ("later", self._later)):
            kept = {path: expected[path] for path in expected if path in self._kept}
            there = {path: digest for path, digest in observed.items() if path in self._kept}
            if whole and there == kept and observed.keys() == expected.keys():
                return name
        return "mixed" if observed else "nothing"

    def _digests(self, folder: Path) -> dict[str, str]:
        """Return the digests of the judged files, without working folders and the manifest."""
        tops = self._target.judged
        names = [name for name in files_of(folder) if name != MANIFEST_FILE and name[0] != "."]
        names = [name for name in names if not tops or name.split("/")[0] in tops]
        return {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in names}

    def _check_end(self) -> None:
        line = self._target.second
        if self._run(line) != 0 or self._state() != "later":
            raise RuntimeError(f"{line}: does not run after a kill")
        hidden = [path for path in self._out.parent.rglob("*") if path.name.endswith(".part")]
        hidden += list(self._out.glob(".parts/*"))
        if hidden:
            raise RuntimeError(f"{line}: {hidden[0].name} remains")


def _counted(arguments: list[str], before: int | None) -> int:
    """Run a command in a child; count its changes of files, and kill it before one of them."""
    changes = 0

    def hook(event: str, given: tuple[object, ...]) -> None:
        nonlocal changes
        writes = event == "open" and bool(int(given[2] or 0) & (os.O_WRONLY | os.O_RDWR))  # type: ignore[call-overload]
        changes += event in _CHANGES or writes
        if changes == before and (event in _CHANGES or writes):
            os.killpg(0, signal.SIGKILL)

    sys.addaudithook(hook)
    code = command(arguments)
    Path("changes").write_text(str(changes))
    return code


# ---- all commands ------------------------------------------------------------------------------


def make_kill_stock(folder: Path, run: Path) -> None:
    """Make the inputs of the commands: a small experiment, a capture, a store of two cases."""
    from twin.config import load_experiment
    from twin.config.loading import to_toml

    folder.mkdir(parents=True)
    (folder / "slab.toml").write_text(to_toml(load_experiment("examples/slab_ball", SMALL)))
    shutil.copytree(CAPTURE, folder / "capture")
    axis = '[[axis]]\npath = "coating.base_albedo"\nvalues = [0.3, 0.5]\n'
    (folder / "study.toml").write_text(f'name = "kill"\nbase = "slab.toml"\n{axis}')
    sweep = (str(run), "sweep", "study.toml", "-o", "swept", "-j", "1")
    subprocess.run(sweep, cwd=folder, check=True, capture_output=True)


def kill_commands(
    scratch: Path, kills: int, seed: int, names: Sequence[str] = tuple(TARGETS)
) -> dict[str, object]:
    """Kill every named command an equal number of times; return the figures of all."""
    make_kill_stock(scratch / "stock", Path(sys.executable).with_name("twin"))
    preload()
    counts, runs = Counter[str](), list[KilledRun]()
    for number, name in enumerate(names):
        place = scratch / name.replace(" ", "_")
        killer = CommandKiller(TARGETS[name], scratch / "stock", place, 1000 * seed + number)
        for killed in killer.kills(kills // len(names) + (number < kills % len(names))):
            counts[name] += 1
            runs.append(killed)
            print(name, killed, flush=True)
    states = Counter(killed.read for killed in runs)
    return {
        "commands": dict(counts),
        **{name: states[name] for name in ("nothing", "earlier", "later", "mixed")},
        "ended_by_the_next": sum(killed.at_once == "mixed" != killed.read for killed in runs),
        "unreadable": sum(not killed.is_readable for killed in runs),
    }
