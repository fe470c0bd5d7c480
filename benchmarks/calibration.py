"""Calibrate the paper's rig on rendered board poses: `python benchmarks/calibration.py [--quick]`.

Twelve poses of the dot board with the default camera noise; then, with the calibration found, a
blank reference plane and dot boards in other poses, whose 10 mm lengths are known. The last line of
the output is one JSON object; every error is against the true rig.
"""

import argparse
import json
import time

import numpy as np
from scipy.ndimage import uniform_filter

from reconstruction.calibration import length_errors_mm, locate_features, observe
from reconstruction.capture.folder import Capture
from reconstruction.evaluate.fit import fit_plane
from reconstruction.pipeline import reconstruct
from reconstruction.rig.calibration import Calibration
from twin.config import Experiment, load_experiment
from twin.config.board import BoardFile, BoardPose, load_board
from twin.pipeline.calibration import BoardCalibration, calibrate_rendered, record_board
from twin.pipeline.captures import options_of

SMOOTH_MM, LENGTH_MM = 1.0, 10.0
PLANES = (BoardPose(), BoardPose(tilt_deg=10.0, azimuth_deg=150.0, z_mm=1.5))
LENGTHS = (
    BoardPose(spin_deg=10.0, x_mm=0.5, z_mm=1.5),
    BoardPose(tilt_deg=8.0, azimuth_deg=-60.0, spin_deg=40.0, z_mm=-1.5),
    BoardPose(tilt_deg=15.0, azimuth_deg=10.0, spin_deg=-20.0, y_mm=-0.5),
)


def blank(board: BoardFile) -> BoardFile:
    """Return the same plate without print."""
    plate = board.plate.model_copy(update={"ink_albedo": board.plate.white_albedo})
    return board.model_copy(update={"plate": plate})


def plane_pv_um(
    experiment: Experiment, board: BoardFile, calibration: Calibration, number: int
) -> float:
    """Return the peak-to-valley form of a reference plane, smoothed over 1 mm; a plane removed."""
    seen = record_board(experiment, blank(board), PLANES[number], 100 + number)
    capture = Capture(
        seen.stack, seen.patterns, seen.sensor, calibration, experiment.camera.bit_depth
    )
    points = reconstruct(capture, options_of(experiment.decode)).point_map
    fit = fit_plane(points.points_world_mm[points.valid].astype(np.float64))
    distance_mm = np.zeros(points.valid.shape)
    distance_mm[points.valid] = fit.residuals_mm
    # Whole windows only: at a ragged rim the mean would be taken over less than 1 mm.
    side = round(SMOOTH_MM / pixel_mm(points.points_world_mm))
    whole = uniform_filter(points.valid.astype(float), side, mode="constant") > 1.0 - 1e-9
    form_mm = uniform_filter(distance_mm, side, mode="constant")[whole]
    return 1e3 * float(np.ptp(form_mm))


def pixel_mm(points_world_mm: np.ndarray) -> float:
    """Return the size of a camera pixel on the surface, in the middle of the image."""
    row, col = (size // 2 for size in points_world_mm.shape[:2])
    step = points_world_mm[row, col + 20] - points_world_mm[row, col - 20]
    return float(np.linalg.norm(step)) / 40.0


def length_errors_um(
    experiment: Experiment, board: BoardFile, calibration: Calibration, number: int
) -> np.ndarray:
    """Return the errors of all 10 mm lengths between dots of a board in a new pose."""
    capture = record_board(experiment, board, LENGTHS[number], 200 + number)
    seen = observe(capture, board.board(), f"length_{number}")
    return 1e3 * length_errors_mm(locate_features(calibration, seen), seen, LENGTH_MM)


def parameter_errors(done: BoardCalibration) -> dict[str, float]:
    """Return relative errors of focal lengths and baseline, and errors over stated uncertainty."""
    truth = done.truth or {}
    found = {p.name: p for p in done.result.parameters}
    focal = [found[name] for name in ("camera_fx_px", "projector_fx_px")]
    length = found["baseline_mm"]
    over = {p.name: abs(p.value - truth[p.name]) / p.expanded for p in (*focal, length)}
    return {
        "focal_rel": max(abs(p.value / truth[p.name] - 1.0) for p in focal),
        "baseline_rel": abs(length.value / truth["baseline_mm"] - 1.0),
        "focal_over_expanded": max(over["camera_fx_px"], over["projector_fx_px"]),
        "baseline_over_expanded": over["baseline_mm"],
        "focal_expanded_rel": max(p.expanded / p.value for p in focal),
        "baseline_expanded_rel": length.expanded / length.value,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="968 x 732 px instead of 1936 x 1464")
    binning = 2 if parser.parse_args().quick else 1
    experiment = load_experiment("examples/slab_balls", {"camera.binning": binning})
    board = load_board("boards/paper_dots")
    start = time.perf_counter()
    done = calibrate_rendered(
        experiment, board, watch=lambda stage, part: print(f"{stage} {part:.0%}", flush=True)
    )
    calibration = done.result.calibration
    print("reference planes", flush=True)
    planes = [plane_pv_um(experiment, board, calibration, k) for k in range(len(PLANES))]
    print("reference lengths", flush=True)
    lengths = np.concatenate(
        [length_errors_um(experiment, board, calibration, k) for k in range(len(LENGTHS))]
    )
    result = parameter_errors(done) | {
        "plane_pv_um": max(planes),
        "length_error_um": float(np.abs(lengths).max()),
        "length_bias_um": float(lengths.mean()),
        "lengths": len(lengths),
        "camera_rms_px": done.result.adjustment.spread_px[0],
        "projector_rms_px": done.result.adjustment.spread_px[1],
        "poses": len(done.observations),
        "camera_width_px": done.observations[0].camera_size_px[0],
        "seconds": time.perf_counter() - start,
    }
    print(json.dumps({k: float(f"{v:.4g}") for k, v in result.items()}))


if __name__ == "__main__":
    main()
