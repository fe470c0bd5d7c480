"""Design points per hour of a sweep, against the same cases one by one.

A study of three axes, coat albedo x hardness x fringe period, at 484 x 366 under force control
(under depth control hardness would change nothing but the force, and cost nothing): every hardness
is a press and a scene of its own, every coat a trace, every case its own camera noise, decoding and
score. The sweep runs on two workers into an empty store, start of the workers included; compiled
kernels are in the cache, as they are after the first case of a kind. Cases spread over the design
are then measured one by one: within one process, and by `twin measure`, one process each, as a user
would without a sweep.

`speed_up_2_workers` is of cases that share nothing but code: every thickness is a press, a scene
and a trace of its own. One worker process with the threads of one core stands against two such:
what is lost is lost to the engine (cases ahead, batches, store) and to the memory that both share.
The processes are started, and their kernels loaded, before the clock runs. Only an idle machine of
two cores or more tells the truth; `machine_speed_up`, of plain loops that share nothing at all,
taken before and after, says what it has to give: cores of a virtual machine are often less than 2.
`worker_efficiency` is the first over the second.

Last line: {"over_one_process": r, "over_one_by_one": r, "points_per_hour": n, ...}. The first is
like for like: `measure` called again and again in one process, so that nothing but the sharing and
the second worker is gained; the second also gains what starting a process per case takes. Also
given are the overhead of engine and store per case, and what each stage takes of a point: wall
clock of one process on all cores that measures cases in the order of the sweep, `press_s, trace_s,
light_s, noise_s, decode_s, score_s`, `object_s` of its comparison with the true object, and
`store_s`, the overhead.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

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
    # By hardness the sheet may deflect by 0.4 of its thickness, where `auto` takes a model that
    # needs a minute: the benchmark is about the sweep.
    "mechanics.model": "spectral",
}

# What the last line calls them: stages of `twin.pipeline.memory`.
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
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="48 cases instead of 320")
    quick = parser.parse_args().quick
    levels = (4, 3, 4) if quick else (8, 4, 10)
    record = StudyRecord(study_of(*levels), load_experiment("examples/slab_balls", BASE))
    cases = record.cases().unique()
    print(f"{len(cases)} cases of {' x '.join(map(str, levels))}, {os.cpu_count()} cores")
    with tempfile.TemporaryDirectory() as scratch:
        warm_up(record, Path(scratch))
        start = time.perf_counter()
        outcome = sweep(record, Path(scratch) / "store", local_workers(2))
        per_point_s = (time.perf_counter() - start) / len(cases)
        # Of the two workers: where the machine does other work too, this is what stays comparable.
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu_s = (used.ru_utime + used.ru_stime) / len(cases)
        print(f"sweep: {per_point_s:.3f} s per point ({dict(outcome.states)})")
        few = cases[:: max(1, len(cases) // (2 if quick else 4))][: 2 if quick else 4]
        alone_s = measured_alone(few, Path(scratch))
        in_process_s = measured_in_process(few)
        stages = seconds_of_stages(cases[: 24 if quick else 80])
        alike = (12 if quick else 24, Path(scratch))
        loops = [machine_speed_up()]
        one_s, two_s = (of_workers(count, *alike) for count in (1, 2))
        loops.append(machine_speed_up())
    print(f"{alike[0]} cases that share nothing: {one_s:.1f} s by one worker, {two_s:.1f} s by two")
    print(f"one by one: {in_process_s:.2f} s within one process, {alone_s:.2f} s by twin measure")
    print(
        json.dumps(
            gains(per_point_s, in_process_s, alone_s)
            | {
                "speed_up_2_workers": round(one_s / two_s, 2),
                "machine_speed_up": round(sum(loops) / len(loops), 2),
                "worker_efficiency": round(one_s / two_s * len(loops) / sum(loops), 3),
                "cpu_s_per_point": round(cpu_s, 3),
                "overhead_ms": round(1e3 * (store_s := overhead_s(record, len(cases))), 2),
                **stages,
                "store_s": round(store_s, 4),
                "cases": len(cases),
                "done": outcome.states.get("done", 0),
            }
        )
    )


def gains(per_point_s: float, in_process_s: float, alone_s: float) -> dict[str, float]:
    """Return what the sweep gains, like for like first, and its pace."""
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
        file = scratch / f"{case.digest}.toml"
        file.write_text(to_toml(case.experiment), encoding="utf-8")
        command = [str(Path(sys.executable).with_name("twin")), "measure", str(file)]
        out = str(scratch / case.digest)
        subprocess.run([*command, "-o", out], check=True, capture_output=True)
    return (time.perf_counter() - start) / len(cases)


def measured_in_process(cases: list[Case]) -> float:
    """Return the mean seconds of `measure`, after one that warms up."""
    measure(cases[0].experiment)
    start = time.perf_counter()
    for case in cases:
        measure(case.experiment)
    return (time.perf_counter() - start) / len(cases)


class _Timed(Memory):
    """Adds up the seconds of every stage that is asked for by no other."""

    def __init__(self) -> None:
        super().__init__()
        self.seconds: Counter[str] = Counter()
        self._inside = False

    def recall(self, stage, *arguments):
        """Recall a stage and time it."""
        if self._inside:
            return super().recall(stage, *arguments)
        self._inside, start = True, time.perf_counter()
        try:
            return super().recall(stage, *arguments)
        finally:
            self._inside = False
            self.seconds[stage] += time.perf_counter() - start


def seconds_of_stages(cases: list[Case]) -> dict[str, float]:
    """Return seconds per case of every stage, measured in the sweep's order by one process."""
    first = CaseMeasurer()
    first(cases[0].experiment)
    memory, after = _Timed(), Counter[str]()
    for _, case in in_sharing_order(cases, first.reads()):
        taken = measure(case.experiment, memory=memory).seconds
        after.update({f"{stage}_s": taken[stage] for stage in ("score", "object")})
    found = {
        name: sum(memory.seconds[stage] for stage in stages) for name, stages in STAGES.items()
    }
    return {name: round(value / len(cases), 4) for name, value in (found | after).items()}


