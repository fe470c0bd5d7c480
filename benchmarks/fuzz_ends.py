"""Pairs of keys at the ends of their ranges, for every kind of specimen, measured with few pixels.

A case is a seed: it draws a sensor, a specimen, two numbers of the experiment, and for each number
a limit of its range or an extreme of floating point. The cases run one after the other in one child
process, which imports everything once; after a hang or a crash the next child continues. The limits
of a case are processor time and memory (`MOST_BYTES` of address space).

A case that ends with exit code 0 is `absurd` if a figure of its result.json

- is not finite, or larger than `LARGEST`;
- is a share or a completeness outside of 0 to 1, or a negative force, error, width or radius;
- is a sigma or a root mean square of exactly 0 although points were measured with noise.

    python -m benchmarks.fuzz_ends --cases 500 --journal ends.jsonl

continues after the seeds in the journal. `--seed N` prints a case. Last line: the counts.
"""

import argparse
import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import cache, partial
from pathlib import Path
from typing import Any

from benchmarks._forked import command, forked, preload
from benchmarks.fuzz_numbers import (
    EXTREMES,
    MOST_BYTES,
    finite_absurdity,
    numbers_in,
    setting_words,
)
from benchmarks.fuzzing import FuzzOutcome, ended
from twin.study.worker import die_with
from twin.working import BY_SIGNAL, ENDING_SIGNALS

LIMIT_S = 60.0
_MOST_DRAWS = 30
_POLL_S = 0.05
_CAMERA = {"camera.binning": 4, "camera.width_px": 320, "camera.height_px": 240}
_SLAB = _CAMERA | {"press.solver_pitch_mm": 0.4}
_FORCE = {"press.control": "force", "press.depth_mm": "absent", "press.force_n": 10.0}
SENSORS: dict[str, tuple[str, dict[str, Any]]] = {
    "slab": ("examples/slab_ball", _SLAB),
    "slab_force": ("examples/slab_ball", _SLAB | _FORCE),
    "window": ("examples/gel_on_window", _SLAB),
    "sheet": ("examples/wrapped_balls", _CAMERA | {"press.cell_mm": 0.5}),
    "direct": ("examples/gauges", _CAMERA),
    "airbrushed": ("examples/airbrushed", _SLAB),
}
SPECIMENS = (
    "ball", "bar", "bars", "bear", "brick", "fingerprint", "flat", "grating", "nut",
    "random_group", "random_relief", "rod", "rods", "step", "t_bolt", "two_balls", "v_groove",
)  # fmt: skip
_TABLES = (
    "press", "elastomer", "specimen", "projector", "camera", "patterns", "decode", "score",
    "render", "coating", "layers", "stage", "motion", "mechanics",
)  # fmt: skip


def drawn_case(seed: int) -> tuple[str, dict[str, Any]]:
    """Return the base and the settings of a case; all that is drawn depends on the seed only."""
    rng = random.Random(seed)
    name = rng.choice(tuple(SENSORS))
    kind = rng.choice((None, *SPECIMENS))
    base, fixed = SENSORS[name]
    if kind:
        fixed = fixed | {"specimen.kind": kind}
    pool = _keys_of(name, kind)
    if not pool:
        return base, fixed
    drawn: dict[str, Any] = {}
    for _ in range(_MOST_DRAWS):
        key = rng.choice(sorted(pool))
        value = rng.choice(_ends_of(key, pool[key]))
        if key not in drawn and _is_accepted(base, fixed | {key: value}):
            drawn[key] = value
        if len(drawn) == 2:
            break
    return base, fixed | drawn


def _is_accepted(base: str, settings: dict[str, Any]) -> bool:
    """Return True if an experiment can be loaded: `fuzz_numbers` has the values that cannot."""
    from reconstruction.errors import InputError
    from twin.config import load_experiment

    try:
        load_experiment(base, settings)
    except InputError:
        return False
    return True


@cache
def _keys_of(sensor: str, kind: str | None) -> Mapping[str, Any]:
    """Return the numbers of an experiment by their dotted paths; empty if it cannot be loaded."""
    from twin.config import load_experiment

    base, fixed = SENSORS[sensor]
    settings = fixed | ({"specimen.kind": kind} if kind else {})
    if not _is_accepted(base, settings):
        return {}
    tree = load_experiment(base, settings).model_dump(mode="python")
    return dict(numbers_in({name: tree[name] for name in _TABLES if tree.get(name)}))


def _ends_of(key: str, value: Any) -> list[Any]:
    """Return the limits of a key, the numbers next to them, and extremes; whole for whole keys."""
    from twin.config.schema import limits_at

    ends = [*limits_at(key), *EXTREMES, value * 1e-3, value * 1e3]
    if isinstance(value, int):
        return sorted({int(end) for end in ends if abs(end) < 2**53})
    return sorted(dict.fromkeys(map(float, ends)))


# ---- one child process, many cases -------------------------------------------------------------


def _run_cases(parent: int, seeds: Sequence[int], journal: Path) -> int:
    """Run cases in this process; the journal has a line at the start and the end of each."""
    die_with(parent)
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
    messages = Path("stderr").absolute()
    with journal.open("a", buffering=1) as lines:
        for seed in seeds:
            lines.write(f"{json.dumps({'seed': seed})}\n")
            outcome = _run_case(seed, messages)
            lines.write(f"{json.dumps(asdict(outcome))}\n")
    return 0


