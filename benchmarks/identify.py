"""Coverage of identified values, and reports of correlated parameters.

120 sensors (--quick: twelve) with a slab of hidden thickness, hardness and travel, drawn from the
priors, are measured by the whole chain: pressed, rendered, exposed, decoded, fitted. Their radius,
relief and force, with the noise of the rows added, are the input of `twin identify`, trained on
other simulations of the same chain. 68 and 95 % of the hidden values must be inside the 68 and 95 %
intervals: the three of a sensor are correlated, so 120 sensors determine the shares to 4 and 2 %.
Then the relief only is given, of hardness and travel: their correlation must be reported.

Last, the paper: its problem is identified (--quick: 25 % of the simulations, none refined; --kept
FOLDER reuses the simulations of an earlier run), and its rows that the twin meets are counted:
fitted rows within one standard deviation of the difference from the prediction with any coat (for
rows held out in turn, by the other rows), predicted rows within two standard deviations of the
paper's single measurements; rows that steered a choice are not counted. The other rows are printed
with their numbers.

Last line: {"coverage_68", "coverage_95", "intervals", "ridge_told_share", "learned_over_row_sd",
"paper_fitted_within_sd", "paper_held_out_within_2sd", "held_out_rows", "seconds"}.
`learned_over_row_sd` is the largest cross-validated error of an emulator over the row's own
standard deviation; the paper's two are shares.
"""

import tempfile
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks._harness import print_figures, quick_parser
from reconstruction.arrays import FloatArray
from twin.config import load_experiment
from twin.config.problem import SensorProblem, load_problem
from twin.config.study import Sampling
from twin.identification.findings import Marginal, Prediction
from twin.identification.known import Identified, SensorModel
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
    """Return the problem; the values of its rows are set later."""
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
    """Add noise (row,), in standard deviations of the rows, to a sensor's figures; identify it."""
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
    """Identify sensors on two workers."""
    noise = rng.standard_normal((len(sensors), len(problem.rows)))
    workers = local_workers(2)
    executor = workers.open()
    solutions = list(executor.map(partial(identified, problem, simulated), sensors, noise))
    workers.close(executor)
    return solutions


def covered(marginal: Marginal, value: float) -> tuple[bool, bool]:
    """Return whether a value is inside the 68 and the 95 % interval."""
    inside_68 = marginal.low_68 <= value <= marginal.high_68
    return inside_68, marginal.low_95 <= value <= marginal.high_95


def judged_difference(best: SensorModel, row: Prediction) -> float:
    """Return the difference of a row, in SD; of a fitted row not from its own prediction."""
    return best.rotated.get(row.row, row).deviation if row.fitted else row.steps


def paper_figures(folder: Path, quick: bool) -> dict[str, float | int]:
    """Identify the paper's sensor; return the shares of its rows that the twin meets."""
    problem, experiments = load_problem("paper/identify")
    chosen = problem.quick() if quick else problem
    best = identify(chosen, experiments, folder, local_workers(2)).best
    rows, judged = best.predictions, partial(judged_difference, best)
    for row in rows:
        if abs(judged(row)) > (FITTED_WITHIN if row.fitted else HELD_OUT_WITHIN):
            twin = f"{row.twin.mean:.4g}, SD {row.twin.sd:.2g}"
            use = "fitted" if row.fitted else "held out"
            print(f"unexplained: {row.row} ({use}): paper {row.measured:.4g}, twin {twin}")
    fitted = [abs(judged(row)) <= FITTED_WITHIN for row in rows if row.fitted]
    predicted = [row for row in rows if problem.rows[row.row].use == "predicted"]
    held = [abs(judged(row)) <= HELD_OUT_WITHIN for row in predicted]
    return {
        "paper_fitted_within_sd": float(np.mean(fitted)),
        "paper_held_out_within_2sd": float(np.mean(held)),
        "held_out_rows": len(held),
    }


def synthetic_figures(quick: bool) -> dict[str, float | int]:
    """Identify sensors of hidden values; return shares covered and correlations reported."""
    count, sensors, ridge_sensors = (64, 12, 3) if quick else (160, 120, 10)
    rng = np.random.default_rng(3)
    experiments = {"balls": load_experiment("examples/slab_balls", BASE)}
    whole = problem_of(count, list(FREE), list(ROWS))
    relief = problem_of(count, ["hardness", "travel"], ["relief"])
    with tempfile.TemporaryDirectory() as folder:
        simulated = simulate(whole, experiments, Path(folder) / "whole", local_workers(2))
        hidden = hidden_sensors(whole, sensors, Path(folder) / "hidden")
        solutions = every_identified(whole, simulated, hidden, rng)
        reliefs = simulate(relief, experiments, Path(folder) / "relief", local_workers(2))
        few = hidden_sensors(relief, ridge_sensors, Path(folder) / "hidden_relief")
        ridges = [result.ridges() for result in every_identified(relief, reliefs, few, rng)]
    pairs = [(result.intervals(), sensor) for result, sensor in zip(solutions, hidden, strict=True)]
    hits = np.array([covered(i[name], sensor[name]) for i, sensor in pairs for name in FREE])
    emulators = solutions[0].best.emulators
    errors = [emulators[n].cross_validated_rmse / row.sd for n, row in whole.rows.items()]
    return {
        "coverage_68": float(hits[:, 0].mean()),
        "coverage_95": float(hits[:, 1].mean()),
        "intervals": len(hits),
        "ridge_told_share": float(np.mean([len(pairs) == 1 for pairs in ridges])),
        "learned_over_row_sd": float(max(errors)),
    }


def main() -> None:
    """Identify hidden sensors and the paper's; print one JSON line."""
    parser = quick_parser(__doc__, "twelve sensors, fewer simulations")
    parser.add_argument("--kept", type=Path, help="folder of the paper's simulations")
    chosen = parser.parse_args()
    start, figures = time.perf_counter(), synthetic_figures(chosen.quick)
    with tempfile.TemporaryDirectory() as folder:
        figures |= paper_figures(chosen.kept or Path(folder), chosen.quick)
    print_figures(figures | {"seconds": time.perf_counter() - start})


if __name__ == "__main__":
    main()
