"""Kill commands, and a sweep of real cases, again and again; compare with undisturbed runs.

100 kills of `measure`, `reconstruct`, `paper` and `sweep report`: see `benchmarks.killing`.

A study of 200 cases (coat albedo x exposure x noise draws, 242 x 183 pixels) runs on two workers.
At random moments, some of them during the start, `kill -9` ends the whole run with its workers, the
run only, or one worker; after the first two the same command is given again. Required:

- the final table is that of the undisturbed run, byte by byte;
- no case is computed again once it is in the store (`computed_twice`); cases that were being
  computed at a kill are (`begun_again`);
- after every kill the store has complete cases only (`partial_folders`).

Last line: {"commands": {"measure": 25, ...}, "mixed": 0, "unreadable": 0, ...,
"kills": 20, "cases": 200, "table_identical": true, "computed_twice": 0, ...}.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from benchmarks.killing import TARGETS, kill_commands
from twin.config import digest, load_experiment
from twin.config.study import Study
from twin.study.measuring import NOMINAL_CONDITIONS, CaseMeasurer, CaseResult
from twin.study.record import StudyRecord
from twin.study.store import Store
from twin.study.sweep import sweep
from twin.study.table import csv_text, read_table
from twin.study.workers import local_workers

BASE = {"camera.binning": 4, "camera.width_px": 968, "camera.height_px": 732}
LOG = "KILL_LOG"
WAYS = ("everything", "everything", "run", "worker")


class Logged(CaseMeasurer):
    """Measures, and logs when each case starts."""

    def __call__(self, experiment, conditions=NOMINAL_CONDITIONS) -> CaseResult:
        """Measure one case."""
        with Path(os.environ[LOG]).open("a") as file:
            file.write(f"{digest(experiment)} {time.time()}\n")
        return super().__call__(experiment, conditions)


def record_of(quick: bool) -> StudyRecord:
    """Return the study: 200 cases, or 40."""
    albedo = {"path": "coating.base_albedo", "values": [0.2, 0.3, 0.4, 0.5, 0.6]}
    level = {"path": "camera.auto_level", "values": [0.5, 0.6, 0.7, 0.8]}
    study = Study(name="kill", base="x", axis=(albedo, level), repeats=2 if quick else 10)
    return StudyRecord(study, load_experiment("examples/slab_balls", BASE))


def main() -> int:
    """Kill, compare and print one JSON line; return the exit code, 0 if all is as required."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="8 kills; 40 cases and 5 kills")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", choices=(*TARGETS, "study"), help="only these")
    parser.add_argument("--kills", type=int, help="of the commands; default: 100")
    parser.add_argument("--sweep", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.sweep:
        sweep(record_of(options.quick), options.sweep, local_workers(2), make_measurer=Logged)
        return 0
    figures: dict[str, object] = {}
    with tempfile.TemporaryDirectory() as name:
        scratch, kills = Path(name), options.kills or (8 if options.quick else 100)
        only = options.only or (*TARGETS, "study")
        if names := [name for name in TARGETS if name in only]:
            figures |= kill_commands(scratch / "commands", kills, options.seed, names)
        if "study" in only:
            figures |= killed_and_compared(scratch, options.quick, random.Random(options.seed))
    print(json.dumps(figures))
    faults = ("mixed", "unreadable", "computed_twice", "partial_folders")
    return int(any(map(figures.get, faults)) or not figures.get("table_identical", True))


def killed_and_compared(scratch: Path, quick: bool, rng: random.Random) -> dict:
    """Run the study undisturbed and killed; return the figures of both."""
    kills, total = (5, 40) if quick else (20, 200)
    log = scratch / "log"
    begin(scratch / "whole", scratch / "log_whole", quick).wait()
    ways, partial, start = Counter(), 0, time.perf_counter()
    run = begin(scratch / "killed", log, quick)
    for number in range(kills):
        wait_a_while(run, scratch / "killed", total, kills - number, rng)
        if run.poll() is not None:
            break
        way = kill(run, rng.choice(WAYS))
        ways[way] += 1
        partial += partial_folders(scratch / "killed")
        if way != "worker":
            run.wait()
            run = begin(scratch / "killed", log, quick)
    code = run.wait()
    begun = [line.split() for line in log.read_text().splitlines()]
    published = {path.name: path.stat().st_ctime for path in (scratch / "killed/cases").iterdir()}
    return {
        "kills": ways.total(),
        "cases": len(published),
        "table_identical": code == 0
        and csv_text(read_table(scratch / "killed")) == csv_text(read_table(scratch / "whole")),
        "computed_twice": sum(float(when) > published[name] for name, when in begun),
        "begun_again": len(begun) - len({name for name, _ in begun}),
        "partial_folders": partial,
        "ways": dict(ways),
        "seconds": round(time.perf_counter() - start),
    }


def begin(folder: Path, log: Path, quick: bool) -> subprocess.Popen:
    """Start the sweep, or continue it, in a process group of its own."""
    command = [sys.executable, __file__, "--sweep", str(folder), *(["--quick"] if quick else [])]
    # Python warns of shared memory that killed processes did not release.
    environment = os.environ | {LOG: str(log), "PYTHONWARNINGS": "ignore::UserWarning"}
    return subprocess.Popen(command, env=environment, start_new_session=True)


def wait_a_while(
    run: subprocess.Popen, folder: Path, total: int, kills_left: int, rng: random.Random
) -> None:
    """Wait for a random number of further cases, or in 20 % of the calls for a random time."""
    done = finished(folder)
    more = rng.randint(0, 2 * (total - done) // (kills_left + 1))
    until = time.monotonic() + (rng.uniform(0.0, 6.0) if rng.random() < 0.2 else 600.0)
    while run.poll() is None and finished(folder) < done + more and time.monotonic() < until:
        time.sleep(0.002)
    time.sleep(rng.uniform(0.0, 0.5))


def kill(run: subprocess.Popen, way: str) -> str:
    """Kill in a given way; return the way that was possible."""
    workers = workers_of(run.pid)
    if way == "worker" and workers:
        os.kill(workers[0], signal.SIGKILL)
    elif way == "everything":
        os.killpg(run.pid, signal.SIGKILL)
    else:
        way = "run"
        run.kill()
    return way


def workers_of(pid: int) -> list[int]:
    """Process ids of a run's workers."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    named = {int(child): Path(f"/proc/{child}/cmdline").read_bytes() for child in children}
    return [child for child, command in named.items() if b"spawn_main" in command]


def finished(folder: Path) -> int:
    """Count the cases that a reader can list."""
    return len(Store(folder).finished())


def partial_folders(folder: Path) -> int:
    """Count the listed folders that are no complete case."""
    names = Store(folder).finished()
    return sum("metrics" not in (Store(folder).read(name) or {}) for name in names)


if __name__ == "__main__":
    sys.exit(main())
