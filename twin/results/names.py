"""Names of all figures that a measurement may have, known before it is made.

A study that ranks by a figure which no case will have must say so before its first case. A test
measures by every method and finds no figure that is not named here.
"""

from dataclasses import fields

from reconstruction.evaluate.conformity import CombinedUncertainty
from twin.config.models import Experiment
from twin.results.bound import bound_names
from twin.results.features import feature_of, features_of, measurands_of, nominal_mm
from twin.results.object_score import (
    MeasuredQuantity,
    deviation_figures,
    quantity_figures,
    summary_of,
    tolerance_of,
)
from twin.results.rods import has_one_rod
from twin.results.score import FringeScore, HeightScore, region_name, sphere_names
from twin.specimens import shape_of

OF_A_PRESS = (
    "mechanics_model", "force_n", "depth_mm", "young_modulus_kpa", "relief_peak_mm",
    "peak_pressure_kpa", "height_error_estimate_mm", "thinnest_mm", "largest_stretch",
    "steepest_deg", "texture_rms_um", "texture_correlation_mm",
)  # fmt: skip
_OF_A_RECORDING = ("exposure_ms", "frames", "saturated_share")
_OF_A_ROD = ("rod_width_mm", "rod_break_width_mm", "rod_height_mm", "rod_failure")
_ALWAYS = ("warnings", "unfitted_balls")


def figure_names(experiment: Experiment) -> set[str]:
    """Return the names of all figures that the experiment's result may have."""
    method = experiment.method
    score = FringeScore if method.fringes else HeightScore
    names = {one.name for one in fields(score)} | set(_ALWAYS)
    names |= set(_OF_A_RECORDING) if method.fringes else set()
    names |= set(OF_A_PRESS) if method.presses else set()
    balls = len(shape_of(experiment.specimen).spheres())
    for region in ("", *(region_name(radius) for radius in experiment.score.regions_mm)):
        names |= set(sphere_names(balls, region))
    if has_one_rod(experiment):
        names |= {f"{of}{name}" for of in ("", "true_face_") for name in _OF_A_ROD}
    return names | _of_the_object(experiment) | bound_names(experiment)


def _of_the_object(experiment: Experiment) -> set[str]:
    features = features_of(experiment.specimen)
    unknown = [
        MeasuredQuantity(
            asked=one,
            nominal=nominal_mm(feature_of(features, one), one),
            value=None,
            true_face=None,
            uncertainty=CombinedUncertainty(0.0),
            tolerance=tolerance_of(one),
            points_mm=None,
            why="not measured yet",
        )
        for one in measurands_of(experiment)
    ]
    names = {name for name, _ in deviation_figures(None, {}, {})} | set(summary_of(tuple(unknown)))
    return names | {name for one in unknown for name, _ in quantity_figures(one)}
