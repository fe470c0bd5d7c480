"""Every number of an experiment at its extremes: a sensible result, or one clear line.

For each numeric key of a base experiment: the ends of the range that its bounds allow and the
extremes of floating point. Values that the configuration rejects take milliseconds; the other cases
run in a child process under limits of processor time and memory. Bad cases are printed at once.
Last line: {"cases": n, "tracebacks": 0, "hangs": 0, "crashes": 0, "long": 0, "absurd": 0, ...}.

- `absurd`: exit code 0, and a figure that is not finite or larger than `LARGEST`;
- `long`: an error message of more than one line per problem.
"""

import argparse
import json
import math
import resource
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks._forked import command, preload
from benchmarks.fuzzing import FuzzOutcome, run_forked

EXTREMES = (0, -1, 5e-324, 1e-300, 1e-9, 1e9, 1e300)
LARGEST = 1e7
"""Of a figure in its own unit (mm, um, ms, kPa, N): no sensor has a larger one."""
MOST_BYTES = 6 * 2**30
_SETTINGS_AND_TIMES = ("experiment", "seconds", "frames_per_s", "seed", "sequence_ms")
_SMALL_CAMERA = {"camera.binning": 4, "camera.width_px": 484, "camera.height_px": 368}
_SLAB = _SMALL_CAMERA | {"press.solver_pitch_mm": 0.4}
_SHEET = _SMALL_CAMERA | {"press.cell_mm": 0.4}
_FORCE = {"press.control": "force", "press.depth_mm": "absent"}
_PRESSED = ("press", "elastomer", "specimen")
_SEEN = ("projector", "camera", "patterns", "decode", "score", "render", "coating", "specimen")


class NumberBase(NamedTuple):
    """An experiment, settings, the command that runs it, and the tables whose numbers vary."""

    experiment: str
    settings: dict[str, Any]
    command: str
    sections: tuple[str, ...]


_SLAB_FORCE, _SHEET_FORCE = (
    table | _FORCE | {"press.force_n": force_n} for table, force_n in ((_SLAB, 2.0), (_SHEET, 0.6))
)
BASES = {
    "slab": NumberBase("examples/slab_ball", _SLAB, "press", _PRESSED),
    "slab_force": NumberBase("examples/slab_ball", _SLAB_FORCE, "press", _PRESSED[:2]),
    "gel": NumberBase("examples/gel_on_window", _SLAB, "press", _PRESSED),
    "sheet": NumberBase("examples/wrapped_balls", _SHEET, "press", _PRESSED),
    "sheet_force": NumberBase("examples/wrapped_balls", _SHEET_FORCE, "press", _PRESSED[:2]),
    "measured": NumberBase("examples/slab_ball", _SLAB, "measure", _SEEN),
    "window": NumberBase("examples/gel_on_window", _SLAB, "measure", ("layers",)),
    "direct": NumberBase("examples/gauges", _SMALL_CAMERA, "measure", (*_SEEN, "stage")),
}


def cases_of(base: NumberBase) -> Iterator[tuple[str, float]]:
    """Yield keys and values: the ends of the key's range, and the extremes."""
    from twin.config import load_experiment
    from twin.config.schema import limits_at

    tree = load_experiment(base.experiment, base.settings).model_dump(mode="python")
    for key, _ in numbers_in({name: tree[name] for name in base.sections}):
        for value in dict.fromkeys((*limits_at(key), *EXTREMES)):
            yield key, value


def numbers_in(tree: dict[str, Any], before: str = "") -> Iterator[tuple[str, int | float]]:
    """Yield dotted paths and values of the numbers in nested tables; lists have no paths."""
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from numbers_in(value, f"{before}{key}.")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield f"{before}{key}", value


def run_number(name: str, key: str, value: float, folder: Path, limit_s: float) -> FuzzOutcome:
    """Run one case in a child process, and judge it."""
    base, out = BASES[name], folder / "out"
    arguments = [base.command, base.experiment, "--no-report", "-o", "out"]
    arguments += setting_words(base.settings | {key: value})
    end, message, seconds = run_forked(arguments, folder, _limited, limit_s)
    text = (folder / "stderr").read_text()
    if end == "reported" and len(text.split("twin: ")[-1].splitlines()) > 3:
        end = "long"
    if end == "reported" and not (message and key.split(".")[-1] in text):
        message = f"(another key) {message}"
    if end == "done" and (figure := finite_absurdity(_read(out / "result.json"))):
        end, message = "absurd", figure
    shutil.rmtree(out, ignore_errors=True)
    return FuzzOutcome(0, name, f"{key} = {value!r}", end, message, seconds)


def setting_words(settings: Mapping[str, Any]) -> list[str]:
    """Return settings as words of a command line; numbers state a source, as files have to."""
    return [word for path, value in settings.items() for word in ("-s", f"{path}={_toml(value)}")]


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {_toml(item)}' for key, item in value.items())} }}"
    if isinstance(value, str):
        return f"'{value}'"
    return f"{{ value = {value!r}, source = 'fuzz' }}"


def _limited(arguments: list[str]) -> int:
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
    return command(arguments)


def _read(result: Path) -> Any:
    return json.loads(result.read_text(encoding="utf-8"))


def finite_absurdity(tree: Any) -> str:
    """Return the first figure of nested tables that no sensor has; empty if there is none."""
    for name, value in _figures_in(tree):
        if not math.isfinite(value) or abs(value) > LARGEST:
            return f"{name} = {value:g}"
    return ""


def _figures_in(node: Any, name: str = "") -> Iterator[tuple[str, float]]:
    if isinstance(node, dict):
        for key, value in node.items():
            if key not in _SETTINGS_AND_TIMES:
                yield from _figures_in(value, key)
    elif isinstance(node, float):
        yield name, node


def main() -> int:
    """Run every case, or those of one base or key."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--base", choices=BASES, action="append")
    parser.add_argument("--key", default="", help="only keys that begin with this")
    parser.add_argument("--limit", type=float, default=60.0, help="processor seconds of a case")
    parser.add_argument("--all", action="store_true", help="print every case")
    chosen = parser.parse_args()
    preload()
    outcomes = []
    for name in chosen.base or BASES:
        for key, value in cases_of(BASES[name]):
            if not key.startswith(chosen.key):
                continue
            with tempfile.TemporaryDirectory() as scratch:
                outcome = run_number(name, key, value, Path(scratch), chosen.limit)
            outcomes.append(outcome)
            if outcome.is_bad or chosen.all:
                print(outcome, flush=True)
    ends = Counter(outcome.end for outcome in outcomes)
    print(json.dumps({"cases": len(outcomes)} | dict(sorted(ends.items()))))
    return int(any(outcome.is_bad for outcome in outcomes))


if __name__ == "__main__":
    sys.exit(main())
