"""Design points per hour of a sweep, compared with the same cases measured in turn.

A study of three axes, coat albedo x hardness x fringe period, at 484 x 366 under force control
(under depth control hardness would change the force only): every hardness needs a press and a
scene, every coat a trace, every case its own camera noise, decoding and score. The sweep runs on
two workers into an empty store, start of the workers included, with compiled kernels. Cases spread
over the design are then measured in turn: within one process, and by `twin measure`, one process
per case.

`speed_up_2_workers`: cases that share only code, each thickness with its own press, scene and
trace; one worker process with the threads of one core over two such workers, started and warm. The
losses are those of the engine (cases ahead, batches, store) and of the shared memory bus. It is
valid on an idle machine of two cores or more; `machine_speed_up`, of plain loops that share
nothing, before and after, is the gain that the machine allows: virtual cores often give less
than 2. `worker_efficiency` is the first over the second.

Last line: {"over_one_process": r, "over_one_by_one": r, "points_per_hour": n, ...}. The first
compares `measure` called repeatedly in one process, so it gains from sharing and from the second
worker only; the second also gains the start of a process per case. Also: the overhead of engine and
store per case, and wall-clock seconds per point of each stage, in one process on all cores, in the
sweep's order: `press_s, trace_s, light_s, noise_s, decode_s, score_s`, `object_s` (comparison with
the true object) and `store_s` (the overhead). `path_cpu_s`: processor time per point of trace,
light and noise, which other processes of the machine change less than seconds.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from benchmarks._harness import print_figures, processor_s, quick_parser, seconds
from twin.config import load_experiment, to_toml
from twin.config.study import Study
from twin.pipeline import Memory, measure
from twin.study.cases import Case
from twin.study.engine import Run
from twin.study.index import Index
from twin.study.measuring import CaseMeasurer
from twin.study.order import in_sharing_order
from twin.study.record import StudyRecord
from twin.study.store import Store
from twin.study.sweep import sweep
from twin.study.workers import lasting, local_workers

BASE = {
    "camera.binning": 4,
    "press.control": "force",
    "press.depth_mm": None,
    "press.force_n": 0.2,
    "press.back_pressure_kpa": 0.0,
    # At a deflection of 0.4 of the thickness `auto` takes a model that needs a minute.
    "mechanics.model": "spectral",
}
LOOP = [sys.executable, "-c", "sum(i * i for i in range(60_000_000))"]
# Figures and their stages of `twin.pipeline.memory`.
STAGES = {
    "press_s": ("shape", "press", "texture"),
    "trace_s": ("geometry", "view", "trace", "photons"),
    "light_s": ("tables", "frames"),
    "noise_s": ("capture",),
    "decode_s": ("reconstruction",),
}


def study_of(albedos: int, hardnesses: int, periods: int) -> Study:
    """Return the study with so many levels per axis."""
    return Study(
        name="bench",
        base="examples/slab_balls",
        axis=(
            {"path": "coating.base_albedo", "low": 0.2, "high": 0.7, "count": albedos},
            {"path": "elastomer.shore_a", "low": 8.0, "high": 14.0, "count": hardnesses},
            {"path": "patterns.period_px", "low": 16.0, "high": 20.0, "count": periods},
        ),
    )


def main() -> None:
    """Time both ways and print one JSON line."""
    quick = quick_parser(__doc__, "48 cases instead of 320").parse_args().quick
    levels = (4, 3, 4) if quick else (8, 4, 10)
    record = StudyRecord(study_of(*levels), load_experiment("examples/slab_balls", BASE))
    cases = record.cases().unique()
    print(f"{len(cases)} cases of {' x '.join(map(str, levels))}, {os.cpu_count()} cores")
    with tempfile.TemporaryDirectory() as scratch:
        warm_up(record, Path(scratch))
        start = time.perf_counter()
        outcome = sweep(record, Path(scratch) / "store", local_workers(2))
        per_point_s = (time.perf_counter() - start) / len(cases)
        # Comparable on a busy machine; includes the warm-up.
        cpu_s = processor_s() / len(cases)
        print(f"sweep: {per_point_s:.3f} s per point ({dict(outcome.states)})", flush=True)
        few = cases[:: max(1, len(cases) // (2 if quick else 4))][: 2 if quick else 4]
        alone_s, in_process_s = measured_alone(few, Path(scratch)), measured_in_process(few)
        print(f"in turn: {in_process_s:.2f} s within one process, {alone_s:.2f} s by twin measure")
        stages = seconds_of_stages(cases[: 24 if quick else 80])
        scaling = worker_scaling(12 if quick else 24, Path(scratch))
    store_s = overhead_s(record, len(cases))
    counts = {"cases": len(cases), "done": outcome.states.get("done", 0)}
    overhead = {"cpu_s_per_point": cpu_s, "overhead_ms": 1e3 * store_s, "store_s": store_s}
    print_figures(gains(per_point_s, in_process_s, alone_s) | scaling | overhead | stages | counts)


def gains(per_point_s: float, in_process_s: float, alone_s: float) -> dict[str, float]:
    """Return the gains of the sweep, against one process first, and its pace."""
    return {
        "over_one_process": round(in_process_s / per_point_s, 2),
        "over_one_by_one": round(alone_s / per_point_s, 2),
        "points_per_hour": round(3600 / per_point_s),
    }


def warm_up(record: StudyRecord, scratch: Path) -> None:
    """Compile the kernels of every number of frames that occurs."""
    kernels = Study(name="warm", base="examples/slab_balls", axis=record.study.axis[-1:])
    sweep(StudyRecord(kernels, record.base), scratch / "warm", local_workers(1))


def measured_alone(cases: list[Case], scratch: Path) -> float:
    """Return the mean seconds of `twin measure`, one process per case."""
    start = time.perf_counter()
    for case in cases:
        file, out = scratch / f"{case.digest}.toml", scratch / case.digest
        file.write_text(to_toml(case.experiment), encoding="utf-8")
        program = str(Path(sys.executable).with_name("twin"))
        command = [program, "measure", str(file), "-o", str(out)]
        subprocess.run(command, check=True, capture_output=True)
    return (time.perf_counter() - start) / len(cases)


def measured_in_process(cases: list[Case]) -> float:
    """Return the mean seconds of `measure`, after a first call that warms up."""
    measure(cases[0].experiment)
    return seconds(lambda: [measure(case.experiment) for case in cases]) / len(cases)


class _TimedMemory(Memory):
    """Adds up seconds and processor time of every stage that no other stage requests."""

    def __init__(self) -> None:
        super().__init__()
        self.seconds: Counter[str] = Counter()
        self.cpu_s: Counter[str] = Counter()
        self._inside = False

    def recall(self, stage, *arguments):
        """Recall a stage and time it."""
        if self._inside:
            return super().recall(stage, *arguments)
        self._inside, start, cpu_start = True, time.perf_counter(), time.process_time()
        try:
            return super().recall(stage, *arguments)
        finally:
            self._inside = False
            self.seconds[stage] += time.perf_counter() - start
            self.cpu_s[stage] += time.process_time() - cpu_start


def seconds_of_stages(cases: list[Case]) -> dict[str, float]:
    """Return seconds per case of every stage, measured in the sweep's order by one process."""
    first = CaseMeasurer()
    first(cases[0].experiment)
    memory, after = _TimedMemory(), Counter[str]()
    for _, case in in_sharing_order(cases, first.reads()):
        taken = measure(case.experiment, memory=memory).seconds
        after.update({f"{stage}_s": taken[stage] for stage in ("score", "object")})
    seconds = {
        name: sum(memory.seconds[stage] for stage in stages) for name, stages in STAGES.items()
    }
    path = ("trace_s", "light_s", "noise_s")
    seconds["path_cpu_s"] = sum(memory.cpu_s[stage] for name in path for stage in STAGES[name])
    return {name: value / len(cases) for name, value in (seconds | after).items()}


