"""The object behind the coat: accuracy against the truth of other models, uncertainty, speed.

- `rendered`: two joined balls of 4 mm under a sheet of 0.2 mm, rendered, decoded and compensated
  (`examples/wrapped_balls`, 968 x 732 pixels; `--quick`: 484 x 366): largest error of both radii
  and of the force; processor seconds of the compensation only;
- `gel`: a ball in a gel on a window: stored large-strain solid elements, 10 um of noise per 80 um,
  three seeds: largest relative errors of radius and force;
- `bars`: bars A, B and C of the paper on its rig and press, rendered (`--quick`: A only): largest
  error of the width, with the coat's texture as identified, edges known;
- `coverage`: a ball under a round sheet of 12 mm by the one-dimensional solver of the tests, 5 um
  of noise, thickness uncertain by 2 %: share of 400 trials (`--quick`: 40) with the true radius
  within k = 1.96 times the standard uncertainty;
- `slab`: a ball of 8 mm under a slab of 3 mm, the model exact (coat pressed on another grid, 5 um
  of noise per 0.1 mm), without air and with 10 kPa: root mean square error of the diameter over its
  Cramer-Rao bound, the larger of both, over 40 seeds (`--quick`: 6); and the radius of a second
  ball when the assumed thickness is 1 % too small, before and after a calibration on the first;
- `strain`: eight balls under slabs, coats from large-strain solids: RMS of error over uncertainty.

Last line: {"ball_radius_error_mm", "force_rel", "rod_width_error_mm", ...}.
"""

import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks._harness import print_figures, quick_parser
from reconstruction.compensation import (
    GelLayer,
    SheetOpening,
    compensate_gel,
    compensate_sheet,
    parts_of,
    relief_on_frame,
)
from tests.compensation.sheets import coat_points, layer_of, pressed_ball
from tests.compensation.slabs import coat_points as slab_points
from tests.compensation.slabs import layer_of as slab_layer
from tests.compensation.slabs import pressed, slab, with_load
from tests.oracles.axisymmetric import Resolution, RoundSlab, press_axisymmetric
from twin.config import load_experiment, sensor_layer
from twin.mechanics.layer import BondedLayer
from twin.pipeline import measure
from twin.pipeline.compensation import compensate_points, object_figures, with_compensation
from twin.pipeline.slab_object import calibrate_slab, fit_slab, slab_object
from twin.specimens import shape_of
from twin.specimens.kinds.ball import Ball

SOLIDS = Path(__file__).parents[1] / "tests/mechanics/reference/neo_hookean.json"
RADIUS_MM = 4.0
SIDE_CELLS, GEL_PITCH_MM = 140, 0.08
GEL_NOISE_MM, SEEDS = 0.01, 3
TRIALS, QUICK_TRIALS = 400, 40
THICKNESS_MM, THICKNESS_SHARE, TRIAL_NOISE_MM = 0.2, 0.02, 0.005
K_95 = 1.96
BALL, OTHER_BALL = Ball(diameter_mm=8.0, x_mm=0.13, y_mm=-0.07), Ball(diameter_mm=6.0)
DIAMETER = "specimen.diameter_mm"
SLAB_AIR_KPA, SLAB_TRAVEL_MM = 10.0, 0.7
SLAB_SEEDS, QUICK_SEEDS = 40, 6
# Radius, thickness, depth; the first three were used to choose the range of the theory.
STRAIN_CASES = (
    (4.0, 3.0, 0.75), (4.0, 4.0, 1.0), (4.0, 2.0, 0.5), (2.4, 3.0, 0.6), (6.0, 3.0, 0.6),
    (4.0, 5.0, 1.0), (3.0, 4.0, 0.8), (5.0, 2.5, 0.7),
)  # fmt: skip
STRAIN_RIM_MM, STRAIN_NOISE_MM = 10.0, 5e-4

Figures = dict[str, float | None]


def rendered_balls(quick: bool) -> Figures:
    """Measure the two balls by the whole chain, and compensate."""
    settings = {"camera.binning": 4 if quick else 2}
    experiment = load_experiment("examples/wrapped_balls", settings)
    done = measure(experiment)
    points = done.fringes.reconstruction.point_map
    layer = sensor_layer.sensor_layer_of(experiment)
    started = time.process_time()
    estimate = compensate_points(points, layer)
    figures = object_figures(estimate, shape_of(experiment.specimen).spheres())
    seconds = time.process_time() - started
    radii = [figures[f"compensated_sphere_{n}_radius_mm"] for n in (1, 2)]
    print(f"balls: {radii} mm, coat {[s.measured.radius_mm for s in done.score.spheres]}")
    return {
        "ball_radius_error_mm": max(abs(radius - RADIUS_MM) for radius in radii),
        "force_rel": abs(estimate.force_n / done.press.force_n - 1),
        "seconds": seconds,
    }