def of_workers(count: int, cases: int, scratch: Path) -> float:
    """Return the seconds that workers of one core each take for cases that share nothing."""
    base = load_experiment("examples/slab_balls", BASE)

    def of(low_mm: float, levels: int) -> list[Case]:
        axis = {"path": "elastomer.thickness_mm", "low": low_mm, "high": 4.0, "count": levels}
        return StudyRecord(Study(name="alone", base="x", axis=(axis,)), base).cases().unique()

    with lasting(local_workers(count, cores=count)) as workers:
        for name, wanted in (("warm", of(2.0, 6)), ("timed", of(2.5, cases))):
            store = Store(scratch / f"{name}_{count}")
            store.open()
            outcome = Run(store, workers)(wanted)
    if outcome.states != {"done": cases}:
        raise SystemExit(f"of {cases} cases ended: {dict(outcome.states)}")
    return outcome.seconds


def machine_speed_up() -> float:
    """Return how much faster two processes count than one, at work all the time."""
    loop = [sys.executable, "-c", "sum(i * i for i in range(60_000_000))"]

    def seconds(count: int) -> float:
        start = time.perf_counter()
        for process in [subprocess.Popen(loop) for _ in range(count)]:
            process.wait()
        return time.perf_counter() - start

    return 2 * seconds(1) / seconds(2)


def overhead_s(record: StudyRecord, count: int) -> float:
    """Return seconds per case that engine, store and index take when measuring takes none."""
    with tempfile.TemporaryDirectory() as scratch:
        store = Store(Path(scratch) / "store")
        store.open()
        run = Run(store, local_workers(1), make_measurer=_Instant, done=Index(store).enter)
        start = time.perf_counter()
        run(record.cases().unique())
        return (time.perf_counter() - start) / count


class _Instant:
    """Answers at once."""

    def __init__(self, keep: tuple[str, ...]) -> None:
        self.keep = keep

    def __call__(self, experiment, conditions=None):
        from twin.study.measuring import CaseResult

        return CaseResult({"value": experiment.coating.base_albedo, "warnings": []})

    def reads(self):
        return ((("coating", "base_albedo"),),)


if __name__ == "__main__":
    main()
