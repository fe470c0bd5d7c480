"""Presses of reference balls, on which a photometric-stereo sensor is calibrated."""

from typing import Any

import numpy as np

from twin.config import Experiment, seed_sequence
from twin.config.models import Ball, Press


def ball_presses(experiment: Experiment) -> list[Experiment]:
    """Draw the reference presses: balls at random places of the field, from the root seed."""
    plan, size = experiment.photometric.presses, experiment.photometric
    rng = np.random.default_rng(seed_sequence(experiment, "reference_balls"))
    found = []
    for _ in range(plan.count):
        diameter_mm = rng.uniform(plan.smallest_diameter_mm, plan.largest_diameter_mm)
        depth_mm = 0.5 * diameter_mm * rng.uniform(plan.shallowest, plan.deepest)
        # A contact's radius is below sqrt(2 R d), the ball's section by the plane.
        half = np.array([size.field_x_mm, size.field_y_mm]) / 2 - np.sqrt(diameter_mm * depth_mm)
        x_mm, y_mm = rng.uniform(-1.0, 1.0, 2) * np.maximum(half, 0.0)
        ball = Ball(diameter_mm=diameter_mm, x_mm=x_mm, y_mm=y_mm)
        found.append(with_ball(experiment, ball, depth_mm))
    return found


def with_ball(experiment: Experiment, ball: Ball, depth_mm: float) -> Experiment:
    """Return the experiment with a ball pressed to a depth instead of its own specimen."""
    pitches: dict[str, Any] = experiment.press.model_dump(
        include={"solver_pitch_mm", "relief_pitch_mm"}
    )
    load = Press(control="depth", depth_mm=depth_mm, **pitches)
    return experiment.model_copy(update={"specimen": ball, "press": load})
