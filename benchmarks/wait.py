"""Waiting times of a user: whole commands, the first run after set-up, and the camera's noise.

Each command runs in a process of its own. Times are the least of three runs; they are valid on an
idle machine of two cores. `..._cpu_s` (user and system time of the command and its processes)
remains comparable on a busy machine.

`measure_s`, `measure_full_s`: `twin measure examples/slab_balls` at 968 x 732 and full size, with a
slab press; `demo_s`: `twin demo`, with a press of a thin sheet. `physics_share`: share of the
stages press, render, expose, reconstruct and score in `measure_s`; `report_s`: time that
`--no-report` saves. `warm_s`: `twin doctor --warm` without compiled kernels; `first_run_s`:
`twin measure` right after it. `noise_484_ms` and `noise_full_s`: exposure of 53 given frames.

Last line: {"measure_s": s, "measure_full_s": s, "physics_share": r, "report_s": s,
"first_run_s": s, "reconstruct_full_s": s, "noise_484_ms": ms, "noise_full_s": s, ...}.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks._harness import print_figures, processor_s, quick_parser, seconds
from reconstruction.arrays import FloatImage
from twin.camera import electrons_per_ms, expose, full_well_e
from twin.config import Experiment, load_experiment
from twin.optics.light import pattern_set

REPEATS = 3
SCENE = "examples/slab_balls"
MEASURE = f"measure {SCENE} -s camera.binning=2 -o"
PHYSICS = ("press", "render", "expose", "reconstruct", "score", "object")
# White frame and dark pixel, relative to the full well.
WHITE, DARK = 0.7, 2e-3

Times = dict[str, float]


def main() -> None:
    """Time everything and print one JSON line."""
    quick = quick_parser(__doc__, "no full size, one run each").parse_args().quick
    repeats = 1 if quick else REPEATS
    with tempfile.TemporaryDirectory() as scratch:
        figures = waits(Path(scratch), repeats) | first_run(Path(scratch))
        if not quick:
            figures |= full_size(Path(scratch), repeats)
    figures["noise_484_ms"] = 1e3 * noise_s(4)
    if not quick:
        figures["noise_full_s"] = noise_s(1)
    print_figures(figures)


def waits(scratch: Path, repeats: int) -> Times:
    """Time commands at 968 x 732."""
    figures = least("measure", f"{MEASURE} {scratch}/measured", repeats)
    stages = json.loads((scratch / "measured" / "timings.json").read_text(encoding="utf-8"))
    without = least("report", f"{MEASURE} {scratch}/measured --no-report", repeats)
    figures["physics_share"] = sum(stages[name] for name in PHYSICS) / figures["measure_s"]
    figures |= {
        name: figures[name.replace("report", "measure")] - value for name, value in without.items()
    }
    figures |= least("press", f"press {SCENE} -o {scratch}/pressed", repeats)
    return figures | least("demo", f"demo -o {scratch}/demo", 1)


def full_size(scratch: Path, repeats: int) -> Times:
    """Time commands at 1936 x 1464."""
    out = scratch / "full"
    measure = f"measure {SCENE} -s camera.binning=1 -o {out}"
    again = f"reconstruct {out} -o {scratch}/points"
    return least("measure_full", measure, 1) | least("reconstruct_full", again, repeats)


def first_run(scratch: Path) -> Times:
    """Time the compilation of all kernels, and the measurement after it."""
    cache = {"NUMBA_CACHE_DIR": str(scratch / "kernels")}
    warm_s, warm_cpu_s = timed([sys.executable, "-m", "twin.doctor"], cache)
    first_s, _ = timed(twin(f"{MEASURE} {scratch}/first"), cache)
    return {"warm_s": warm_s, "warm_cpu_s": warm_cpu_s, "first_run_s": first_s}


def least(name: str, arguments: str, repeats: int) -> Times:
    """Return the least wall and CPU seconds of a `twin` command that runs several times."""
    runs = [timed(twin(arguments)) for _ in range(repeats)]
    wall_s, cpu_s = (min(values) for values in zip(*runs, strict=True))
    print(f"twin {arguments.split()[0]}: {wall_s:.2f} s, {cpu_s:.2f} s of CPU time", flush=True)
    return {f"{name}_s": wall_s, f"{name}_cpu_s": cpu_s}


def twin(arguments: str) -> list[str]:
    """Return the command that calls `twin`."""
    return [sys.executable, "-c", "from twin.cli import main; main()", *arguments.split()]


def timed(command: list[str], environment: dict[str, str] | None = None) -> tuple[float, float]:
    """Return the wall and CPU seconds of a command, that of its own processes included."""
    before_s, used = processor_s(), os.environ | (environment or {})
    wall_s = seconds(lambda: subprocess.run(command, check=True, capture_output=True, env=used))
    return wall_s, processor_s() - before_s


def noise_s(binning: int) -> float:
    """Return the least seconds of exposing the sequence of the default scene."""
    settings = {"camera.binning": binning, "camera.exposure_ms": 10.0}
    experiment = load_experiment(SCENE, settings)
    radiance = frames_of(experiment)
    expose(experiment, radiance[:1], 0)
    return min(seconds(lambda: expose(experiment, radiance, 0)) for _ in range(REPEATS))


def frames_of(experiment: Experiment) -> list[FloatImage]:
    """Return the sequence on a flat white field, one projector pixel per camera pixel."""
    camera = experiment.camera
    shape = camera.height_px // camera.binning, camera.width_px // camera.binning
    rate = electrons_per_ms(camera, experiment.projector.wavelength_nm) * 10.0
    white = full_well_e(camera) / rate
    patterns = pattern_set(experiment.projector, experiment.patterns)
    frames = []
    for frame in patterns.frames:
        along = shape[0] if frame.axis == "row" else shape[1]
        levels = np.resize(patterns.profile(frame) / 255.0, along)
        field = levels[:, None] if frame.axis == "row" else levels
        light = np.broadcast_to(DARK + (WHITE - DARK) * field, shape)
        frames.append(np.ascontiguousarray(white * light, np.float32))
    return frames


if __name__ == "__main__":
    main()
