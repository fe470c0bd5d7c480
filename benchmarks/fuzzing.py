"""Damaged and hostile input for every command: how it is made, run, and judged.

A case is a seed: it copies a sound input into a folder of its own, damages it, and names the
command line that reads it. It runs in a forked child, so that a crash or a hang costs that case
alone. Round the output folder stands a tree of canaries; a case is bad when

- a traceback is printed (`traceback`), a signal ends the process (`crash`), or it takes too much
  processor time or stands still (`hang`);
- an output folder is left without its result, or a working folder beside it (`partial_output`);
- a canary was changed, added or removed (`foreign_change`);
- the exit code is none of the documented ones (`exit_code`), or bad input is not told in a few
  lines (`not_told`).
"""

import hashlib
import io
import os
import random
import shutil
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from benchmarks.damage import damage_file

LIMIT_S = 20.0
_EXIT_CODES = (0, 1, 2, 3)
_MOST_LINES = 40
_POLL_S = 0.005
_STILL_S = 2.0
_MOST_TURNS = 20


@dataclass(frozen=True)
class FuzzOutcome:
    """How a case ended.

    Attributes
    ----------
    seed, target, damage : what was run on what
    end : "told" (refused in words), "done", or what was bad
    said : the last line on stderr
    seconds : wall clock
    """

    seed: int
    target: str
    damage: str
    end: str
    said: str
    seconds: float

    @property
    def is_bad(self) -> bool:
        """Tell whether the program misbehaved."""
        return self.end not in ("told", "done")


# ---- targets -----------------------------------------------------------------------------------

OUT = "kept/out"
"""Where commands write, below the case's folder; `kept` holds the canaries."""


@dataclass(frozen=True)
class FuzzTarget:
    """An input that is copied and damaged, and the command that reads it.

    Attributes
    ----------
    source : file or folder below the stock
    arguments : of the command; {input} and {out} stand for paths
    damaged : patterns of the files below the input that may be damaged; empty: the input itself
    leads_to_result : whether success leaves a result folder
    """

    source: str
    arguments: tuple[str, ...]
    damaged: tuple[str, ...] = ()
    leads_to_result: bool = True


_O = ("-o", "{out}")
_BALL = ("--ball", "{input}", "--ball-diameter-mm", "8", "--layer", "{input}/layer.toml")
_SIZES = ("--camera-size", "640", "480", "--projector-size", "912", "1140")
TARGETS = {
    "experiment": FuzzTarget("slab.toml", ("press", "{input}", *_O)),
    "trials": FuzzTarget("sheet.toml", ("uncertainty", "{input}", "--dry-run", *_O), (), False),
    "mesh": FuzzTarget("part.stl", ("press", "slab_mesh.toml", "-s", "specimen.file={input}", *_O)),
    "mesh_ply": FuzzTarget(
        "part.ply", ("press", "slab_mesh.toml", "-s", "specimen.file={input}", *_O)
    ),
    "mesh_obj": FuzzTarget(
        "part.obj", ("press", "slab_mesh.toml", "-s", "specimen.file={input}", *_O)
    ),
    "inputs": FuzzTarget(
        "inputs.toml",
        ("uncertainty", "slab.toml", "--inputs", "{input}", "--dry-run", *_O),
        leads_to_result=False,
    ),
    "study": FuzzTarget("study.toml", ("sweep", "{input}", "--dry-run", *_O), (), False),
    "problem": FuzzTarget("problem.toml", ("identify", "{input}", "-o", "{refusing}")),
    "capture": FuzzTarget(
        "capture", ("reconstruct", "{input}", *_O), ("*.toml", "*.yaml", "*.png")
    ),
    "capture_toml": FuzzTarget("capture", ("reconstruct", "{input}", *_O), ("*.toml", "*.yaml")),
    "capture_exr": FuzzTarget("capture_exr", ("reconstruct", "{input}", *_O), ("*.exr",)),
    "capture_tiff": FuzzTarget("capture_tiff", ("reconstruct", "{input}", *_O), ("*.tiff",)),
    "frames": FuzzTarget("listed", ("decode", "{input}", *_O), ("*.toml",)),
    "frames_png": FuzzTarget("listed", ("decode", "{input}", *_O), ("*.png",)),
    "describe": FuzzTarget("bare", ("describe", "{input}", "-o", "found.toml"), ("*.png",), False),
    "patterns": FuzzTarget("slab.toml", ("patterns", "{input}", *_O)),
    "adopt": FuzzTarget(
        "capture", ("adopt", "{input}", "--no-report", *_O), ("*.toml", "*.yaml", "*.png")
    ),
    "adopt_layer": FuzzTarget(
        "capture_pressed", ("adopt", "{input}", *_BALL, "--no-report", *_O), ("layer.toml",)
    ),
    "colours": FuzzTarget(
        "colours",
        ("reconstruct", "--photometric", "{input}/press.toml", *_O),
        ("*.toml", "*.png", "*.npz"),
    ),
    "stereo_yaml": FuzzTarget("stereo.yml", ("import-calibration", "{input}", *_SIZES, *_O)),
    "stereo_xml": FuzzTarget("stereo.xml", ("import-calibration", "{input}", *_SIZES, *_O)),
    "stereo_mat": FuzzTarget("stereo.mat", ("import-calibration", "{input}", *_SIZES, *_O)),
    "capture_nc": FuzzTarget("rendered", ("reconstruct", "{input}", *_O), ("capture/*",)),
    "result": FuzzTarget(
        "measured", ("report", "{input}"), ("*.json", "*.toml", "*.nc", "*.exr", "*.ply"), False
    ),
    "evaluate": FuzzTarget(
        "measured", ("evaluate", "{input}", "plane"), ("*.nc", "*.json", "*.toml"), False
    ),
    "store": FuzzTarget("swept", ("sweep", "report", "{input}"), ("**/*",), False),
    "store_table": FuzzTarget("swept", ("sweep", "table", "{input}"), ("**/*",), False),
    "store_dry": FuzzTarget(
        "swept", ("sweep", "study.toml", "--dry-run", "-o", "{input}"), ("**/*",), False
    ),
    "board": FuzzTarget(
        "board.toml", ("calibrate", "slab.toml", "--board", "{input}", "-o", "{refusing}")
    ),
}


