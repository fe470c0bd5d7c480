"""Derived figures for the design of a sensor, computed from experiment and result of a case.

| name | meaning |
|---|---|
| half_contrast_pitch_mm | pitch of grooves at which the relief of the coat is 50 % of the
grating's; 0 without loss; thin sheet: ridges of the specimen's (or a fingerprint's) height,
under the back pressure |
| tenth_contrast_pitch_mm | pitch at which the relief of the coat is 10 % of the grating's |
| groove_contrast_kept | relief of the coat over relief of the grating (slab: closed form) |
| groove_over_error | RMS of the grooves on the coat over z_rmse: below 1 the error is larger |
| radius_bias_mm | radius of the true coated face minus radius of the ball: effect of the slab |
| depth_over_thickness | travel of the press over the slab's thickness |
| force_per_depth_n_per_mm | force over travel |
| magnification, field_width_mm, baseline_mm, ... | layout of the rig, see `twin.results.layout` |

Derived figures are not stored in `result.json`. Tables, constraints and objectives accept them
like the stored figures.
"""

import math
from collections.abc import Callable, Iterable

import numpy as np

from twin.config import Experiment
from twin.config.nominal import NominalGrating
from twin.mechanics.contact_transfer import Ridges, pitch_at, ridge_height_mm
from twin.mechanics.models import model_of
from twin.mechanics.transfer import opposite_transfer
from twin.results.figures import Metric, Metrics
from twin.results.layout import LAYOUT, layout_figures
from twin.specimens import shape_of


def _kept_pitch(share: float) -> Callable[[Experiment, Metrics], float]:
    def pitch_mm(experiment: Experiment, metrics: Metrics) -> float:
        if experiment.elastomer.layout == "contact_face":
            return 0.0
        if _is_sheet(metrics):
            return _ridges(experiment).pitch_mm(share)
        return pitch_at(share, experiment.elastomer.thickness_mm)

    return pitch_mm


def _is_sheet(metrics: Metrics) -> bool:
    return model_of(str(metrics.get("mechanics_model"))).wraps


def _number(metrics: Metrics, name: str) -> float:
    value = metrics[name]
    if not isinstance(value, (int, float)):
        raise KeyError(name)
    return float(value)


def _ridges(experiment: Experiment) -> Ridges:
    pressure_kpa = experiment.press.back_pressure_kpa
    if not pressure_kpa:
        raise KeyError("back_pressure_kpa")
    return Ridges(experiment.elastomer, pressure_kpa, ridge_height_mm(experiment.specimen))


def _grating(experiment: Experiment) -> NominalGrating:
    """Return the nominal grating of the specimen; raise KeyError if it has no grating."""
    for grating in experiment.specimen.nominal(NominalGrating):
        return grating
    raise KeyError("pitch_mm")


def _groove_contrast(experiment: Experiment, metrics: Metrics) -> float:
    pitch_mm = _grating(experiment).pitch_mm
    if experiment.elastomer.layout == "contact_face":
        return 1.0  # if the elastomer fills the grooves
    if _is_sheet(metrics):
        return _ridges(experiment).shown(pitch_mm)
    waves = 2 * np.pi * experiment.elastomer.thickness_mm / pitch_mm
    return float(opposite_transfer(np.array([waves]))[0])


def _groove_over_error(experiment: Experiment, metrics: Metrics) -> float:
    contrast = _groove_contrast(experiment, metrics)
    # A sine of height h from crest to root has an RMS of h / sqrt(8).
    rms_um = 1e3 * contrast * _grating(experiment).depth_mm / math.sqrt(8.0)
    return rms_um / _number(metrics, "z_rmse_um")


def _radius_bias_mm(experiment: Experiment, metrics: Metrics) -> float:
    nominal = next(iter(shape_of(experiment.specimen).spheres())).radius_mm
    return _number(metrics, "sphere_1_true_face_radius_mm") - nominal


_DERIVED: dict[str, Callable[[Experiment, Metrics], float]] = {
    "half_contrast_pitch_mm": _kept_pitch(0.5),
    "tenth_contrast_pitch_mm": _kept_pitch(0.1),
    "groove_contrast_kept": _groove_contrast,
    "groove_over_error": _groove_over_error,
    "radius_bias_mm": _radius_bias_mm,
    "depth_over_thickness": lambda e, m: _number(m, "depth_mm") / e.elastomer.thickness_mm,
    "force_per_depth_n_per_mm": lambda _, m: _number(m, "force_n") / _number(m, "depth_mm"),
}

DERIVED = (*_DERIVED, *LAYOUT)
"""Names of the derived figures."""

OF_A_MEASUREMENT = ("groove_over_error", "radius_bias_mm")
"""Names of the derived figures that need a measurement in addition to the press."""


def with_derived(
    experiment: Experiment, metrics: Metrics, wanted: Iterable[str] = DERIVED
) -> dict[str, Metric]:
    """Return the figures of a case together with the derived figures named in `wanted`.

    A derived figure is left out if any figure that it needs is missing or None.
    """
    names, figures = list(wanted), dict(metrics)
    layout = layout_figures(experiment) if set(names) & set(LAYOUT) else {}
    for name in names:
        try:
            compute = _DERIVED.get(name)
            figures[name] = compute(experiment, metrics) if compute else layout[name]
        except (KeyError, StopIteration, ZeroDivisionError):
            continue  # no such ball or groove, no press, or no measured point
    return figures
