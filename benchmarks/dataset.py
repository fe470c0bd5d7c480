"""Data sets: samples per hour, share of writing, kills and resumption, number of workers.

- direct projection and a thin sheet: samples per hour, one after another on this machine;
- 300 scenes of 960 x 960 pixels with 53 frames of 8 bits, by the default number of workers: minutes
  (the published set of VIRTUS-FPP has 52 frames). With `--quick` 8 scenes are computed and the time
  is scaled to 300; `fpp_ml_scenes` states the number. `fpp_ml_processor_s` is the processor time of
  a scene by one worker, which other programs of the machine change less;
- the share of the time of such a set, by one worker, that is not spent on computing samples: store
  and shards;
- a small set is made in one go, by two workers, and by runs that are killed 10 times (2 with
  `--quick`) at random moments: the shards must have the same bytes;
- Kolmogorov-Smirnov tests of 2000 drawn values of a uniform, a log-uniform and a normal quantity.

The 300 scenes take 40 GB of disk in TMPDIR, which are removed at the end, and all parts together
about 15 minutes on two idle cores; `--scenes` takes fewer and scales the time. The first samples,
which compile kernels, are not counted. Last line:
{"samples_per_hour_direct": ..., "samples_per_hour_sheet": ..., "images_per_s": ...,
"write_share": ..., "resume_equal": true, "fpp_ml_bench_minutes": ..., ...}.
"""

import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks._harness import print_figures, quick_parser
from twin.config import Experiment
from twin.config.dataset import Recipe, load_recipe
from twin.dataset.draws import levels_of
from twin.dataset.make import draw_all, pack, take_samples
from twin.dataset.taking import SampleMeasurer
from twin.pipeline.progress import ProgressCallback
from twin.study.measuring import NOMINAL_CONDITIONS, CaseResult, Conditions
from twin.study.trials import drawn_values
from twin.study.workers import default_count, lasting, local_workers

HOLD = '["frames", "depth_mm", "normal_world", "label", "lit"]'
RELIEF = """
[scene.set.specimen]
kind = "random_relief"
material = { use = "materials/diffuse/gray_print" }
[[scene.axis]]
path = "specimen.seed"
low = 0
high = 4294967295
integer = true
[[scene.axis]]
path = "specimen.rms_um"
low = 10.0
high = 200.0
scale = "log"
[inputs.angle]
group = "optics"
key = "projector.pose.polar_deg"
distribution = "normal"
spread = 0.5
"""
SHEET = """
[[scene.axis]]
path = "specimen.diameter_mm"
low = 6.0
high = 10.0
"""
DIRECT_SIZE = {"binning": 4, "width_px": 1936, "height_px": 1464}
SMALL_SIZE = {"binning": 4, "width_px": 320, "height_px": 240}
ML_SIZE = {"binning": 1, "width_px": 960, "height_px": 960, "bit_depth": 8}
ML_SCENES, LEAST_P = 300, 0.01
SCENE_GB = 0.132
"""Disk of a large scene, store and shard: 53 frames of 1 byte, depth, normals and two masks."""
_computing_s = 0.0


def progress(part: str) -> ProgressCallback:
    """Return a function that prints the progress of a part in steps of a tenth."""
    shown: set[tuple[str, int]] = set()

    def watch(stage: str, share: float) -> None:
        tenth = (stage, int(10 * share))
        if tenth not in shown:
            shown.add(tenth)
            print(f"{part}: {stage} {10 * tenth[1]} %", flush=True)

    return watch


def require_room(scratch: Path, scenes: int) -> None:
    """End the program with one line if the disk has too little room for so many large scenes."""
    needed_gb = SCENE_GB * (scenes + 2 * default_count()) + 3.0
    free_gb = shutil.disk_usage(scratch).free / 1e9
    if free_gb < needed_gb:
        sys.exit(
            f"bench dataset: {scratch}: {free_gb:.0f} GB free, {needed_gb:.0f} needed; set TMPDIR "
            "to a larger disk, or give fewer --scenes"
        )


