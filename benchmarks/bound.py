"""Bounds of dimensions: against the spread of full measurements, their pace, their derivatives.

`bound_over_spread`: two balls are measured again and again with new noise, at 484 x 366; Cramer-Rao
bound over the spread of the fitted radii (of coat and object, both balls), geometric mean of the
four. `spread_over_spread`: the same of the predicted spread of these fits, and
`pixel_spread_over_sigma` of single pixels' heights, spread over predicted sigma, mean.
`uncertainty` is the standard uncertainty of one of the four ratios by the number of measurements.

`bound_points_per_hour`: the study of `./run bench sweep` (coat albedo x hardness x fringe period,
484 x 366) with a bound as its only metric, on two workers, start included. An idle machine of two
cores tells the truth; `cpu_s_per_point` is what stays comparable.

`gradient_rel`: largest relative difference between derivatives of the bound and central
differences at the same pixels, over eight fields. `gradient_evaluations`: cases that the search
`studies/least_bound` takes, of five fields, until it is as good as the best of a Sobol' study of
512 points (--quick: 64); 0 where it never is. Derivatives, search and study at 160 x 120.

Last line: {"bound_over_spread": r, "bound_points_per_hour": n, "gradient_rel": r,
"gradient_evaluations": n, ...}.
"""

import argparse
import json
import resource
import tempfile
import time
from pathlib import Path

import numpy as np
from sweep import BASE, study_of

from twin.config import Experiment, load_experiment, vary
from twin.config.study import Study, load_study
from twin.pipeline import Memory, measure
from twin.pipeline.bound import bounds_alone, predicted
from twin.pipeline.gradients import bound_gradient, value_at
from twin.pipeline.press import press
from twin.results.bound import information_shares
from twin.study.record import StudyRecord
from twin.study.sweep import sweep
from twin.study.table import read_table
from twin.study.workers import local_workers

RADII = ("object_radius_1", "object_radius_2", "sphere_1_radius", "sphere_2_radius")
SMALL = {"camera.width_px": 640, "camera.height_px": 480, "press.relief_pitch_mm": 0.05}
BLURRED = {"projector.aperture_mm": 10.0, "projector.focus_mm": 205.0}
# Fields, and steps of the central differences: small beside what bends, large beside rounding.
STEPS = {
    "coating.base_albedo": 0.001,
    "coating.flake_fraction": 0.001,
    "coating.flake_roughness": 0.001,
    "projector.pose.polar_deg": 0.05,
    "projector.pose.standoff_mm": 0.2,
    "projector.focus_mm": 0.5,
    "projector.blur_px": 0.01,
    "patterns.period_px": 0.05,
}
METRIC = "crb_radius_um"


