"""Accuracy of fringe projection: coat, bare specimens, window, sampling, calibration.

Seeds change the camera (both its noise and its fixed pattern) and, on bare specimens, the random
paths of light. Press, trace and pixel values before the camera are the same for all seeds and are
computed once, by the stages that sweeps share.
"""

from typing import Any

import numpy as np

from benchmarks import calibration as bench
from benchmarks.regression.cases import repeated
from benchmarks.regression.figures import Values
from reconstruction.pipeline import reconstruct
from twin.config import Experiment, load_experiment, vary
from twin.config.board import load_board
from twin.pipeline import Memory, measure, press_specimen, record
from twin.pipeline.calibration import calibrate_rendered
from twin.pipeline.captures import options_of
from twin.results.score import Scores

IDEAL = {"camera.noise": False, "decode.filter_taps": 0}
CENTRE = {"camera.binning": 2, "camera.width_px": 640, "camera.height_px": 480}
"""Middle of the field at the demo's resolution."""


def two_balls(seeds: int = 5, binning: int = 2) -> Values:
    """Measure the paper's scene as `twin demo` does, then decode the same captures unfiltered."""
    memory = Memory()

    def once(seed: int) -> dict[str, float]:
        experiment = load_experiment(
            "examples/slab_balls", {"camera.binning": binning, "seed": seed}
        )
        done = measure(experiment, memory=memory)
        plain = measure(
            vary(experiment, {"decode.filter_taps": 0}), memory=memory
        ).score.against_truth
        truth = done.score.against_truth
        return spheres(done.score) | {
            "two_balls_force_n": done.pressed.force_n,
            "two_balls_z_rmse_um": truth.z_rmse_um,
            "two_balls_sigma_z_um": truth.sigma_z_median_um,
            "two_balls_completeness": truth.completeness,
            "two_balls_wrong_orders_px": float(truth.wrong_order_pixels),
            "two_balls_spread_over_sigma": truth.error_over_sigma,
            "two_balls_unfiltered_spread_over_sigma": plain.error_over_sigma,
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
    """Measure without noise and filter: what sampling, decoding and triangulation lose."""
    truth = measure(load_experiment("examples/slab_balls", IDEAL | {"camera.binning": 4})).score
    return {"ideal_z_rmse_um": [truth.against_truth.z_rmse_um]}


def sampling() -> Values:
    """Compare projector columns of 2 x 2 rays per pixel with those of 16 x 16, noise-free."""
    experiment = load_experiment("examples/slab_balls", IDEAL | CENTRE)
    pressed = press_specimen(experiment)
    coarse, fine = (
        decoded(one, record(one, pressed))
        for one in (experiment, vary(experiment, {"render.samples": 256}))
    )
    both = coarse.valid & fine.valid
    error_px = (coarse.column.coordinate_px - fine.column.coordinate_px)[both]
    return {"sampling_error_px": [float(np.sqrt(np.mean(error_px.astype(np.float64) ** 2)))]}


def decoded(experiment: Experiment, recording: Any) -> Any:
    """Decode a recording with the experiment's options."""
    return reconstruct(recording.capture, options_of(experiment.decode)).decoded


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
    """Read the width of the paper's rod C off the relief as the paper's table does."""
    memory = Memory()

    def once(seed: int) -> dict[str, float]:
        experiment = load_experiment("examples/slab_rod", {"camera.binning": 4, "seed": seed})
        found = measure(experiment, memory=memory).figures
        return {f"rod_{name}_mm": found[f"rod_{name}_mm"] for name in ("width", "height")}

    return repeated(seeds, once)


def window(seeds: int = 5) -> Values:
    """Measure through a gel and a window, which the decoder knows, and takes for air."""
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


def calibration(seeds: int = 8) -> Values:
    """Calibrate on rendered poses of the dot board, then measure a plane and 10 mm lengths."""
    board = load_board("boards/paper_dots")

    def once(seed: int) -> dict[str, float]:
        experiment = load_experiment("examples/slab_balls", {"camera.binning": 4, "seed": seed})
        done = calibrate_rendered(experiment, board)
        rig = done.result.calibration
        lengths_um = bench.length_errors_um(experiment, board, rig, 0)
        return {
            "calibration_plane_pv_um": bench.plane_pv_um(experiment, board, rig, 0),
            "calibration_length_rms_um": float(np.sqrt(np.mean(lengths_um**2))),
        }

    return repeated(seeds, once)
