"""What a person waits for: whole commands, the first run after set-up, and the camera's noise.

Each command runs in a process of its own, as it is typed. Times are the least of three runs: an
idle machine of two cores tells the truth, `..._cpu_s` beside them (user and system time of the
command and its processes) is what stays comparable on a busy one.

`measure_s`, `measure_full_s` are of `twin measure examples/slab_balls` at 968 x 732 and full size,
whose press is a slab's; `demo_s` of `twin demo`, whose press is a thin sheet's. `physics_share` is
what the stages that press, render, expose, reconstruct and score take of `measure_s`, `report_s`
what `--no-report` would save. `warm_s` is `twin doctor --warm` with no compiled kernel there, and
`first_run_s` what `twin measure` takes right after it. `noise_484_ms` and `noise_full_s` expose 53
frames that are there already.

Last line: {"measure_s": s, "measure_full_s": s, "physics_share": r, "report_s": s,
"first_run_s": s, "reconstruct_full_s": s, "noise_484_ms": ms, "noise_full_s": s, ...}.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from reconstruction.arrays import FloatImage
from twin.camera import electrons_per_ms, expose, full_well_e
from twin.config import Experiment, load_experiment
from twin.optics.light import pattern_set

REPEATS = 3
SCENE = "examples/slab_balls"
PHYSICS = ("press", "render", "expose", "reconstruct", "score", "object")
# Of the full well: the white frame, and what a dark pixel receives.
WHITE, DARK = 0.7, 2e-3


def main() -> None:
    """Time everything and print one JSON line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="nothing at full size, one run each")
    quick = parser.parse_args().quick
    repeats = 1 if quick else REPEATS
    with tempfile.TemporaryDirectory() as scratch:
        found = waits(Path(scratch), repeats) | first_run(Path(scratch))
        if not quick:
            found |= full_size(Path(scratch), repeats)
    found["noise_484_ms"] = round(1e3 * noise_s(4), 1)
    if not quick:
        found["noise_full_s"] = round(noise_s(1), 3)
    print(json.dumps(found))


def waits(scratch: Path, repeats: int) -> dict[str, float]:
    """Time commands at 968 x 732."""
    measure = ["measure", SCENE, "-s", "camera.binning=2", "-o", str(scratch / "measured")]
    measure_s, measure_cpu_s = least(measure, repeats)
    stages = json.loads((scratch / "measured" / "timings.json").read_text(encoding="utf-8"))
    without_s, without_cpu_s = least([*measure, "--no-report"], repeats)
    press_s, press_cpu_s = least(["press", SCENE, "-o", str(scratch / "pressed")], repeats)
    demo_s, demo_cpu_s = least(["demo", "-o", str(scratch / "demo")], 1)
    return {
        "measure_s": measure_s,
        "measure_cpu_s": measure_cpu_s,
        "physics_share": round(sum(stages[name] for name in PHYSICS) / measure_s, 2),
        "report_s": round(measure_s - without_s, 2),
        "report_cpu_s": round(measure_cpu_s - without_cpu_s, 2),
        "press_s": press_s,
        "press_cpu_s": press_cpu_s,
        "demo_s": demo_s,
        "demo_cpu_s": demo_cpu_s,
    }


def full_size(scratch: Path, repeats: int) -> dict[str, float]:
    """Time commands at 1936 x 1464."""
    out = str(scratch / "full")
    measure_s, measure_cpu_s = least(["measure", SCENE, "-s", "camera.binning=1", "-o", out], 1)
    again = ["reconstruct", out, "-o", str(scratch / "points")]
    reconstruct_s, reconstruct_cpu_s = least(again, repeats)
    return {
        "measure_full_s": measure_s,
        "measure_full_cpu_s": measure_cpu_s,
        "reconstruct_full_s": reconstruct_s,
        "reconstruct_full_cpu_s": reconstruct_cpu_s,
    }


def first_run(scratch: Path) -> dict[str, float]:
    """Time the warming of an empty cache of kernels, and the measurement after it."""
    cache = {"NUMBA_CACHE_DIR": str(scratch / "kernels")}
    warm_s, warm_cpu_s = timed([sys.executable, "-m", "twin.doctor"], cache)
    measure = ["measure", SCENE, "-s", "camera.binning=2", "-o", str(scratch / "first")]
    first_s, _ = timed(command_of(measure), cache)
    return {"warm_s": warm_s, "warm_cpu_s": warm_cpu_s, "first_run_s": first_s}


def least(arguments: list[str], repeats: int) -> tuple[float, float]:
    """Return the least wall and CPU seconds of a `twin` command that runs several times."""
    runs = [timed(command_of(arguments)) for _ in range(repeats)]
    wall_s, cpu_s = (min(values) for values in zip(*runs, strict=True))
    print(f"twin {arguments[0]}: {wall_s} s, {cpu_s} s of CPU time")
    return wall_s, cpu_s


def command_of(arguments: list[str]) -> list[str]:
    """Return how `twin` is called here."""
    return [sys.executable, "-c", "from twin.cli import main; main()", *arguments]


def timed(command: list[str], environment: dict[str, str] | None = None) -> tuple[float, float]:
    """Return the wall and CPU seconds of a command, that of its own processes included."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(command, check=True, capture_output=True, env=os.environ | (environment or {}))
    wall_s, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return round(wall_s, 2), round(cpu_s, 2)


def noise_s(binning: int) -> float:
    """Return the least seconds of exposing the sequence of the default scene."""
    settings = {"camera.binning": binning, "camera.exposure_ms": 10.0}
    experiment = load_experiment(SCENE, settings)
    radiance = frames_of(experiment)
    expose(experiment, radiance[:1], 0)
    seconds = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        expose(experiment, radiance, 0)
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def frames_of(experiment: Experiment) -> list[FloatImage]:
    """Return the sequence as a flat white field would show it, one projector pixel per pixel."""
    camera = experiment.camera
    shape = camera.height_px // camera.binning, camera.width_px // camera.binning
    rate = electrons_per_ms(camera, experiment.projector.wavelength_nm) * 10.0
    white, patterns = (
        full_well_e(camera) / rate,
        pattern_set(experiment.projector, experiment.patterns),
    )
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
