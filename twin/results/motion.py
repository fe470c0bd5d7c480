"""Figures and warning of a specimen that moved during its sequence."""

import numpy as np

from twin.config.models import Experiment
from twin.optics.frame_times import sequence_ends_s
from twin.optics.stack import MotionAccuracy, RadianceStack
from twin.results.figures import Metric

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


def motion_figures(radiance: RadianceStack) -> dict[str, Metric]:
    """Return how the frames of a moving scene were computed, and their error; else nothing."""
    if radiance.motion is None:
        return {}
    return {name: getattr(radiance.motion, field) for name, field in MOTION_FIGURES.items()}


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
        f"{accuracy.moved_px:.3g} px (median); the decoder assumes a specimen at rest, and the "
        f"truth is that of the middle of {_ORIGINS[experiment.timing.origin]}"
    ]


def _displaced(experiment: Experiment) -> list[str]:
    motion = experiment.motion
    if not motion.is_stated or motion.time_s is None:
        return []
    return [
        f"the specimen is at its place {motion.time_s:.4g} s after the middle of the sequence: "
        "figures that use its nominal place (balls, object, widths) are displaced; the errors of "
        "points are not"
    ]
