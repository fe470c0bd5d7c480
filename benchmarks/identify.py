"""Coverage of identified values, and whether inseparable ones are told.

120 sensors (--quick: twelve) with a slab of hidden thickness, hardness and travel, drawn from the
priors, are measured by the whole chain: pressed, rendered, exposed, decoded, fitted. Their radius,
relief and force, moved by the rows' own noise, are given to `twin identify`, which learned the same
chain from other simulations. 68 and 95 % intervals must cover the hidden values so often: the three
of a sensor lie in or out together, so 120 sensors tell the shares to 4 and 2 %. Then the relief
alone is given, of hardness and travel: their trade-off must be told as a ridge.

Last, the paper: its problem is identified (--quick: a quarter of the simulations, none refined;
--kept FOLDER goes on from what an earlier run simulated), and its rows counted that the twin meets:
fitted ones within one standard deviation of the paper's single measurements, held-out ones within
two. The rows that it does not meet are printed with their numbers.

Last line: {"coverage_68", "coverage_95", "intervals", "ridge_told_share", "learned_over_row_sd",
"paper_fitted_within_sd", "paper_held_out_within_2sd", "held_out_rows", "seconds"}.
`learned_over_row_sd` is the largest cross-validated error of an emulator over the row's own
standard deviation; the paper's two are shares.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from reconstruction.arrays import FloatArray
from twin.config import load_experiment
from twin.config.problem import SensorProblem, load_problem
from twin.config.study import Sampling
from twin.identification.findings import Marginal
from twin.identification.known import Identified
from twin.identification.run import identify, infer
from twin.identification.simulations import Simulated, Variant, record_of, simulate
from twin.study.record import StudyRecord
from twin.study.sweep import sweep
from twin.study.table import read_table
from twin.study.workers import local_workers

ROWS = {
    "radius": {"metric": "sphere_1_radius_mm", "sd": 0.1},
    "relief": {"metric": "relief_peak_mm", "sd": 0.004},
    "force": {"metric": "force_n", "sd": 0.05},
}
FREE = {
    "thickness": {"path": "elastomer.thickness_mm", "low": 2.0, "high": 3.5},
    "hardness": {"path": "elastomer.shore_a", "low": 6.0, "high": 14.0},
    "travel": {"path": "press.depth_mm", "low": 0.5, "high": 0.8},
}
FITTED_WITHIN, HELD_OUT_WITHIN = 1.0, 2.0
BASE = {"camera.binning": 4, "mechanics.model": "spectral"}


def problem_of(count: int, free: list[str], rows: list[str]) -> SensorProblem:
    """Return the problem; the rows' values are given later."""
    return SensorProblem.model_validate(
        {
            "name": "bench",
            "experiments": {"balls": {"base": "examples/slab_balls"}},
            "free": {name: FREE[name] for name in free},
            "rows": {name: ROWS[name] | {"experiment": "balls", "value": 0.0} for name in rows},
            "design": {"count": count},
        }
    )


def hidden_sensors(problem: SensorProblem, count: int, folder: Path) -> list[Mapping[str, float]]:
    """Measure sensors drawn from the priors; settings and figures by name."""
    record = record_of(problem, load_experiment("examples/slab_balls", BASE), Variant("balls"))
    sampling = Sampling(method="latin_hypercube", count=count, seed=11)
    study = record.study.model_copy(update={"sampling": sampling})
    hidden = StudyRecord(study, record.base)
    sweep(hidden, folder, local_workers(2))
    return list(read_table(folder).rows)


def identified(
    problem: SensorProblem,
    simulated: Mapping[Variant, Simulated],
    sensor: Mapping[str, float],
    noise: FloatArray,
) -> Identified:
    """Read a sensor with the rows' noise (row,), in their standard deviations, and identify it."""
    read = {
        name: row.model_copy(update={"value": sensor[row.metric] + row.sd * shift})
        for (name, row), shift in zip(problem.rows.items(), noise.tolist(), strict=True)
    }
    return infer(problem.model_copy(update={"rows": read}), simulated)


