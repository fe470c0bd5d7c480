"""Calibrate the paper's rig on rendered board poses.

Twelve poses of the dot board with the default camera noise; then, with this calibration, a blank
reference plane and dot boards in other poses, with known lengths of 10 mm. The last line of the
output is one JSON object; every error is against the true rig.
"""

import time

import numpy as np
from scipy.ndimage import uniform_filter

from benchmarks._harness import print_figures, quick_parser
from reconstruction.calibration import length_errors_mm, locate_features, observe
from reconstruction.capture.folder import Capture
from reconstruction.evaluate.fit import fit_plane
from reconstruction.pipeline import reconstruct
from reconstruction.rig.calibration import Calibration
from twin.config import Experiment, load_experiment
from twin.config.board import BoardFile, BoardPose, load_board
from twin.pipeline.board_calibration import BoardCalibration
from twin.pipeline.calibration import calibrate_rendered, record_board
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
    # Complete windows only: at a ragged rim the mean would be taken over less than 1 mm.
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
    calibrated = {p.name: p for p in done.result.parameters}
    groups = {"focal": ("camera_fx_px", "projector_fx_px"), "baseline": ("baseline_mm",)}
    figures = {}
    for group, names in groups.items():
        rows = [(calibrated[name], calibrated[name].value - truth[name]) for name in names]
        figures[f"{group}_rel"] = max(abs(e) / truth[p.name] for p, e in rows)
        figures[f"{group}_over_expanded"] = max(abs(e) / p.expanded for p, e in rows)
        figures[f"{group}_expanded_rel"] = max(p.expanded / p.value for p, _ in rows)
    return figures


def main() -> None:
    parser = quick_parser(__doc__, "968 x 732 px instead of 1936 x 1464")
    binning = 2 if parser.parse_args().quick else 1
    experiment = load_experiment("examples/slab_balls", {"camera.binning": binning})
    board, start = load_board("boards/paper_dots"), time.perf_counter()
    done = calibrate_rendered(
        experiment, board, watch=lambda stage, part: print(f"{stage} {part:.0%}", flush=True)
    )
    case = experiment, board, done.result.calibration
    print("reference planes and lengths", flush=True)
    planes = [plane_pv_um(*case, k) for k in range(len(PLANES))]
    lengths = np.concatenate([length_errors_um(*case, k) for k in range(len(LENGTHS))])
    camera_px, projector_px = done.result.adjustment.spread_px[:2]
    print_figures(
        parameter_errors(done)
        | {
            "plane_pv_um": max(planes),
            "length_error_um": float(np.abs(lengths).max()),
            "length_bias_um": float(lengths.mean()),
            "lengths": len(lengths),
            "camera_rms_px": float(camera_px),
            "projector_rms_px": float(projector_px),
            "poses": len(done.observations),
            "camera_width_px": done.observations[0].camera_size_px[0],
            "seconds": time.perf_counter() - start,
        }
    )


if __name__ == "__main__":
    main()
