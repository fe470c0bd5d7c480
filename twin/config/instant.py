"""The experiment at one instant of its motion: the one definition of a moving scene.

Everything that moves during a sequence follows from this function: the traced moments, the frames
of the oracle, and the truth, which is that of time 0.
"""

import numpy as np

from reconstruction.errors import InputError
from twin.config.models import Experiment
from twin.config.motion import Motion


def experiment_at(experiment: Experiment, time_s: float) -> Experiment:
    """Return the experiment with its scene at rest as it is at one time of the sequence.

    A bare specimen and its stage are displaced (`motion.time_s`). A press has the travel, place
    and direction of that time, and no motion. In a relaxing elastomer its `ramp_s` is the time
    since the first contact, travel over press rate.

    Parameters
    ----------
    time_s : time after the middle of the sequence

    Raises
    ------
    InputError : the travel of the press is not positive at this time; or a relaxing elastomer
        with another motion than a press of constant rate
    """
    motion = experiment.motion
    if not motion.moves:
        return experiment
    if not experiment.method.presses:
        at_rest = motion.model_copy(update={"time_s": float(time_s)})
        return experiment.model_copy(update={"motion": at_rest})
    specimen, press, pose = experiment.specimen, experiment.press, motion.pose_at(time_s)
    x_mm, y_mm, z_mm, _ = pose @ np.array([specimen.x_mm, specimen.y_mm, 0.0, 1.0])
    turned_deg = specimen.yaw_deg + motion.twist_deg_s * time_s
    placed = {"x_mm": float(x_mm), "y_mm": float(y_mm), "yaw_deg": float(turned_deg)}
    pressed = {} if z_mm == 0.0 else {"depth_mm": _travel_mm(press.depth_mm, float(z_mm), time_s)}
    if experiment.elastomer.relaxation is not None:
        travel_mm = pressed.get("depth_mm", press.depth_mm)
        pressed["ramp_s"] = _ramp_s(experiment, travel_mm)
    changes = {
        "specimen": specimen.model_copy(update=placed),
        "press": press.model_copy(update=pressed),
        "motion": Motion(),
    }
    return experiment.model_copy(update=changes)


def elastic_at(experiment: Experiment, time_s: float) -> Experiment:
    """Return `experiment_at` without relaxation, for the shape of a press at one time.

    At a given travel only the force of an elastomer relaxes, not the shape of its faces.
    """
    elastomer = experiment.elastomer.model_copy(update={"relaxation": None})
    return experiment_at(experiment.model_copy(update={"elastomer": elastomer}), time_s)


def _travel_mm(depth_mm: float | None, risen_mm: float, time_s: float) -> float:
    if depth_mm is None:
        raise InputError(
            "motion.z_mm_s: found a press of prescribed force, allowed press.control = 'depth'; "
            "state press.depth_mm, its travel in the middle of the sequence"
        )
    if depth_mm + risen_mm <= 0.0:
        raise InputError(
            f"motion.z_mm_s: the travel is {depth_mm + risen_mm:.4g} mm at {time_s:.4g} s, allowed "
            "above 0 during the sequence; press deeper (press.depth_mm) or more slowly"
        )
    return depth_mm + risen_mm


def _ramp_s(experiment: Experiment, travel_mm: float | None) -> float:
    """Return the duration of a press of constant rate into a relaxing elastomer, s.

    Raises
    ------
    InputError : the press slides, turns, vibrates or retracts, so that parts of the contact end,
        for which the elastic solutions do not apply; or it has a hold or a duration of its own
    """
    motion, press = experiment.motion, experiment.press
    uniform = Motion(z_mm_s=motion.z_mm_s)
    if motion != uniform or motion.z_mm_s <= 0.0 or travel_mm is None:
        raise InputError(
            "motion: found a slide, turn, vibration or retraction under an elastomer that relaxes, "
            "allowed a press of constant rate (z_mm_s above 0); remove the other motions, or "
            "elastomer.relaxation"
        )
    if press.hold_s or press.ramp_s:
        key = "hold_s" if press.hold_s else "ramp_s"
        raise InputError(
            f"press.{key}: found {getattr(press, key):g} s with motion.z_mm_s and an elastomer that"
            " relaxes, allowed 0: the press lasts its travel over its rate; remove it"
        )
    return travel_mm / motion.z_mm_s