def rendered_bars(quick: bool) -> Figures:
    """Measure single bars by the whole chain, and compensate."""
    errors = []
    for letter in "a" if quick else "abc":
        done = measure(load_experiment(f"paper/bars_{letter}", {"camera.binning": 2}))
        figures = with_compensation(done).figures
        (true,) = done.experiment.specimen.widths_mm
        width, sigma = (figures[f"compensated_bar_1_width_{name}"] for name in ("mm", "sigma_um"))
        print(f"bar {letter}: {width:.4f} mm, u {sigma:.1f} um, of {true:g} mm")
        errors.append(abs(width - true))
    return {"rod_width_error_mm": max(errors)}


def gel_ball() -> Figures:
    """Compensate the coat of a large-strain gel."""
    case = json.loads(SOLIDS.read_text(encoding="utf-8"))["bonded_r4_h4_d1"]
    thickness, nu = case["slab"]["thickness_mm"], case["slab"]["poisson_ratio"]
    side = SIDE_CELLS * GEL_PITCH_MM
    places = (np.arange(SIDE_CELLS) + 0.5) * GEL_PITCH_MM - side / 2
    x, y = np.meshgrid(places, places)
    true_z = CubicSpline(case["r_mm"], case["touched_face_mm"])(np.minimum(np.hypot(x, y), 10.0))
    margin = int(np.ceil(3 * thickness / GEL_PITCH_MM))
    count = SIDE_CELLS + 2 * margin
    bonded = BondedLayer(count, count, count * GEL_PITCH_MM, count * GEL_PITCH_MM, thickness, nu)
    radii, forces = [], []
    for seed in range(SEEDS):
        z = true_z + np.random.default_rng(seed).normal(scale=GEL_NOISE_MM, size=x.shape)
        points = np.stack((x, y, z), axis=-1).reshape(-1, 3)
        sigma = np.full(len(points), GEL_NOISE_MM)
        relief = relief_on_frame(points, sigma, SheetOpening(side, side), (SIDE_CELLS, SIDE_CELLS))
        estimate = compensate_gel(relief, GelLayer(bonded.deflect, (margin, margin), 1e3))
        (ball,) = parts_of(estimate)
        radii.append(ball.radius_mm / case["radius_mm"] - 1)
        forces.append(estimate.force_n / case["force_over_modulus_mm2"] - 1)
        print(f"gel, seed {seed}: radius {radii[-1]:+.3%}, force {forces[-1]:+.2%}", flush=True)
    return {
        "contact_face_radius_rel": float(np.abs(radii).max()),
        "contact_face_force_rel": float(np.abs(forces).max()),
    }


def coverage(trials: int) -> Figures:
    """Draw noise and thickness, compensate, and count the intervals that contain the truth."""
    profile = pressed_ball(THICKNESS_MM, 2.0)
    sigma = THICKNESS_SHARE * THICKNESS_MM
    known = layer_of(THICKNESS_MM, 2.0, sigma_thickness_mm=sigma)
    inside, errors = 0, []
    for seed in range(trials):
        assumed = THICKNESS_MM + sigma * np.random.default_rng([7, seed]).normal()
        points = coat_points(profile, TRIAL_NOISE_MM, seed, pitch_mm=0.1)
        (ball, *_) = parts_of(compensate_sheet(*points, replace(known, thickness_mm=assumed)))
        error = ball.radius_mm - RADIUS_MM
        inside += abs(error) <= K_95 * ball.sigma_mm
        errors.append(error / ball.sigma_mm)
    print(f"coverage: {inside} of {trials}, normalised error {np.std(errors):.3f}, "
          f"mean {np.mean(errors):+.3f}")  # fmt: skip
    return {"coverage_95": inside / trials}


