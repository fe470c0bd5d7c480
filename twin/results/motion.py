"""Figures and warning of a specimen that moved during its sequence."""

import numpy as np

from reconstruction.arrays import at_pixels
from reconstruction.evaluate.fit import median, rms
from reconstruction.pipeline import Reconstruction
from twin.config.models import Experiment
from twin.optics.frame_times import sequence_ends_s
from twin.optics.stack import MotionAccuracy, RadianceStack, Truth
from twin.results.figures import Metric
from twin.results.score import figure_of, wanted_pixels

MOTION_FIGURES = {
    "motion_moments": "moments",
    "motion_exposure_nodes": "exposure_nodes",
    "motion_crossed_share": "crossed_share",
    "motion_radiance_rms_percent": "radiance_rms_percent",
    "motion_coordinate_rms_px": "coordinate_rms_px",
    "moved_px": "moved_px",
}
"""Field of `MotionAccuracy` of every figure of a moving scene."""
_ORIGINS = {"sequence": "the sequence", "phase": "the phase frames"}

_CLEAR_SIGMAS = 2.0


def motion_figures(radiance: RadianceStack) -> dict[str, Metric]:
    """Return how the frames of a moving scene were computed, and their error; else nothing."""
    if radiance.motion is None:
        return {}
    return {name: getattr(radiance.motion, field) for name, field in MOTION_FIGURES.items()}


def predicted_motion_figures(
    experiment: Experiment, reconstruction: Reconstruction, truth: Truth
) -> dict[str, Metric]:
    """Return the predicted errors of z by motion, um, over the target points; nothing without.

    `motion_predicted_over_actual` is the median of predicted over actual error, over the points
    whose error against the truth of time 0 exceeds `_CLEAR_SIGMAS` of its noise. It is None if
    these are less than half of the points: noise exceeds the motion.
    """
    motion, points = reconstruction.motion, reconstruction.point_map
    target = points.valid & wanted_pixels(experiment, truth)
    if motion is None:
        return {}
    error_um, lag_um, sigma_um = (
        1e3 * at_pixels(image, target).astype(np.float64)
        for image in (motion.error_z_mm, motion.lag_z_mm, points.sigma_z_mm)
    )
    measured_mm, true_mm = (
        at_pixels(images, target)[:, 2]
        for images in (points.points_world_mm, truth.points_world_mm)
    )
    actual_um = 1e3 * np.abs(measured_mm.astype(np.float64) - true_mm)
    clear = actual_um > _CLEAR_SIGMAS * sigma_um
    if clear.mean() < 0.5:
        clear[:] = False
    ratios = np.abs(error_um + lag_um)[clear] / actual_um[clear]
    return {
        "motion_error_rms_um": figure_of(error_um, rms),
        "motion_lag_rms_um": figure_of(lag_um, rms),
        "motion_predicted_over_actual": figure_of(ratios, median),
    }


def motion_warnings(experiment: Experiment, accuracy: MotionAccuracy | None) -> list[str]:
    """Return a warning that states the motion during the sequence; empty for a scene at rest."""
    if accuracy is None:
        return _displaced(experiment)
    start_s, end_s = sequence_ends_s(experiment)
    motion = experiment.motion
    places_mm = np.array([motion.shift_mm(at) for at in np.linspace(start_s, end_s, 2001)])
    moved_um = 1e3 * float(np.linalg.norm(np.ptp(places_mm, axis=0)))
    turned_deg = (end_s - start_s) * float(np.hypot(motion.twist_deg_s, motion.roll_deg_s))
    turn = f" and turns by {turned_deg:.3g} degrees" if turned_deg else ""
    return [
        f"the specimen moves by {moved_um:.3g} um{turn} during the sequence of "
        f"{1e3 * (end_s - start_s):.4g} ms, and the projector coordinate of a pixel by "
        f"{accuracy.moved_px:.3g} px (median); the {_decoder(experiment)}, and the truth is that "
        f"of the middle of {_ORIGINS[experiment.timing.origin]}"
    ]


def _decoder(experiment: Experiment) -> str:
    if experiment.motion.encoder:
        return "frames are corrected by the positions of the stage"
    return "decoder assumes a specimen at rest"


def _displaced(experiment: Experiment) -> list[str]:
    motion = experiment.motion
    if not motion.is_stated or motion.time_s is None:
        return []
    return [
        f"the specimen is at its place {motion.time_s:.4g} s after the middle of the sequence: "
        "figures that use its nominal place (balls, object, widths) are displaced; the errors of "
        "points are not"
    ]
