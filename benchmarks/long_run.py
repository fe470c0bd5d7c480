"""Many cases by one worker process: memory, handles, threads, files and caches level off.

One worker measures a study of balls (diameter x albedo of the coat, 80 x 60 pixels), so that every
stage is computed again and again. After each case it logs its figures. The growth of a figure is
the slope of a straight line through the last quarter of the cases, per 1,000 cases: before that the
caches of the latest presses fill.

Last line: {"cases": n, "memory_mb": ..., "memory_growth_mb": ..., "handles": ..., ...}. The exit
code is 1 if memory grows by more than `MOST_MB`, or any count by more than `MOST_COUNT`, per 1,000
cases.
"""

import os
import sys
import tempfile
import threading
from pathlib import Path

import numpy as np

from benchmarks._harness import print_figures, quick_parser, resident_bytes
from twin.caches import caches
from twin.config import load_experiment
from twin.config.study import Study
from twin.study.measuring import NOMINAL_CONDITIONS, CaseMeasurer, CaseResult
from twin.study.record import StudyRecord
from twin.study.sweep import sweep
from twin.study.workers import local_workers

BASE = {
    "camera.binning": 4,
    "camera.width_px": 320,
    "camera.height_px": 240,
    "press.solver_pitch_mm": 0.4,
}
LOG = "LONG_RUN_LOG"
NAMES = ("memory_mb", "handles", "threads", "temporary_files", "cache_files", "cache_mb")
MOST_MB, MOST_COUNT = 100.0, 20.0
"""Growth per 1,000 cases that a run of days can bear (assumed)."""


class WatchedMeasurer(CaseMeasurer):
    """Measures cases, and logs the resources of its process after each."""

    def __call__(self, experiment, conditions=NOMINAL_CONDITIONS) -> CaseResult:
        """Measure one case."""
        result = super().__call__(experiment, conditions)
        with Path(os.environ[LOG]).open("a") as file:
            file.write(f"{' '.join(map(str, resources()))}\n")
        return result


def resources() -> tuple[float, ...]:
    """Return the figures of `NAMES` of this process; temporary files are those of its folder."""
    stored = caches()
    return (
        resident_bytes("VmRSS") / 1e6,
        len(list(Path("/proc/self/fd").iterdir())),
        max(threading.active_count(), len(list(Path("/proc/self/task").iterdir()))),
        len(list(Path(tempfile.gettempdir()).rglob("*"))),
        sum(len(list(cache.files())) for cache in stored),
        sum(cache.size_bytes() for cache in stored) / 1e6,
    )


def record_of(cases: int) -> StudyRecord:
    """Return the study: 10 albedos of the coat for each diameter of the ball."""
    albedo = {"path": "coating.base_albedo", "values": np.linspace(0.2, 0.7, 10).tolist()}
    diameters = np.linspace(6.0, 10.0, cases // 10).tolist()
    diameter = {"path": "specimen.diameter_mm", "values": diameters}
    study = Study(name="long_run", base="x", axis=(diameter, albedo))
    return StudyRecord(study, load_experiment("examples/slab_ball", BASE))


def main() -> int:
    """Run the study and print the figures."""
    parser = quick_parser(__doc__, "100 cases instead of 1,000")
    parser.add_argument("--cases", type=int, help="a multiple of 10")
    chosen = parser.parse_args()
    cases = chosen.cases or (100 if chosen.quick else 1000)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # Own folders, which no other process uses.
        for own in ("temporary", "kernels"):
            (folder / own).mkdir()
        os.environ |= {
            LOG: str(folder / "log"),
            "TMPDIR": str(folder / "temporary"),
            "DRJIT_CACHE_DIR": str(folder / "kernels"),
        }
        workers = local_workers(1, cores=2)
        sweep(record_of(cases), folder / "out", workers, make_measurer=WatchedMeasurer)
        rows = np.loadtxt(folder / "log")
    for row in rows[9::10]:
        print(*(f"{figure}={value:g}" for figure, value in zip(NAMES, row, strict=True)))
    last = rows[3 * len(rows) // 4 :]
    growth = 1000 * np.polyfit(np.arange(len(last)), last, 1)[0]
    figures: dict[str, object] = {"cases": len(rows)}
    for number, figure in enumerate(NAMES):
        figures |= {figure: float(rows[-1, number]), f"{figure}_growth": float(growth[number])}
    print_figures(figures)
    limits = [MOST_MB if figure.endswith("_mb") else MOST_COUNT for figure in NAMES]
    return int(len(rows) != cases or bool((growth > limits).any()))


if __name__ == "__main__":
    sys.exit(main())