def thick_slab(seeds: int) -> Figures:
    """Fit a ball under a slab in noise, and calibrate its thickness on it."""
    ratios = []
    for air_kpa in (0.0, SLAB_AIR_KPA):
        coat = pressed(BALL, slab(), SLAB_TRAVEL_MM, air_kpa).coat_mm
        layer = slab_layer(slab(), air_kpa)
        model = replace(slab_object(layer, Ball(diameter_mm=7.5)), theory=False)
        over = []
        for seed in range(seeds):
            drawn = slab_points(coat, TRIAL_NOISE_MM, 100 * round(air_kpa) + seed)
            fitted = fit_slab(*drawn, model).fitted
            error = fitted.value(DIAMETER) - BALL.diameter_mm
            over.append(error / fitted.bound_sigma(DIAMETER))
        ratios.append(float(np.sqrt(np.mean(np.square(over)))))
        bound_um = 1e3 * fitted.bound_sigma(DIAMETER)
        print(f"slab, {air_kpa:g} kPa: bound {bound_um:.1f} um, over it {ratios[-1]:.3f} RMS, "
              f"mean {np.mean(over):+.2f}", flush=True)  # fmt: skip
    known, other = slab(), slab(3.0 * 1.01)
    layer = with_load(slab_layer(known), {"depth_mm": 0.0}, depth_mm=SLAB_TRAVEL_MM)
    first, second = (
        slab_points(pressed(ball, other, SLAB_TRAVEL_MM).coat_mm, TRIAL_NOISE_MM, seed)
        for seed, ball in enumerate((BALL, OTHER_BALL))
    )
    calibrated, _ = calibrate_slab(*first, slab_object(layer, BALL), BALL.diameter_mm)
    errors = []
    for known_layer in (layer, calibrated):
        model = replace(slab_object(known_layer, Ball(diameter_mm=6.3)), theory=False)
        diameter = fit_slab(*second, model).fitted.value(DIAMETER)
        errors.append((diameter - OTHER_BALL.diameter_mm) / 2)
    before_um, after_um = 1e3 * np.array(errors)
    print(f"thickness 1 % too small: radius {before_um:+.1f} um off, calibrated {after_um:+.1f} um")
    return {
        "over_cramer_rao": max(ratios),
        "slab_radius_error_before_mm": abs(errors[0]),
        "slab_radius_error_after_mm": abs(errors[1]),
    }


def large_strain() -> Figures:
    """Fit balls to coats from large-strain solids, with the travel known to 2 um."""
    radii = np.round(np.arange(0, STRAIN_RIM_MM + 0.01, 0.05), 6)
    over = []
    for radius, thickness, depth in STRAIN_CASES:
        linear, strained = (
            press_axisymmetric(
                RoundSlab(thickness, STRAIN_RIM_MM, 0.49, "simple"), radius, depth,
                linear=small, resolution=Resolution(36, 12),
            ).far_face_mm(radii)
            for small in (True, False)
        )  # fmt: skip
        span = {"length_x_mm": 2 * STRAIN_RIM_MM, "length_y_mm": 2 * STRAIN_RIM_MM}
        elastomer = slab(thickness).model_copy(update=span)
        coat = pressed(Ball(diameter_mm=2 * radius), elastomer, depth).coat_mm
        places = (np.arange(len(coat)) + 0.5) * 2 * STRAIN_RIM_MM / len(coat) - STRAIN_RIM_MM
        x, y = np.meshgrid(places, places)
        z = coat + np.interp(np.hypot(x, y), radii, strained - linear, right=0.0)
        z += np.random.default_rng(0).normal(scale=STRAIN_NOISE_MM, size=z.shape)
        points = np.stack((x, y, z), axis=-1).reshape(-1, 3)
        layer = with_load(slab_layer(elastomer), {"depth_mm": 0.002}, depth_mm=depth)
        model = slab_object(layer, Ball(diameter_mm=1.9 * radius))
        fitted = fit_slab(points, np.full(z.size, STRAIN_NOISE_MM), model).fitted
        error, u = fitted.value(DIAMETER) - 2 * radius, fitted.sigma(DIAMETER)
        print(f"solid, radius {radius:g}, slab {thickness:g}, depth {depth:g} mm: diameter "
              f"{error:+.3f} mm off, u {u:.3f}", flush=True)  # fmt: skip
        over.append(error / u)
    return {"large_strain_over_u": float(np.sqrt(np.mean(np.square(over))))}


PARTS: dict[str, Callable[[bool], Figures]] = {
    "gel": lambda quick: gel_ball(),
    "coverage": lambda quick: coverage(QUICK_TRIALS if quick else TRIALS),
    "slab": lambda quick: thick_slab(QUICK_SEEDS if quick else SLAB_SEEDS),
    "strain": lambda quick: large_strain(),
    "rendered": rendered_balls,
    "bars": rendered_bars,
}


def main() -> None:
    parser = quick_parser(__doc__, "484 x 366 pixels, 40 trials")
    parser.add_argument("--only", choices=PARTS, help="one part only")
    chosen = parser.parse_args()
    result: Figures = {"rod_width_error_mm": None, "over_cramer_rao": None}
    for name in (chosen.only,) if chosen.only else PARTS:
        result |= PARTS[name](chosen.quick)
    print_figures(result)


if __name__ == "__main__":
    main()