def worker_scaling(cases: int, scratch: Path) -> dict[str, float]:
    """Return the gain of a second worker, that of a second plain loop, and their ratio."""
    loops = [machine_speed_up()]
    one_s, two_s = (of_workers(count, cases, scratch) for count in (1, 2))
    loops.append(machine_speed_up())
    print(f"{cases} independent cases: {one_s:.1f} s by one worker, {two_s:.1f} s by two")
    figures = {"speed_up_2_workers": one_s / two_s, "machine_speed_up": sum(loops) / len(loops)}
    return figures | {
        "worker_efficiency": figures["speed_up_2_workers"] / figures["machine_speed_up"]
    }


def of_workers(count: int, cases: int, scratch: Path) -> float:
    """Return the run time of workers with one core each for cases that share only code."""
    base = load_experiment("examples/slab_balls", BASE)

    def of(low_mm: float, levels: int) -> list[Case]:
        axis = {"path": "elastomer.thickness_mm", "low": low_mm, "high": 4.0, "count": levels}
        return StudyRecord(Study(name="alone", base="x", axis=(axis,)), base).cases().unique()

    with lasting(local_workers(count, cores=count)) as workers:
        for name, chosen in (("warm", of(2.0, 6)), ("timed", of(2.5, cases))):
            store = Store(scratch / f"{name}_{count}")
            store.open()
            outcome = Run(store, workers)(chosen)
    if outcome.states != {"done": cases}:
        raise SystemExit(f"of {cases} cases ended: {dict(outcome.states)}")
    return outcome.seconds


def machine_speed_up() -> float:
    """Return the ratio of the rates of two and one process that count."""

    def run(count: int) -> None:
        for process in [subprocess.Popen(LOOP) for _ in range(count)]:
            process.wait()

    return 2 * seconds(lambda: run(1)) / seconds(lambda: run(2))


def overhead_s(record: StudyRecord, count: int) -> float:
    """Return seconds per case of engine, store and index, with a measurer that returns at once."""
    with tempfile.TemporaryDirectory() as scratch:
        store = Store(Path(scratch) / "store")
        store.open()
        run = Run(store, local_workers(1), make_measurer=_InstantMeasurer, done=Index(store).enter)
        return seconds(lambda: run(record.cases().unique())) / count


class _InstantMeasurer:
    """Returns a fixed result at once."""

    def __init__(self, keep: tuple[str, ...]) -> None:
        self.keep = keep

    def __call__(self, experiment, conditions=None):
        from twin.study.measuring import CaseResult

        return CaseResult({"value": experiment.coating.base_albedo, "warnings": []})

    def reads(self):
        return ((("coating", "base_albedo"),),)


if __name__ == "__main__":
    main()
