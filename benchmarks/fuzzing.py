"""Damaged and hostile input for every command: how it is made, run, and judged.

A case is a seed: it copies a sound input into a folder of its own, damages it, and names the
command line that reads it. The command runs in a forked child, so that a crash or a hang affects
that case only. Files that no command may change surround the output folder. A case is bad if

- a traceback is printed (`traceback`), a signal ends the process (`crash`), or the process exceeds
  its processor time or stops without ending (`hang`);
- an output folder has no result, or a working folder remains next to it (`partial_output`);
- a surrounding file was changed, added or removed (`foreign_change`);
- the exit code is undocumented (`exit_code`), or an error has no message of a few lines
  (`unreported`).
"""

import hashlib
import os
import random
import shutil
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from benchmarks._forked import forked
from benchmarks.damage import damage_file

LIMIT_S = 20.0
OUT = "kept/out"
"""Where commands write, below the case's folder; `kept` has the files that may not change."""
_EXIT_CODES = (0, 1, 2, 3)
_MOST_LINES, _MOST_TURNS, _POLL_S, _STILL_S = 40, 20, 0.005, 2.0


@dataclass(frozen=True)
class FuzzOutcome:
    """How a case ended.

    Attributes
    ----------
    end : "reported" (an error message), "done", or the kind of misbehaviour
    message : the last line on stderr
    seconds : wall-clock time
    """

    seed: int
    target: str
    damage: str
    end: str
    message: str
    seconds: float

    @property
    def is_bad(self) -> bool:
        """Return True if the program misbehaved."""
        return self.end not in ("reported", "done")


# ---- targets -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class FuzzTarget:
    """An input that is copied and damaged, and the command that reads it.

    Attributes
    ----------
    source : file or folder below the stock
    command : command line; {input} and {out} are paths, {refusing} is a folder of other files
    damaged : patterns of the files below the input that may be damaged; empty: the input itself
    leads_to_result : whether success writes a result folder
    """

    source: str
    command: str
    damaged: str = ""
    leads_to_result: bool = True


