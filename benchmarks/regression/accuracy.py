"""The accuracy cases of `figures.toml`: one function each, called by the name of its case.

Seeds change the camera (its noise and its fixed pattern) and, on bare specimens, the random paths
of light. Press, trace and pixel values before the camera are equal for all seeds and computed once,
by the stages that sweeps share.
"""

import statistics
from functools import partial
from typing import Any

import numpy as np

from benchmarks import calibration as board_bench
from benchmarks import mechanics
from benchmarks.decode import ideal_rms_px
from benchmarks.direct import energy_gap
from benchmarks.gelsight import BALL_MM, DEPTH_MM, FIRST_IMAGE, cap_ratios, photographed
from benchmarks.regression.figures import Values, repeated
from reconstruction.pipeline import reconstruct
from twin.config import Experiment, load_experiment, vary
from twin.config.board import load_board
from twin.pipeline import Memory, measure, press_specimen, record
from twin.pipeline.calibration import calibrate_rendered
from twin.pipeline.captures import options_of
from twin.pipeline.reference_presses import with_ball
from twin.results.score import Scores
from twin.specimens.kinds.ball import Ball

IDEAL = {"camera.noise": False, "decode.filter_taps": 0}
CENTRE = {"camera.binning": 2, "camera.width_px": 640, "camera.height_px": 480}
"""Middle of the field at the demo's resolution."""
FEW_PRESSES = {"photometric.presses.count": 16}
PLACES_MM = ((0.0, 0.0), (5.0, 2.5), (-4.0, -3.0), (4.0, -3.0), (-5.0, 2.5))


# ---- fringe projection ---------------------------------------------------------------------------


def two_balls(seeds: int = 5, binning: int = 2) -> Values:
    """Measure the paper's scene as `twin demo` does, then decode the same captures unfiltered."""
    memory = Memory()

    def once(seed: int) -> dict[str, float]:
        settings = {"camera.binning": binning, "seed": seed}
        experiment = load_experiment("examples/slab_balls", settings)
        done = measure(experiment, memory=memory)
        unfiltered = measure(vary(experiment, {"decode.filter_taps": 0}), memory=memory)
        truth = done.score.against_truth
        spread = unfiltered.score.against_truth.error_over_sigma
        return spheres(done.score) | {
            "two_balls_force_n": done.pressed.force_n,
            "two_balls_z_rmse_um": truth.z_rmse_um,
            "two_balls_sigma_z_um": truth.sigma_z_median_um,
            "two_balls_completeness": truth.completeness,
            "two_balls_wrong_orders_px": float(truth.wrong_order_pixels),
            "two_balls_spread_over_sigma": truth.error_over_sigma,
            "two_balls_unfiltered_spread_over_sigma": spread,
        }

    return repeated(seeds, once)


def spheres(scored: Scores) -> dict[str, float]:
    """Return radius and residuals, mean over both balls."""
    fits = [ball.measured for ball in scored.spheres]
    return {
        "two_balls_radius_mm": float(np.mean([fit.radius_mm for fit in fits])),
        "two_balls_sphere_rmse_um": 1e3 * float(np.mean([fit.stats.rmse_mm for fit in fits])),
    }


def ideal() -> Values:
    """Measure without noise and filter: errors of sampling, decoding and triangulation."""
    truth = measure(load_experiment("examples/slab_balls", IDEAL | {"camera.binning": 4})).score
    return {"ideal_z_rmse_um": [truth.against_truth.z_rmse_um]}


def sampling() -> Values:
    """Compare projector columns of 2 x 2 rays per pixel with those of 16 x 16, noise-free."""
    experiment = load_experiment("examples/slab_balls", IDEAL | CENTRE)
    pressed = press_specimen(experiment)

    def decoded(sampled: Experiment) -> Any:
        capture = record(sampled, pressed).capture
        return reconstruct(capture, options_of(sampled.decode)).decoded

    coarse, fine = decoded(experiment), decoded(vary(experiment, {"render.samples": 256}))
    both = coarse.valid & fine.valid
    error_px = (coarse.column.coordinate_px - fine.column.coordinate_px)[both]
    return {"sampling_error_px": [float(np.sqrt(np.mean(error_px.astype(np.float64) ** 2)))]}


def albedo(seeds: int = 5) -> Values:
    """Compare the error on a dark coat with that on a coat of albedo 0.4."""
    dark_memory, bright_memory = Memory(), Memory()

    def once(seed: int) -> dict[str, float]:
        settings = {"camera.binning": 4, "decode.filter_taps": 0, "seed": seed}
        base = load_experiment("examples/slab_balls", settings)
        dark = measure(vary(base, {"coating.base_albedo": 0.1}), memory=dark_memory)
        bright = measure(vary(base, {"coating.base_albedo": 0.4}), memory=bright_memory)
        ratio = dark.score.against_truth.z_rmse_um / bright.score.against_truth.z_rmse_um
        return {"albedo_z_rmse_ratio": ratio}

    return repeated(seeds, once)