def main() -> None:
    """Print one JSON line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer measurements and points")
    quick = parser.parse_args().quick
    found = against_spread(60 if quick else 250)
    print(json.dumps(found), flush=True)
    found |= pace((4, 3, 4) if quick else (8, 4, 10))
    print(json.dumps(found), flush=True)
    found |= {"gradient_rel": round(gradient_error(), 6)}
    print(json.dumps(found), flush=True)
    found |= evaluations(64 if quick else 512)
    print(json.dumps(found))


def against_spread(count: int) -> dict[str, float]:
    """Return bounds and predictions over the spread of so many measurements."""
    experiment = load_experiment("examples/slab_balls", {"camera.binning": 4})
    memory, figures, heights = Memory(), [], []
    for trial in range(count):
        done = measure(experiment, memory=memory, trial=trial)
        figures.append(done.metrics)
        heights.append(done.fringes.reconstruction.point_map.points_world_mm[..., 2].copy())
    bounds = bounds_alone(experiment, memory)[1]
    prediction, _ = predicted(experiment, press(experiment, memory), memory)
    everywhere = prediction.valid & np.all([one != 0.0 for one in heights], axis=0)
    spread_mm = np.std([one[everywhere] for one in heights], axis=0, ddof=1, dtype=np.float64)
    spreads = {
        name: 1e3 * float(np.std([one[f"{name}_mm"] for one in figures], ddof=1)) for name in RADII
    }
    ratios = {
        kind: np.exp(np.mean([np.log(bounds[f"{n}_{kind}_um"] / spreads[n]) for n in RADII]))
        for kind in ("crb", "spread")
    }
    return {
        "bound_over_spread": round(float(ratios["crb"]), 4),
        "spread_over_spread": round(float(ratios["spread"]), 4),
        "pixel_spread_over_sigma": round(
            float(np.mean(spread_mm / prediction.filtered_mm[everywhere])), 4
        ),
        "uncertainty": round(float(1.0 / np.sqrt(2.0 * (count - 1))), 4),
        "measurements": count,
    }


def pace(levels: tuple[int, int, int]) -> dict[str, float]:
    """Return design points per hour of a study of bounds."""
    study = study_of(*levels).model_copy(update={"metrics": (METRIC,)})
    record = StudyRecord(study, load_experiment("examples/slab_balls", BASE))
    count = len(record.cases().unique())
    with tempfile.TemporaryDirectory() as scratch:
        start = time.perf_counter()
        outcome = sweep(record, Path(scratch) / "store", local_workers(2))
        seconds = time.perf_counter() - start
    if outcome.states != {"done": count}:
        raise SystemExit(f"of {count} cases ended: {dict(outcome.states)}")
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "bound_points_per_hour": round(3600.0 * count / seconds),
        "cpu_s_per_point": round((used.ru_utime + used.ru_stime) / count, 3),
        "points": count,
    }


def gradient_error() -> float:
    """Return the largest relative difference between derivatives and central differences."""
    small = {"camera.binning": 4, "press.solver_pitch_mm": 0.16} | SMALL
    experiment, memory = load_experiment("examples/slab_balls", small | BLURRED), Memory()
    figures, slopes = bound_gradient(experiment, list(STEPS), memory)
    pressed = press(experiment, memory)
    prediction, truth = predicted(experiment, pressed, memory)
    share = information_shares(experiment, prediction, truth, pressed.pressed)[METRIC]

    def log_bound(seen: Experiment) -> float:
        sigma_mm = predicted(seen, press(seen, memory), memory)[0].single_mm
        return float(np.sum(share * np.log(np.where(share > 0.0, sigma_mm, 1.0))))

    worst = 0.0
    for number, (path, step) in enumerate(STEPS.items()):
        value = value_at(experiment, path)
        low, high = (log_bound(vary(experiment, {path: value + by})) for by in (-step, step))
        differences = figures[METRIC] * (high - low) / (2.0 * step)
        error = slopes[METRIC][number] / differences - 1.0
        print(f"{path}: {slopes[METRIC][number]:.6g} by differentiation, {error:+.1e} off")
        worst = max(worst, abs(error))
    return worst


def evaluations(points: int) -> dict[str, float]:
    """Return how many cases the search takes to be as good as so many Sobol' points."""
    searching, base = load_study("studies/least_bound")
    base = vary(base, SMALL | {"press.solver_pitch_mm": 0.16})
    settings = searching.model_dump() | {"gradient": None}
    settings |= {"sampling": {"method": "sobol", "count": points}}
    filling = Study.model_validate(settings)
    with tempfile.TemporaryDirectory() as scratch:
        tables = []
        for study in (filling, searching):
            folder = Path(scratch) / study.sampling.method
            sweep(StudyRecord(study, base), folder, local_workers(2))
            tables.append([row[METRIC] for row in read_table(folder).rows])
    best = min(tables[0])
    reached = [n for n, value in enumerate(tables[1], start=1) if value <= best]
    return {
        "gradient_evaluations": reached[0] if reached else 0,
        "search_best_um": round(min(tables[1]), 5),
        "sobol_best_um": round(best, 5),
        "sobol_points": points,
    }


if __name__ == "__main__":
    main()