def recipe_text(base: str, size: Mapping[str, int], more: str) -> str:
    """Return a recipe with one scene."""
    camera = "\n".join(f"{name} = {value}" for name, value in size.items())
    scene = f'[[scene]]\nname = "scene"\nbase = "{base}"\n[scene.set.camera]\n{camera}\n'
    split = "[split]\ntrain = 0.0\nvalidation = 0.0\ntest = 1.0\n"
    return f'name = "bench"\nseed = 1\n{scene}{more}[sample]\nhold = {HOLD}\n{split}'


class TimedMeasurer(SampleMeasurer):
    """Measures, and adds up the time."""

    def __call__(
        self, experiment: Experiment, conditions: Conditions = NOMINAL_CONDITIONS
    ) -> CaseResult:
        """Take one sample."""
        global _computing_s
        start = time.perf_counter()
        result = super().__call__(experiment, conditions)
        _computing_s += time.perf_counter() - start
        return result


def make(text: str, folder: Path, count: int) -> dict[str, float]:
    """Make a data set on this process; return the times, s, without the first sample."""
    global _computing_s
    folder.mkdir()
    (folder / "recipe.toml").write_text(text, encoding="utf-8")
    recipe, bases = load_recipe(folder / "recipe.toml")
    draws, work = draw_all(recipe, bases, count + 1), folder / "work"
    take_samples(recipe, draws[:1], work, local_workers(1))
    _computing_s, start = 0.0, time.perf_counter()
    processor_s = time.process_time()
    watch = progress(folder.name)
    take_samples(recipe, draws, work, local_workers(1), watch=watch, measurer=TimedMeasurer)
    packed = pack(recipe, bases, draws, work, folder / "set", watch=watch)
    total_s = time.perf_counter() - start
    assert len(packed.samples) == count + 1, packed.failures
    shutil.rmtree(folder)  # the next part needs the room
    return {
        "total_s": total_s,
        "computing_s": _computing_s,
        "processor_s": time.process_time() - processor_s,
        "samples": count,
    }


def make_by_workers(text: str, folder: Path, count: int) -> dict[str, float]:
    """Make a data set by the default number of processes; return the times, s.

    The first two samples of each process are not counted.
    """
    folder.mkdir()
    (folder / "recipe.toml").write_text(text, encoding="utf-8")
    recipe, bases = load_recipe(folder / "recipe.toml")
    first, work = 2 * default_count(), folder / "work"
    draws = draw_all(recipe, bases, count + first)
    with lasting(local_workers(default_count())) as workers:
        take_samples(recipe, draws[:first], work, workers)
        start = time.perf_counter()
        watch = progress(folder.name)
        take_samples(recipe, draws, work, workers, watch=watch)
        packed = pack(recipe, bases, draws, work, folder / "set", watch=watch)
        total_s = time.perf_counter() - start
    assert len(packed.samples) == count + first, packed.failures
    shutil.rmtree(folder)
    frames = sum(int(sample.described["figures"]["frames"]) for sample in packed.samples[first:])
    return {"total_s": total_s, "frames": frames, "samples": count}