def argument_case(rng: random.Random) -> list[str]:
    """Return a hostile command line on sound files."""
    name = rng.choice(
        ("", ".", "..", "/", "/dev/zero", "/dev/null", "fifo", "x" * 300, "x" * 5000,
         "[bold]x[/bold]", "$\\alpha", "-", "--", "slab.toml/x", "\udcff", "scenes/../../x", "~x")
    )  # fmt: skip
    setting = rng.choice(
        ("a", "=", "a=", "camera=1", "camera.binning=nan", "camera.binning=" + "9" * 5000,
         "camera.binning=[" * 50, "links.a==b", "seed=true", "seed=1e400", "specimen.kind=none",
         "elastomer.thickness_mm=absent", "name=[red]", "name=" + "n" * 400, ".=1", "..=1",
         "press.depth_mm='= press.depth_mm'", "use=./slab.toml", "a.b.c.d.e=1", "specimen=absent")
    )  # fmt: skip
    return rng.choice(
        (
            ["press", name, "-o", "{out}"],
            ["press", "slab.toml", "-s", setting, "-o", "{out}"],
            ["press", "slab.toml", "-o", name],
            ["reconstruct", name, "-o", "{out}"],
            ["compensate", name, "-o", "{out}"],
            ["report", name],
            ["sweep", name, "--dry-run", "-o", "{out}"],
            ["sweep", "report", name],
            ["identify", name, "-o", "{out}"],
            ["evaluate", name, "plane"],
            ["keys", name],
            ["decode", name, "-o", "{out}"],
            ["describe", name, "-o", "found.toml"],
            ["describe", ".", "-o", name],
            ["patterns", name, "-o", "{out}"],
            ["init", name],
            ["uncertainty", name, "--dry-run", "-o", "{out}"],
            [name, name],
        )
    )


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
    limit_s : wall clock after which it hangs, if it stands still; and processor time
    sound : run this target on its sound input instead, to see that it is taken
    """
    rng = random.Random(seed)
    target = sound or rng.choice((*TARGETS, "arguments"))
    shutil.copytree(stock / "kept", scratch / "kept")
    os.mkfifo(scratch / "fifo")
    for name in ("slab.toml", "slab_mesh.toml", "study.toml"):
        shutil.copy(stock / name, scratch / name)
    if target == "arguments":
        arguments, damage, leads = argument_case(rng), "", True
        damage = " ".join(arguments)[:80]
    else:
        one = TARGETS[target]
        given = scratch / Path(one.source).name
        damage = _copied_and_damaged(stock / one.source, given, one, None if sound else rng)
        arguments, leads = list(one.arguments), one.leads_to_result
        arguments = [part.replace("{input}", given.name) for part in arguments]
    out = scratch / OUT
    places = {"{out}": OUT, "{refusing}": "kept"}
    arguments = [places.get(part, part) for part in arguments]
    before = _digests(scratch / "kept")
    end, said, seconds = run_forked(arguments, scratch, command, limit_s)
    if end in ("told", "done"):
        end = _left_behind(scratch, out, end == "done" and leads) or end
        if _digests(scratch / "kept") != before:
            end = "foreign_change"
    return FuzzOutcome(seed, target, damage, end, said, seconds)


def _copied_and_damaged(
    source: Path, given: Path, target: FuzzTarget, rng: random.Random | None
) -> str:
    if source.is_file():
        shutil.copy(source, given)
        return damage_file(given, rng) if rng else ""
    shutil.copytree(source, given, symlinks=True)
    if rng is None:
        return ""
    files = sorted({f for pattern in target.damaged for f in given.glob(pattern) if f.is_file()})
    return damage_file(rng.choice(files), rng)


def _digests(folder: Path) -> dict[str, str]:
    """Return what lies in a tree of canaries, the output folder apart."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and "out" not in path.relative_to(folder).parts[:1]
    }