_MESH = "press slab_mesh.toml -s specimen.file={input} -o {out}"
_SIZES = "--camera-size 640 480 --projector-size 912 1140"
_STEREO = f"import-calibration {{input}} {_SIZES} -o {{out}}"
_BALL = "--ball {input} --ball-diameter-mm 8 --layer {input}/layer.toml"
_CAPTURE, _RECONSTRUCT = "*.toml *.yaml *.png", "reconstruct {input} -o {out}"
_PHOTOMETRIC = "reconstruct --photometric {input}/press.toml -o {out}"
_PROBLEM = "identify {input} -o {refusing}"
_BOARD = "calibrate slab.toml --board {input} -o {refusing}"
_INPUTS = "uncertainty slab.toml --inputs {input} --dry-run -o {out}"
_RESULT = "*.json *.toml *.nc *.exr *.ply"
TARGETS = {
    "experiment": FuzzTarget("slab.toml", "press {input} -o {out}"),
    "trials": FuzzTarget("sheet.toml", "uncertainty {input} --dry-run -o {out}", "", False),
    "mesh": FuzzTarget("part.stl", _MESH),
    "mesh_ply": FuzzTarget("part.ply", _MESH),
    "mesh_obj": FuzzTarget("part.obj", _MESH),
    "inputs": FuzzTarget("inputs.toml", _INPUTS, "", False),
    "study": FuzzTarget("study.toml", "sweep {input} --dry-run -o {out}", "", False),
    "problem": FuzzTarget("problem.toml", _PROBLEM),
    "capture": FuzzTarget("capture", _RECONSTRUCT, _CAPTURE),
    "capture_toml": FuzzTarget("capture", _RECONSTRUCT, "*.toml *.yaml"),
    "capture_exr": FuzzTarget("capture_exr", _RECONSTRUCT, "*.exr"),
    "capture_tiff": FuzzTarget("capture_tiff", _RECONSTRUCT, "*.tiff"),
    "frames": FuzzTarget("listed", "decode {input} -o {out}", "*.toml"),
    "frames_png": FuzzTarget("listed", "decode {input} -o {out}", "*.png"),
    "describe": FuzzTarget("bare", "describe {input} -o found.toml", "*.png", False),
    "patterns": FuzzTarget("slab.toml", "patterns {input} -o {out}"),
    "adopt": FuzzTarget("capture", "adopt {input} --no-report -o {out}", _CAPTURE),
    "adopt_layer": FuzzTarget(
        "capture_pressed", f"adopt {{input}} {_BALL} --no-report -o {{out}}", "layer.toml"
    ),
    "colours": FuzzTarget("colours", _PHOTOMETRIC, "*.toml *.png *.npz"),
    "stereo_yaml": FuzzTarget("stereo.yml", _STEREO),
    "stereo_xml": FuzzTarget("stereo.xml", _STEREO),
    "stereo_mat": FuzzTarget("stereo.mat", _STEREO),
    "capture_nc": FuzzTarget("rendered", _RECONSTRUCT, "capture/*"),
    "result": FuzzTarget("measured", "report {input}", _RESULT, False),
    "evaluate": FuzzTarget("measured", "evaluate {input} plane", "*.nc *.json *.toml", False),
    "store": FuzzTarget("swept", "sweep report {input}", "**/*", False),
    "store_table": FuzzTarget("swept", "sweep table {input}", "**/*", False),
    "store_dry": FuzzTarget("swept", "sweep study.toml --dry-run -o {input}", "**/*", False),
    "board": FuzzTarget("board.toml", _BOARD),
}
_NAMES = (
    "", ".", "..", "/", "/dev/zero", "/dev/null", "fifo", "x" * 300, "x" * 5000, "[bold]x[/bold]",
    "$\\alpha", "-", "--", "slab.toml/x", "\udcff", "scenes/../../x", "~x",
)  # fmt: skip
_SETTINGS = (
    "a", "=", "a=", "camera=1", "camera.binning=nan", "camera.binning=" + "9" * 5000,
    "camera.binning=[" * 50, "links.a==b", "seed=true", "seed=1e400", "specimen.kind=none",
    "elastomer.thickness_mm=absent", "name=[red]", "name=" + "n" * 400, ".=1", "..=1",
    "press.depth_mm='= press.depth_mm'", "use=./slab.toml", "a.b.c.d.e=1", "specimen=absent",
)  # fmt: skip
_HOSTILE = (
    "press {name} -o {out}", "press slab.toml -s {setting} -o {out}", "press slab.toml -o {name}",
    "reconstruct {name} -o {out}", "compensate {name} -o {out}", "report {name}",
    "sweep {name} --dry-run -o {out}", "sweep report {name}", "identify {name} -o {out}",
    "evaluate {name} plane", "keys {name}", "decode {name} -o {out}",
    "describe {name} -o found.toml", "describe . -o {name}", "patterns {name} -o {out}",
    "init {name}", "uncertainty {name} --dry-run -o {out}", "{name} {name}",
)  # fmt: skip


def argument_case(rng: random.Random) -> list[str]:
    """Return a hostile command line on sound files."""
    values = {"{name}": rng.choice(_NAMES), "{setting}": rng.choice(_SETTINGS)}
    return [values.get(part, part) for part in rng.choice(_HOSTILE).split()]


# ---- one case ----------------------------------------------------------------------------------


def run_case(
    seed: int,
    stock: Path,
    scratch: Path,
    command: Callable[[list[str]], int],
    limit_s: float = LIMIT_S,
    *,
    sound: str = "",
) -> FuzzOutcome:
    """Make, run and judge a case.

    Parameters
    ----------
    seed : decides everything
    stock : sound inputs, see `make_stock`
    scratch : an empty folder for the case
    command : runs a command line in the forked child, and returns its exit code
    limit_s : processor time, and wall-clock time after which a case that uses none hangs
    sound : run this target on its sound input instead, which it must accept
    """
    rng = random.Random(seed)
    target = sound or rng.choice((*TARGETS, "arguments"))
    shutil.copytree(stock / "kept", scratch / "kept")
    os.mkfifo(scratch / "fifo")
    for name in ("slab.toml", "slab_mesh.toml", "study.toml"):
        shutil.copy(stock / name, scratch / name)
    if target == "arguments":
        arguments, leads = argument_case(rng), True
        damage = " ".join(arguments)[:80]
    else:
        chosen = TARGETS[target]
        given = scratch / Path(chosen.source).name
        damage = _copied_and_damaged(stock / chosen.source, given, chosen, None if sound else rng)
        arguments = chosen.command.replace("{input}", given.name).split()
        leads = chosen.leads_to_result
    places = {"{out}": OUT, "{refusing}": "kept"}
    arguments = [places.get(part, part) for part in arguments]
    before = _digests(scratch / "kept")
    end, message, seconds = run_forked(arguments, scratch, command, limit_s)
    if end in ("reported", "done"):
        end = "partial_output" if _left_behind(scratch / OUT, end == "done" and leads) else end
        end = end if _digests(scratch / "kept") == before else "foreign_change"
    return FuzzOutcome(seed, target, damage, end, message, seconds)


