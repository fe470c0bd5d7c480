"""Figures that follow from a case's description and its result: the designer's own.

| name | meaning |
|---|---|
| half_contrast_pitch_mm | pitch of grooves of which the coat keeps half; 0 where nothing is lost |
| tenth_contrast_pitch_mm | pitch of which it keeps a tenth |
| radius_bias_mm | radius of the ball's true coated face less that of the ball: what the slab does |
| depth_over_thickness | travel of the press over the slab's thickness |
| force_per_depth_n_per_mm | force over travel |

They are not in result.json; tables, constraints and objectives know them beside its metrics.
"""

from collections.abc import Callable, Mapping
from typing import Any

from twin.config import Experiment
from twin.mechanics.contact_transfer import pitch_at
from twin.specimens import shape_of

Figures = Mapping[str, Any]


def _kept_pitch(share: float) -> Callable[[Experiment, Figures], float]:
    def pitch_mm(experiment: Experiment, _: Figures) -> float:
        if experiment.elastomer.layout == "contact_face":
            return 0.0
        return pitch_at(share, experiment.elastomer.thickness_mm)

    return pitch_mm


def _radius_bias_mm(experiment: Experiment, figures: Figures) -> float:
    nominal = next(iter(shape_of(experiment.specimen).spheres())).radius_mm
    return float(figures["sphere_1_true_face_radius_mm"]) - nominal


def _depth_over_thickness(experiment: Experiment, figures: Figures) -> float:
    return float(figures["depth_mm"]) / experiment.elastomer.thickness_mm


def _force_per_depth(_: Experiment, figures: Figures) -> float:
    return float(figures["force_n"]) / float(figures["depth_mm"])


DERIVED: dict[str, Callable[[Experiment, Figures], float]] = {
    "half_contrast_pitch_mm": _kept_pitch(0.5),
    "tenth_contrast_pitch_mm": _kept_pitch(0.1),
    "radius_bias_mm": _radius_bias_mm,
    "depth_over_thickness": _depth_over_thickness,
    "force_per_depth_n_per_mm": _force_per_depth,
}


def with_derived(experiment: Experiment, figures: Figures) -> dict[str, Any]:
    """Return a case's figures and all derived ones that its result allows."""
    found = dict(figures)
    for name, derive in DERIVED.items():
        try:
            found[name] = derive(experiment, figures)
        except (KeyError, StopIteration):
            continue  # no such ball, or nothing was pressed
    return found