def _left_behind(scratch: Path, out: Path, leads_to_result: bool) -> str:
    beside = [path for path in out.parent.iterdir() if path.name.startswith(".")]
    if beside:
        return "partial_output"
    if out.exists() and leads_to_result and not (out / "result.json").is_file():
        return "partial_output"
    return ""


def run_forked(
    arguments: list[str], folder: Path, command: Callable[[list[str]], int], limit_s: float
) -> tuple[str, str, float]:
    start = time.monotonic()
    child = os.fork()
    if child == 0:
        _be_child(arguments, folder, command)
    status = _waited(child, limit_s)
    seconds = time.monotonic() - start
    text = (folder / "stderr").read_text(encoding="utf-8", errors="replace")
    said = text.strip().splitlines()[-1][:300] if text.strip() else ""
    if status is None:
        return "hang", said, seconds
    if os.WIFSIGNALED(status):
        return "crash", f"signal {os.WTERMSIG(status)}: {said}", seconds
    code = os.WEXITSTATUS(status)
    if "Traceback (most recent call last)" in text:
        return "traceback", said, seconds
    if code not in _EXIT_CODES:
        return "exit_code", f"{code}: {said}", seconds
    if code and not (said and len(text.splitlines()) <= _MOST_LINES):
        return "not_told", f"{code}, {len(text.splitlines())} lines: {said}", seconds
    return ("told" if code else "done"), said, seconds


def _be_child(arguments: list[str], folder: Path, command: Callable[[list[str]], int]) -> None:
    code = 1
    try:
        os.setsid()
        os.chdir(folder)
        for number, name, flags in (
            (0, os.devnull, os.O_RDONLY),
            (1, "stdout", os.O_WRONLY | os.O_CREAT),
            (2, "stderr", os.O_WRONLY | os.O_CREAT),
        ):
            os.dup2(os.open(name, flags, 0o600), number)
        # Whoever runs us may have put streams of its own there.
        sys.stdout, sys.stderr = (
            io.TextIOWrapper(io.FileIO(n, "w"), "utf-8", "backslashreplace") for n in (1, 2)
        )
        try:
            code = command(arguments)
        except BaseException:
            sys.excepthook(*sys.exc_info())  # type: ignore[arg-type]
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code)


def _waited(child: int, limit_s: float) -> int | None:
    """Return the child's status; None where it had to be killed, with all that it started.

    It hangs when it has run for so long and then stands still, or has used up as much processor
    time: on a busy machine it may only have waited for its turn.
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
        with suppress(OSError):  # ended meanwhile
            fields = path.read_text().rpartition(")")[2].split()
            ticks += (int(fields[11]) + int(fields[12])) * (int(fields[3]) == session)
    return ticks / os.sysconf("SC_CLK_TCK")