def _copied_and_damaged(
    source: Path, given: Path, target: FuzzTarget, rng: random.Random | None
) -> str:
    if source.is_file():
        shutil.copy(source, given)
        return damage_file(given, rng) if rng else ""
    shutil.copytree(source, given, symlinks=True)
    patterns = target.damaged.split()
    files = sorted({f for pattern in patterns for f in given.glob(pattern) if f.is_file()})
    return damage_file(rng.choice(files), rng) if rng else ""


def _digests(folder: Path) -> dict[str, str]:
    """Return the digests of all files of a folder except those of the output folder."""
    files = {path.relative_to(folder): path for path in sorted(folder.rglob("*")) if path.is_file()}
    return {
        name.as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for name, path in files.items()
        if "out" not in name.parts[:1]
    }


def _left_behind(out: Path, leads_to_result: bool) -> bool:
    """Return True if a working folder remains, or an output folder without its result."""
    hidden = any(path.name.startswith(".") for path in out.parent.iterdir())
    return hidden or (leads_to_result and out.exists() and not (out / "result.json").is_file())


def run_forked(
    arguments: list[str], folder: Path, command: Callable[[list[str]], int], limit_s: float
) -> tuple[str, str, float]:
    """Run a command line; return how it ended, the last line on stderr, and wall-clock seconds."""
    start = time.monotonic()
    status = _waited(forked(lambda: command(arguments), folder), limit_s)
    seconds = time.monotonic() - start
    text = (folder / "stderr").read_text(encoding="utf-8", errors="replace")
    code = None if status is None else os.waitstatus_to_exitcode(status)
    return (*ended(code, text), seconds)


def ended(code: int | None, text: str) -> tuple[str, str]:
    """Return how a command ended and its last line, from its exit code and messages.

    Parameters
    ----------
    code : exit code; negative: the number of the signal that ended it; None: it was stopped
    text : all that it wrote to stderr
    """
    lines = text.splitlines()
    last = text.strip().splitlines()[-1][:300] if text.strip() else ""
    if code is None:
        end, message = "hang", last
    elif code < 0:
        end, message = "crash", f"signal {-code}: {last}"
    elif "Traceback (most recent call last)" in text:
        end, message = "traceback", last
    elif code not in _EXIT_CODES:
        end, message = "exit_code", f"{code}: {last}"
    elif code and not (last and len(lines) <= _MOST_LINES):
        end, message = "unreported", f"{code}, {len(lines)} lines: {last}"
    else:
        end, message = ("reported" if code else "done"), last
    return end, message


def _waited(child: int, limit_s: float) -> int | None:
    """Return the child's status; None if it was killed, with all processes that it started.

    It is killed after the time limit if it then uses no processor time, or has used up as much
    processor time: on a busy machine it may only have waited.
    """
    start = checked = time.monotonic()
    used_s = 0.0
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return status
        time.sleep(_POLL_S)
        now = time.monotonic()
        if now - start > limit_s and now - checked > _STILL_S:
            before_s, used_s, checked = used_s, _processor_s(child), now
            if used_s == before_s or used_s > limit_s or now - start > _MOST_TURNS * limit_s:
                break
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


def _processor_s(session: int) -> float:
    """Return the processor time of all processes of a session so far."""
    ticks = 0
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # the process has ended
            fields = path.read_text().rpartition(")")[2].split()
            ticks += (int(fields[11]) + int(fields[12])) * (int(fields[3]) == session)
    return ticks / os.sysconf("SC_CLK_TCK")
