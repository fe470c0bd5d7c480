"""Bounds of dimensions: against the spread of full measurements, their pace, their derivatives.

`bound_over_spread`: two balls are measured repeatedly with other noise, at 484 x 366; Cramer-Rao
bound over the spread of the fitted radii (of coat and object, both balls), geometric mean of the
four. `spread_over_spread`: the same of the predicted spread of these fits;
`pixel_spread_over_sigma`: spread over predicted sigma of single pixels' heights, mean.
`uncertainty`: standard uncertainty of one of the four ratios from the number of measurements.

`bound_points_per_hour`: the study of `./run bench sweep` (coat albedo x hardness x fringe period,
484 x 366) with a bound as its only metric, on two workers, start included, valid on an idle machine
of two cores; `cpu_s_per_point` remains comparable on a busy one.

`gradient_rel`: largest relative difference between derivatives of the bound and central
differences at the same pixels, over eight fields. `gradient_evaluations`: cases of five fields that
the search `studies/least_bound` takes until it is as good as the best of a Sobol' study of 512
points (--quick: 64); 0 if it never is. Derivatives, search and study at 160 x 120.

Last line: {"bound_over_spread": r, "bound_points_per_hour": n, "gradient_rel": r,
"gradient_evaluations": n, ...}.
"""

import tempfile
from pathlib import Path

import numpy as np

from benchmarks._harness import print_figures, processor_s, quick_parser, seconds
from benchmarks.sweep import BASE, study_of
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

# Radii with a bound, and the figures with the same spread: behind a thick slab no object radius is
# reported, only the radius of the coat that its fit uses.
RADII = {
    "object_radius_1": "object_radius_1_coat_mm",
    "object_radius_2": "object_radius_2_coat_mm",
    "sphere_1_radius": "sphere_1_radius_mm",
    "sphere_2_radius": "sphere_2_radius_mm",
}
SMALL = {"camera.width_px": 640, "camera.height_px": 480, "press.relief_pitch_mm": 0.05}
BLURRED = {"projector.aperture_mm": 10.0, "projector.focus_mm": 205.0}
# Fields, and steps of the central differences: above rounding, below the curvature.
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
    """Print one JSON line; each part prints the figures so far."""
    quick = quick_parser(__doc__, "fewer measurements and points").parse_args().quick
    figures: dict[str, float] = {}
    for part in (
        lambda: against_spread(60 if quick else 250),
        lambda: pace((4, 3, 4) if quick else (8, 4, 10)),
        lambda: {"gradient_rel": gradient_error()},
        lambda: evaluations(64 if quick else 512),
    ):
        figures |= part()
        print_figures(figures)


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
    everywhere = prediction.valid & np.all([height != 0.0 for height in heights], axis=0)
    spread_mm = np.std([height[everywhere] for height in heights], axis=0, ddof=1, dtype=np.float64)
    spreads = {
        name: 1e3 * float(np.std([row[figure] for row in figures], ddof=1))
        for name, figure in RADII.items()
    }
    ratios = {
        kind: np.exp(np.mean([np.log(bounds[f"{n}_{kind}_um"] / spreads[n]) for n in RADII]))
        for kind in ("crb", "spread")
    }
    pixels = np.mean(spread_mm / prediction.filtered_mm[everywhere])
    return {
        "bound_over_spread": float(ratios["crb"]),
        "spread_over_spread": float(ratios["spread"]),
        "pixel_spread_over_sigma": float(pixels),
        "uncertainty": float(1.0 / np.sqrt(2.0 * (count - 1))),
        "measurements": count,
    }


def pace(levels: tuple[int, int, int]) -> dict[str, float]:
    """Return design points per hour of a study of bounds."""
    study = study_of(*levels).model_copy(update={"metrics": (METRIC,)})
    record = StudyRecord(study, load_experiment("examples/slab_balls", BASE))
    count = len(record.cases().unique())
    states = []
    with tempfile.TemporaryDirectory() as scratch:
        store, workers = Path(scratch) / "store", local_workers(2)
        run_s = seconds(lambda: states.append(sweep(record, store, workers).states))
    if states != [{"done": count}]:
        raise SystemExit(f"of {count} cases ended: {states}")
    pace = round(3600.0 * count / run_s)
    per_point_s = processor_s() / count
    return {"bound_points_per_hour": pace, "cpu_s_per_point": per_point_s, "points": count}


def gradient_error() -> float:
    """Return the largest relative difference between derivatives and central differences."""
    small = {"camera.binning": 4, "press.solver_pitch_mm": 0.16} | SMALL
    experiment, memory = load_experiment("examples/slab_balls", small | BLURRED), Memory()
    figures, slopes = bound_gradient(experiment, list(STEPS), memory)
    pressed = press(experiment, memory)
    prediction, truth = predicted(experiment, pressed, memory)
    share = information_shares(experiment, prediction, truth, pressed.pressed)[METRIC]

    def log_bound(observed: Experiment) -> float:
        sigma_mm = predicted(observed, press(observed, memory), memory)[0].single_mm
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
    """Return the number of cases until the search is as good as so many Sobol' points."""
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
        "search_best_um": min(tables[1]),
        "sobol_best_um": best,
        "sobol_points": points,
    }


if __name__ == "__main__":
    main()
