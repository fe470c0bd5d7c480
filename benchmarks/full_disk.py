"""Fill the disk to random levels while results are written, on a busy machine.

`twin measure` (with report) replaces an earlier result, or makes a first one, on a file system of
which a random part is free, or under a random limit of the length of a file, while two other
processes compute. One run in `--whole-every` is the whole command; in the other runs, forks of this
process, the measurement itself is that of an earlier run. Required of each run:

- it succeeds, or ends with exit code 1 (`crashed`: no other code and no signal);
- then it prints one line after the stages (`not_one_line`: 0);
- an earlier result is unchanged, byte by byte (`earlier_lost`: 0);
- no other file remains, hidden or not (`left_behind`: 0).

Needs the right to mount a tmpfs; otherwise all runs have a limit of the length of a file.
Last line: {"runs": 200, "whole": 30, "full": 154, "fitted": 46, "crashed": 0, ...}.
"""

import argparse
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from benchmarks._forked import command, forked, preload
from benchmarks.fuzz_stock import SMALL

EXPERIMENT = ("examples/slab_ball", *(f"--set={path}={value}" for path, value in SMALL.items()))
BUSY = "while True: sum(range(1_000_000))"
NEIGHBOURS = 2
_ROOM = 1.15  # free at most, in sizes of a result: some runs have enough room


@dataclass(frozen=True)
class FillLevel:
    """Bytes that are free on the disk, or that the longest file may have."""

    free_bytes: int | None = None
    file_bytes: int | None = None


@dataclass(frozen=True)
class FilledRun:
    """Exit code (negative after a signal), lines, and files of a run on a full disk."""

    code: int
    lines: tuple[str, ...]
    earlier: dict[str, bytes]
    later: dict[str, bytes]

    @property
    def faults(self) -> list[str]:
        """Names of the requirements that the run does not meet."""
        lines = [line for line in self.lines if not line.endswith("...")]
        lost = any(self.later.get(name) != content for name, content in self.earlier.items())
        checks = {
            "crashed": self.code not in (0, 1),
            "not_one_line": self.code == 1 and not (len(lines) == 1 and "no room left" in lines[0]),
            "earlier_lost": self.code != 0 and lost,
            "left_behind": self.code != 0 and bool(self.later.keys() - self.earlier.keys()),
        }
        return [name for name, is_true in checks.items() if is_true]


def main() -> None:
    """Fill, judge and print one JSON line; the exit code is 0 if all is as required."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="12 runs, none of the whole command")
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--whole-every", type=int, default=6, help="0: none")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    runs, every = (12, 0) if options.quick else (options.runs, options.whole_every)
    with tempfile.TemporaryDirectory() as name, busy_neighbours(), small_disk(Path(name)) as place:
        filler = Filler(Path(name) / "stock", place, random.Random(options.seed))
        counts = Counter[str]()
        for number in range(runs):
            is_whole = every > 0 and number % every == 0
            done = filler.run(is_whole)
            outcome = {0: "fitted", 1: "full"}.get(done.code, "")
            counts.update([*done.faults, "whole" if is_whole else "", outcome])
            print(number, done.code, *done.faults, *done.lines[-1:], flush=True)
    names = ("whole", "full", "fitted", "crashed", "not_one_line", "earlier_lost", "left_behind")
    print(json.dumps({"runs": runs, **{name: counts[name] for name in names}}))
    sys.exit(any(counts[name] for name in names[3:]))


@contextmanager
def busy_neighbours() -> Iterator[None]:
    """Keep the cores busy."""
    children = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(NEIGHBOURS)]
    try:
        yield
    finally:
        for child in children:
            child.kill()
            child.wait()


@contextmanager
def small_disk(scratch: Path) -> Iterator[Path | None]:
    """Yield a file system that may be filled; None if mounting is not permitted."""
    place = scratch / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=1g", "tmpfs", str(place)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        yield None
        return
    try:
        yield place
    finally:
        subprocess.run(["umount", "--lazy", str(place)], check=True)


class Filler:
    """Runs a measurement again and again on a disk that is nearly full."""

    def __init__(self, stock: Path, disk: Path | None, rng: random.Random) -> None:
        self._stock, self._disk, self._rng = stock, disk, rng
        self._place = disk or stock.with_name("limited")
        self._place.mkdir(exist_ok=True)
        program = "import sys; from twin.cli import main; main()"
        self._command = [sys.executable, "-c", program, "measure", *EXPERIMENT, "-o"]
        subprocess.run([*self._command, str(stock)], check=True)
        sizes = [path.stat().st_size for path in stock.rglob("*") if path.is_file()]
        self._size, self._longest = sum(sizes), max(sizes)
        preload()
        self._measured = stored(stock)

    def run(self, is_whole: bool) -> FilledRun:
        """Measure at a random level."""
        out = self._place / "out"
        for entry in self._place.iterdir():
            shutil.rmtree(entry) if entry.is_dir() else entry.unlink()
        if self._rng.random() < 0.5:
            shutil.copytree(self._stock, out)
        earlier, level = contents(out), self._level()
        with self._filled(level):
            code, text = self._whole(out, level) if is_whole else self._forked(out, level)
        later = {name: file for name, file in contents(self._place).items() if name != "filler"}
        prefixed = {f"out/{name}": file for name, file in earlier.items()}
        return FilledRun(code, tuple(text.splitlines()), prefixed, later)

    def _level(self) -> FillLevel:
        share = _ROOM * self._rng.random()
        if self._disk is None or self._rng.random() < 0.3:
            return FillLevel(file_bytes=int(share * self._longest))
        return FillLevel(free_bytes=int(share * self._size))

    @contextmanager
    def _filled(self, level: FillLevel) -> Iterator[None]:
        filler = self._place / "filler"
        if level.free_bytes is not None:
            left = shutil.disk_usage(self._place).free - level.free_bytes
            with filler.open("wb") as file:
                os.posix_fallocate(file.fileno(), 0, left)
        yield
        filler.unlink(missing_ok=True)

    def _whole(self, out: Path, level: FillLevel) -> tuple[int, str]:
        streams: Any = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
        command = [*self._command, str(out)]
        done = subprocess.run(command, check=False, preexec_fn=lambda: limit(level), **streams)
        return done.returncode, done.stderr

    def _forked(self, out: Path, level: FillLevel) -> tuple[int, str]:
        def action() -> int:
            import twin.pipeline.methods

            twin.pipeline.methods.measure_whole = lambda *_: self._measured
            limit(level)
            return command(["measure", *EXPERIMENT, "-o", str(out)])

        child = forked(action, self._stock.parent)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        return code, self._stock.with_name("stderr").read_text()


def limit(level: FillLevel) -> None:
    """Limit the files of this process and ignore the signal of the limit."""
    if level.file_bytes is not None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (level.file_bytes, level.file_bytes))


def contents(folder: Path) -> dict[str, bytes]:
    """Return every file below a folder with its bytes, including hidden files."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def stored(folder: Path) -> Any:
    """Read a measurement; the white frame is replaced by any image of the camera's size."""
    from reconstruction.capture.folder import read_capture
    from twin.results.folder import CAPTURE_FOLDER, read_measurement

    measurement = read_measurement(folder)
    capture = read_capture(folder / CAPTURE_FOLDER)
    white = {capture.patterns.index("white").start: measurement.truth.depth_mm}
    return replace(measurement, images=replace(measurement.images, stored=capture, frames=white))


if __name__ == "__main__":
    main()