def rod(seeds: int = 5) -> Values:
    """Measure the width of the paper's rod C from the relief as the paper's table does."""
    memory = Memory()

    def once(seed: int) -> dict[str, float]:
        experiment = load_experiment("examples/slab_rod", {"camera.binning": 4, "seed": seed})
        figures = measure(experiment, memory=memory).figures
        return {f"rod_{name}_mm": figures[f"rod_{name}_mm"] for name in ("width", "height")}

    return repeated(seeds, once)


def window(seeds: int = 5) -> Values:
    """Measure through a gel and a window, decoded with refraction and as if in air."""
    memory = Memory()

    def once(seed: int) -> dict[str, float]:
        settings = {"camera.binning": 4, "seed": seed}
        known = load_experiment("examples/gel_on_window", settings)
        air = load_experiment("examples/gel_on_window", settings | {"decode.through_layers": False})
        done, in_air = measure(known, memory=memory), measure(air, memory=memory)
        return {
            "window_radius_mm": done.score.spheres[0].measured.radius_mm,
            "window_z_rmse_um": done.score.against_truth.z_rmse_um,
            "window_in_air_radius_mm": in_air.score.spheres[0].measured.radius_mm,
            "window_in_air_z_bias_um": in_air.score.against_truth.z_bias_um,
        }

    return repeated(seeds, once)


def direct(name: str, seeds: int) -> Values:
    """Project fringes onto a bare specimen."""

    def once(seed: int) -> dict[str, float]:
        settings = {"camera.binning": 4, "modality": "direct_fpp", "seed": seed}
        truth = measure(load_experiment(f"paper/{name}", settings)).score.against_truth
        return {f"direct_{name}_completeness": truth.completeness}

    return repeated(seeds, once)


direct_nut = partial(direct, "nut", 4)
direct_brick = partial(direct, "brick", 3)


def photons(seeds: int = 3) -> Values:
    """Trace light into the clear brick and compare the energy that arrives with that sent."""
    settings = {"camera.binning": 4, "modality": "direct_fpp"}
    experiment = load_experiment("paper/brick", settings)
    return repeated(seeds, lambda seed: {"photons_energy_gap_rel": energy_gap(experiment, seed)})


def calibration(seeds: int = 8) -> Values:
    """Calibrate on rendered poses of the dot board, then measure a plane and 10 mm lengths."""
    board = load_board("boards/paper_dots")

    def once(seed: int) -> dict[str, float]:
        experiment = load_experiment("examples/slab_balls", {"camera.binning": 4, "seed": seed})
        rig = calibrate_rendered(experiment, board).result.calibration
        lengths_um = board_bench.length_errors_um(experiment, board, rig, 0)
        return {
            "calibration_plane_pv_um": board_bench.plane_pv_um(experiment, board, rig, 0),
            "calibration_length_rms_um": float(np.sqrt(np.mean(lengths_um**2))),
        }

    return repeated(seeds, once)


def decode(seeds: int = 5) -> Values:
    """Decode exact and 8-bit frames at random coordinates."""

    def once(seed: int) -> dict[str, float]:
        return {f"decode_{name}": value for name, value in ideal_rms_px(seed).items()}

    return repeated(seeds, once)


# ---- mechanics -----------------------------------------------------------------------------------


def press() -> Values:
    """Press a paraboloid on a half-space, balls on bonded layers, and a ball at large strain."""
    values = {
        "press_hertz_force_rel": mechanics.hertz_force_rel(),
        "press_fredholm_force_rel": mechanics.fredholm_max_rel(),
        "press_large_strain_face_um": mechanics.nh_face_rms_um(quick=True),
    }
    return {name: [value] for name, value in values.items() if value is not None}


def fem() -> Values:
    """Press a ball into a free slab of tetrahedra, whose mesh differs from run to run."""
    return {"fem_face_um": [mechanics.free_fem_face_um()]}


# ---- photometric stereo --------------------------------------------------------------------------


def gelsight(seeds: int = 4) -> Values:
    """Measure caps of a ball with a GelSight-like sensor, calibrated on few balls for each seed.

    The places are equal for all seeds: places differ by more (6 %) than the mean over the places
    does from seed to seed.
    """
    return repeated(seeds, caps)


def caps(seed: int) -> dict[str, float]:
    """Return measured over true cap heights, mean over the places, by integration scheme."""
    experiment = load_experiment("examples/gelsight_ball", FEW_PRESSES | {"seed": seed})
    shots = []
    for number, (x_mm, y_mm) in enumerate(PLACES_MM):
        ball = Ball(diameter_mm=BALL_MM, x_mm=x_mm, y_mm=y_mm)
        case = with_ball(experiment, ball, DEPTH_MM)
        shots.append(photographed(experiment, case, FIRST_IMAGE + number))
    ratios = cap_ratios(experiment, shots)
    return {f"gelsight_cap_{name}": statistics.fmean(values) for name, values in ratios.items()}
