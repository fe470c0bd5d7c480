"""Signals at random instants of commands: time to the end, exit code, files and processes left.

Each command runs undisturbed first, which gives its run time. SIGINT, SIGTERM or SIGHUP is then
sent at a random instant of that time, counted from the first import. Required: the process ends
within `LIMIT_S`, by exit code 130, 143 or 129 (before its first statement: by the signal itself);
no working folder and no process of its session remain; at most one line about the signal is
printed and no traceback.

`--stopped` stops a worker (SIGSTOP) before each signal. Last line: {"signals": n, "late": 0,
"lost": 0, "files": 0, "orphans": 0, "tracebacks": 0, "slowest_s": ..., "load": ...}.
"""

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from benchmarks._harness import print_figures, quick_parser

LIMIT_S = 2.0
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_CAMERA = "-s camera.binning=4 -s camera.width_px=484 -s camera.height_px=368"
_SLAB = f"{_CAMERA} -s press.solver_pitch_mm=0.2"
_FEM = "-s mechanics.tetrahedra=800"
_STUDY = """name = "signals"
base = "examples/slab_ball"
set = { camera = { binning = 4, width_px = 484, height_px = 368 } }
[[axis]]
path = "coating.base_albedo"
values = [0.3, 0.4, 0.5, 0.6]
"""
_SCAN = """name = "signals"
base = "plate.toml"
seed = 3
[grid]
columns = 2
rows = 1
step_x_mm = 12.0
step_y_mm = 7.0
[map]
pitch_mm = 0.3
"""
_PLATE = """use = "scenes/scans/relief_plate"
[camera]
binning = 4
"""
COMMANDS = {
    "press slab": f"press examples/slab_ball {_SLAB} -o out",
    "press sheet": "press examples/wrapped_balls -s press.cell_mm=0.3 -o out",
    "press pad": f"press examples/domed_pad {_FEM} -o out",
    "press fem": f"press examples/slab_ball -s mechanics.model=fem {_FEM} -o out",
    "render": f"render examples/slab_ball {_SLAB} -o out",
    "measure": f"measure examples/slab_ball {_SLAB} -o out",
    "calibrate": "calibrate examples/slab_ball -s camera.binning=4 -o out",
    "sweep": "sweep study.toml -j 2 -o out",
    "dataset": "dataset datasets/contact_denoising -n 6 -j 2 -o out",
    "scan": "scan scan.toml -o out",
    "describe": "describe {capture} -o described.toml",
    "reconstruct": "reconstruct {capture} -o out",
}


@dataclass(frozen=True)
class SignalledRun:
    """Outcome of a run that got a signal.

    Attributes
    ----------
    at_s : instant of the signal after the start
    answer_s : time from the signal to the end of the process
    """

    command: str
    signal_name: str
    at_s: float
    answer_s: float
    code: int
    fault: str
    message: str


def main() -> int:
    """Send the signals; return 1 if a run ended late, by another code, or left something."""
    parser = quick_parser(__doc__, "one signal per command")
    parser.add_argument("--only", nargs="+", choices=COMMANDS)
    parser.add_argument("--signals", type=int, default=6, help="per command")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--stopped", action="store_true", help="stop a worker before the signal")
    chosen = parser.parse_args()
    rng, runs = random.Random(chosen.seed), list[SignalledRun]()
    for name in chosen.only or COMMANDS:
        for run in signalled(name, 1 if chosen.quick else chosen.signals, rng, chosen.stopped):
            print(run, flush=True)
            runs.append(run)
    faults = Counter(run.fault for run in runs)
    slowest_s = max(run.answer_s for run in runs)
    names = ("late", "lost", "files", "orphans", "tracebacks")
    counts = {name: faults[name] for name in names}
    print_figures(
        {"signals": len(runs), **counts, "slowest_s": slowest_s, "load": os.getloadavg()[0]}
    )
    return int(any(counts.values()))


def signalled(name: str, count: int, rng: random.Random, stopped: bool) -> Iterator[SignalledRun]:
    """Run a command undisturbed, and then `count` times with a signal."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "study.toml").write_text(_STUDY)
        (folder / "scan.toml").write_text(_SCAN)
        (folder / "plate.toml").write_text(_PLATE)
        for warm in (True, False):  # the first run compiles kernels
            start = time.monotonic()
            child = _started(name, folder / ("warm" if warm else "whole"))
            if child.wait() != 0:
                raise RuntimeError(f"{name}: fails without a signal: {_text(folder)}")
            whole_s = time.monotonic() - start
        for number in range(count):
            at_s = rng.uniform(0.0, whole_s)
            yield _one(name, folder / str(number), at_s, rng.choice(SIGNALS), stopped)


def _started(name: str, folder: Path) -> "subprocess.Popen[bytes]":
    """Start a command in its own session and folder; its messages are in the file `stderr`."""
    folder.mkdir()
    for source in folder.parent.glob("*.toml"):
        (folder / source.name).write_bytes(source.read_bytes())
    root = Path(__file__).parents[1]
    line = COMMANDS[name].format(capture=root / "docs" / "example_capture")
    return subprocess.Popen(
        [sys.executable, "-c", "from twin.cli import main; main()", *line.split()],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(root)},
        stdout=subprocess.DEVNULL,
        stderr=(folder / "stderr").open("wb"),
        start_new_session=True,
        preexec_fn=_heed_signals,
    )


def _heed_signals() -> None:
    """Undo that a shell starts a background job with SIGINT ignored, or nohup with SIGHUP."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_DFL)


def _one(
    name: str, folder: Path, at_s: float, number: signal.Signals, stopped: bool
) -> SignalledRun:
    child = _started(name, folder)
    time.sleep(at_s)
    if stopped:
        for worker in [pid for pid in _session(child.pid) if pid != child.pid][-1:]:
            os.kill(worker, signal.SIGSTOP)
    sent = time.monotonic()
    child.send_signal(number)
    code = child.wait()
    answer_s = time.monotonic() - sent
    time.sleep(1.0)  # children end with their parent, or soon after
    remaining = _session(child.pid)
    text = _text(folder)
    # A run may end by itself before the signal is delivered.
    is_lost = code not in (128 + number, -number) and not (code == 0 and answer_s < LIMIT_S)
    faults = {
        "orphans": bool(remaining),
        "lost": is_lost,
        "files": any(folder.rglob("*.part")),
        "tracebacks": "Traceback" in text or text.count("ended by") > 1,
        "late": answer_s > LIMIT_S,
    }
    for pid in remaining:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    fault = next((name for name, is_so in faults.items() if is_so), "")
    last = (text.splitlines() or [""])[-1][-160:]
    return SignalledRun(name, number.name, round(at_s, 2), round(answer_s, 2), code, fault, last)


def _session(leader: int) -> list[int]:
    """Return the process ids of a session that have not ended."""
    processes = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError):
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
                if int(fields[3]) == leader and fields[0] != "Z":
                    processes.append(int(entry.name))
    return processes


def _text(folder: Path) -> str:
    files = sorted(folder.rglob("stderr"))
    return files[-1].read_text(errors="replace") if files else ""


if __name__ == "__main__":
    sys.exit(main())