def _run_case(seed: int, messages: Path) -> FuzzOutcome:
    base, settings = drawn_case(seed)
    out = Path("out")
    words = ["measure", base, "--no-report", "-o", str(out), *setting_words(settings)]
    skip, start = messages.stat().st_size, time.monotonic()
    try:
        code = command(words)
        if code - BY_SIGNAL in ENDING_SIGNALS:
            sys.exit(code)  # a signal ends this process, not only the case
    except Exception:  # a traceback is what the case looks for: it is printed and counted
        sys.excepthook(*sys.exc_info())  # type: ignore[arg-type]
        code = 1
    sys.stderr.flush()
    with messages.open("rb") as file:
        file.seek(skip)
        text = file.read().decode("utf-8", "replace")
    end, message = ended(code, text)
    if end == "done":
        absurdity = absurd(json.loads((out / "result.json").read_text())["metrics"])
        end, message = ("absurd", absurdity) if absurdity else (end, message)
    elif out.exists() or any(Path().glob(".*.part")):
        end = "partial_output"
    shutil.rmtree(out, ignore_errors=True)
    drawn = dict(list(settings.items())[-2:])
    kind = settings.get("specimen.kind", "")
    seconds = time.monotonic() - start
    return FuzzOutcome(seed, f"{base} {kind}".strip(), str(drawn), end, message, seconds)


def absurd(metrics: Mapping[str, Any]) -> str:
    """Return the first figure that no measurement has; empty if there is none."""
    if figure := finite_absurdity(metrics):
        return figure
    numbers = {name: value for name, value in metrics.items() if isinstance(value, int | float)}
    for name, value in numbers.items():
        is_share = name == "completeness" or name.endswith("_share")
        has_sign = any(part in name for part in ("bias", "error", "offset", "depth", "gradient"))
        if is_share and not 0.0 <= value <= 1.0:
            return f"{name} = {value:g}, not in 0 to 1"
        if not has_sign and value < 0.0 and _is_magnitude(name):
            return f"{name} = {value:g}, negative"
        is_spread = "sigma" in name or name.endswith("_rmse_um")
        if is_spread and value == 0.0 and numbers.get("points", 0) > 0:
            return f"{name} = 0 with {numbers['points']} points"
    return ""


def _is_magnitude(name: str) -> bool:
    parts = ("force", "rmse", "rms", "sigma", "radius", "width", "pressure", "exposure", "mae")
    return any(part in name.split("_") for part in parts)


def outcomes_of(seeds: Sequence[int], limit_s: float = LIMIT_S) -> Iterator[FuzzOutcome]:
    """Run cases in child processes, one after the other, and yield their outcomes."""
    remaining = list(seeds)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        while remaining:
            journal = folder / "journal"
            journal.write_text("")
            child = forked(partial(_run_cases, os.getpid(), remaining, journal), folder)
            try:
                for outcome in _watched(child, journal, folder, limit_s):
                    remaining.remove(outcome.seed)
                    yield outcome
            finally:
                with suppress(ProcessLookupError):
                    os.killpg(child, signal.SIGKILL)


def _watched(child: int, journal: Path, folder: Path, limit_s: float) -> Iterator[FuzzOutcome]:
    """Yield the outcomes of a child; of the case in which it hangs or crashes, too."""
    position, current, status = 0, None, None
    while status is None:
        time.sleep(_POLL_S)
        waited, ended_by = os.waitpid(child, os.WNOHANG)
        status = ended_by if waited else None
        with journal.open() as file:
            file.seek(position)
            lines = [line for line in file.read().splitlines(keepends=True) if line[-1] == "\n"]
        position += sum(map(len, lines))
        for line in map(json.loads, lines):
            if "end" in line:
                current = None
                yield FuzzOutcome(**line)
            else:
                current, start_s = line["seed"], _processor_s(child)
        if current is not None and status is None and _processor_s(child) - start_s > limit_s:
            yield FuzzOutcome(current, "", str(drawn_case(current)), "hang", "", limit_s)
            return
    if current is not None:
        last = (folder / "stderr").read_text(errors="replace").strip()[-200:]
        message = f"{os.waitstatus_to_exitcode(status)}: {last}"
        yield FuzzOutcome(current, "", str(drawn_case(current)), "crash", message, 0.0)


def _processor_s(process: int) -> float:
    """Return the processor time of a process; 0 if it has ended."""
    with suppress(OSError):
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return 0.0


def main() -> int:
    """Run the cases that are not in the journal; return 1 if one of all is bad."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=300)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--seed", type=int, help="this case only, printed")
    parser.add_argument("--journal", type=Path, help="file of outcomes; its seeds are not repeated")
    parser.add_argument("--limit", type=float, default=LIMIT_S, help="processor seconds of a case")
    chosen = parser.parse_args()
    preload()
    if chosen.seed is not None:
        print(drawn_case(chosen.seed), *outcomes_of([chosen.seed], chosen.limit), sep="\n")
        return 0
    journal = chosen.journal
    lines = journal.read_text().splitlines() if journal and journal.exists() else []
    outcomes = [FuzzOutcome(**json.loads(line)) for line in lines]
    there = {outcome.seed for outcome in outcomes}
    seeds = range(chosen.first, chosen.first + chosen.cases)
    for outcome in outcomes_of([seed for seed in seeds if seed not in there], chosen.limit):
        outcomes.append(outcome)
        if outcome.is_bad:
            print(outcome, flush=True)
        if journal:
            with journal.open("a") as file:
                file.write(f"{json.dumps(asdict(outcome))}\n")
    counts = Counter(outcome.end for outcome in outcomes)
    print(json.dumps({"cases": len(outcomes)} | dict(sorted(counts.items()))))
    return int(any(outcome.is_bad for outcome in outcomes))


if __name__ == "__main__":
    sys.exit(main())