def every_identified(
    problem: SensorProblem,
    simulated: Mapping[Variant, Simulated],
    sensors: list[Mapping[str, float]],
    rng: np.random.Generator,
) -> list[Identified]:
    """Identify sensors side by side."""
    noise = rng.standard_normal((len(sensors), len(problem.rows)))
    workers = local_workers(2)
    executor = workers.open()
    found = list(executor.map(partial(identified, problem, simulated), sensors, noise))
    workers.close(executor)
    return found


def covered(one: Marginal, value: float) -> tuple[bool, bool]:
    """Tell whether the 68 and the 95 % interval hold a value."""
    return one.low_68 <= value <= one.high_68, one.low_95 <= value <= one.high_95


def paper_figures(folder: Path, quick: bool) -> dict[str, float | int]:
    """Identify the paper's sensor; return how many of its rows the twin meets."""
    problem, experiments = load_problem("paper/identify")
    asked = problem.quick() if quick else problem
    rows = identify(asked, experiments, folder, local_workers(2)).best.predictions
    for row in rows:
        if abs(row.steps) > (FITTED_WITHIN if row.fitted else HELD_OUT_WITHIN):
            told = f"{row.twin.mean:.4g}, SD {row.twin.sd:.2g}"
            use = "fitted" if row.fitted else "held out"
            print(f"unexplained: {row.row} ({use}): paper {row.measured:.4g}, twin {told}")
    fitted = [abs(row.steps) <= FITTED_WITHIN for row in rows if row.fitted]
    held = [abs(row.steps) <= HELD_OUT_WITHIN for row in rows if not row.fitted]
    return {
        "paper_fitted_within_sd": round(float(np.mean(fitted)), 3),
        "paper_held_out_within_2sd": round(float(np.mean(held)), 3),
        "held_out_rows": len(held),
    }


def synthetic_figures(quick: bool) -> dict[str, float | int]:
    """Identify sensors of hidden values; return how often they are covered, and ridges told."""
    count, sensors, ridge_sensors = (64, 12, 3) if quick else (160, 120, 10)
    rng = np.random.default_rng(3)
    experiments = {"balls": load_experiment("examples/slab_balls", BASE)}
    whole = problem_of(count, list(FREE), list(ROWS))
    relief = problem_of(count, ["hardness", "travel"], ["relief"])
    with tempfile.TemporaryDirectory() as folder:
        simulated = simulate(whole, experiments, Path(folder) / "whole", local_workers(2))
        hidden = hidden_sensors(whole, sensors, Path(folder) / "hidden")
        found = every_identified(whole, simulated, hidden, rng)
        alone = simulate(relief, experiments, Path(folder) / "relief", local_workers(2))
        told = hidden_sensors(relief, ridge_sensors, Path(folder) / "hidden_relief")
        ridges = [one.ridges() for one in every_identified(relief, alone, told, rng)]
    hits = np.array(
        [
            covered(one.intervals()[name], sensor[name])
            for one, sensor in zip(found, hidden, strict=True)
            for name in FREE
        ]
    )
    emulators = found[0].best.emulators
    errors = [emulators[n].cross_validated_rmse / row.sd for n, row in whole.rows.items()]
    return {
        "coverage_68": round(float(hits[:, 0].mean()), 3),
        "coverage_95": round(float(hits[:, 1].mean()), 3),
        "intervals": len(hits),
        "ridge_told_share": float(np.mean([len(one) == 1 for one in ridges])),
        "learned_over_row_sd": round(float(max(errors)), 3),
    }


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--kept", type=Path, help="folder of the paper's simulations")
    asked = parser.parse_args()
    start, figures = time.perf_counter(), synthetic_figures(asked.quick)
    with tempfile.TemporaryDirectory() as folder:
        figures |= paper_figures(asked.kept or Path(folder), asked.quick)
    figures["seconds"] = round(time.perf_counter() - start, 1)
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