def command(recipe: Path, out: Path, count: int, workers: int) -> subprocess.Popen[bytes]:
    """Start the command in a process group of its own."""
    words = ["-c", "from twin.cli import main; main()", "dataset", str(recipe)]
    words += ["-n", str(count), "-o", str(out), "-j", str(workers)]
    # Python warns of shared memory that killed processes did not release.
    environment = os.environ | {"PYTHONWARNINGS": "ignore::UserWarning"}
    return subprocess.Popen(
        [sys.executable, *words],
        env=environment,
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def killed_and_resumed(scratch: Path, kills: int, count: int) -> dict[str, Any]:
    """Compare sets made in one go, by two workers, and by runs that were killed."""
    recipe, rng = scratch / "small.toml", random.Random(1)
    text = recipe_text("examples/gauges", SMALL_SIZE, RELIEF)
    recipe.write_text(text, encoding="utf-8")
    start = time.perf_counter()
    one = command(recipe, scratch / "one", count, 1).wait()
    whole_s = time.perf_counter() - start
    two = command(recipe, scratch / "two", count, 2).wait()
    done = 0
    while done < kills:
        run = command(recipe, scratch / "killed", count, 1)
        try:
            run.wait(rng.uniform(0.1, 0.9) * whole_s)
        except subprocess.TimeoutExpired:
            os.killpg(run.pid, signal.SIGKILL)
            run.wait()
            done += 1
            print(f"killed: {done} of {kills}", flush=True)
            continue
        for folder in ("killed", "killed.work"):  # the run has ended before: begin again
            shutil.rmtree(scratch / folder)
    last = command(recipe, scratch / "killed", count, 1).wait()
    return {
        "kills": done,
        "resume_equal": one == last == 0 and same(scratch / "one", scratch / "killed"),
        "workers_equal": one == two == 0 and same(scratch / "one", scratch / "two"),
    }


def same(one: Path, two: Path) -> bool:
    """Return True if two data sets have the same files with the same bytes."""
    names = [sorted(path.name for path in folder.iterdir()) for folder in (one, two)]
    return names[0] == names[1] and all(
        (one / name).read_bytes() == (two / name).read_bytes() for name in names[0]
    )


def least_p(scratch: Path, draws: int = 2000) -> float:
    """Return the smallest p of the Kolmogorov-Smirnov tests of drawn values."""
    from scipy import stats

    file = scratch / "drawn.toml"
    file.write_text(recipe_text("examples/gauges", SMALL_SIZE, RELIEF), encoding="utf-8")
    recipe, (base,) = load_recipe(file)
    laws = {
        "specimen.seed": stats.uniform(0, 2**32),
        "specimen.rms_um": stats.loguniform(10.0, 200.0),
    }
    levels = [levels_of(recipe, recipe.scene[0], number) for number in range(draws)]
    probabilities = [
        stats.kstest([level[name].label for level in levels], law.cdf).pvalue
        for name, law in laws.items()
    ]
    return float(min(*probabilities, _p_of_input(recipe, base, draws)))


def _p_of_input(recipe: Recipe, base: Experiment, draws: int) -> float:
    from scipy import stats

    key = recipe.inputs["angle"].key
    values = [
        drawn_values(base, recipe.inputs, recipe.seed, number)[key]
        for number in range(1, draws + 1)
    ]
    law = stats.norm(base.projector.pose.polar_deg, recipe.inputs["angle"].spread)
    return float(stats.kstest(values, law.cdf).pvalue)


def main() -> int:
    """Run all parts and print one JSON line; return 1 if bytes differ or a test rejects."""
    parser = quick_parser(__doc__, "8 large scenes, 2 kills")
    parser.add_argument("--scenes", type=int, help="large scenes; default: 300, or 8")
    options = parser.parse_args()
    scenes = options.scenes or (8 if options.quick else ML_SCENES)
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        require_room(scratch, scenes)
        few = 4 if options.quick else 40
        figures: dict[str, Any] = {"least_ks_p": least_p(scratch)}
        direct = make(recipe_text("examples/gauges", DIRECT_SIZE, RELIEF), scratch / "direct", few)
        sheet = make(
            recipe_text("examples/wrapped_balls", DIRECT_SIZE, SHEET),
            scratch / "sheet",
            1 if options.quick else 5,
        )
        ml_text = recipe_text("examples/gauges", ML_SIZE, RELIEF)
        one = make(ml_text, scratch / "one_worker", 3 if options.quick else 20)
        large = make_by_workers(ml_text, scratch / "large", scenes)
        figures |= {
            "samples_per_hour_direct": 3600 * direct["samples"] / direct["total_s"],
            "samples_per_hour_sheet": 3600 * sheet["samples"] / sheet["total_s"],
            "images_per_s": large["frames"] / large["total_s"],
            "frames_per_scene": large["frames"] / large["samples"],
            "write_share": 1 - one["computing_s"] / one["total_s"],
            "fpp_ml_bench_minutes": large["total_s"] / 60 * ML_SCENES / scenes,
            "fpp_ml_scenes": scenes,
            "fpp_ml_processor_s": one["processor_s"] / one["samples"],
        }
        figures |= killed_and_resumed(scratch, 2 if options.quick else 10, 4)
    print_figures(figures)
    equal = figures["resume_equal"] and figures["workers_equal"]
    return int(not equal or figures["least_ks_p"] < LEAST_P)


if __name__ == "__main__":
    sys.exit(main())
