"""Names of all figures that a measurement may have, known before the measurement is made.

They are needed to stop a study before its first case if it names a figure that no case will have.
A test measures by every method and checks that every figure is named here.
"""

from collections.abc import Iterable, Iterator
from dataclasses import fields

from reconstruction.evaluate.conformity import CombinedUncertainty
from twin.config.models import Experiment
from twin.config.nominal import NominalHexNut
from twin.mechanics.choice import is_slab, may_wrap
from twin.results.balls import region_name, sphere_names
from twin.results.bound import bound_names, has_bound
from twin.results.compensated import slab_bound_name, slab_name
from twin.results.features import bars_of, feature_of, features_of
from twin.results.figures import COMPENSATED
from twin.results.motion import MOTION_FIGURES
from twin.results.object_points import is_covered
from twin.results.object_score import (
    MeasuredQuantity,
    deviation_figures,
    quantity_figures,
    summary_of,
    tolerance_of,
)
from twin.results.quantities import measurands_of, nominal_mm
from twin.results.rods import single_section
from twin.results.score import FringeScore, HeightScore
from twin.specimens import shape_of

OF_A_PRESS = (
    "mechanics_model", "force_n", "depth_mm", "young_modulus_kpa", "relief_peak_mm",
    "peak_pressure_kpa", "height_error_estimate_mm", "thinnest_mm", "largest_stretch",
    "steepest_deg", "shear_force_n", "stick_area_share", "largest_slip_mm", "initial_force_n",
    "relief_change_um", "texture_rms_um", "texture_correlation_mm",
)  # fmt: skip
_OF_A_RECORDING = ("exposure_ms", "frames", "sequence_ms", "saturated_share")
_OF_A_ROD = (
    "rod_width_mm", "rod_break_width_mm", "rod_slope_change_width_mm", "rod_height_mm",
    "rod_failure",
)  # fmt: skip
_OF_A_NUT = ("nut_hole_depth_mm", "nut_hexagon_share")
_ALWAYS = ("warnings", "unfitted_balls")
_OF_A_CONTACT = ("force_n", "force_sigma_n", "contact_area_mm2")
_OF_A_BAR = ("width_mm", "width_sigma_um", "turn_deg", "sheet_on_edge", "width_why")


def may_compensate(experiment: Experiment) -> bool:
    """Return True if the object behind the measured coat can be reconstructed.

    This requires a press measured with fringes, and one of three layers: a sheet that may wrap the
    object, a coat on the contact face, or a slab over a specimen with dimensions that can be
    fitted.
    """
    elastomer, method = experiment.elastomer, experiment.method
    free_form = elastomer.layout == "contact_face" or may_wrap(elastomer)
    fitted = is_slab(elastomer) and bool(experiment.specimen.slab_fit_paths)
    return method.fringes and method.presses and (free_form or fitted)


def compensates_at_once(experiment: Experiment) -> bool:
    """Return True if the object behind the coat can be reconstructed in about 1 s.

    False for a slab, because its fit takes about 5 s, and if no object can be reconstructed.
    """
    return may_compensate(experiment) and not is_slab(experiment.elastomer)


def of_the_object(names: Iterable[str]) -> bool:
    """Return True if one of the names is that of a figure of the object behind the coat."""
    return any(name.startswith(COMPENSATED) for name in names)


def compensated_names(experiment: Experiment) -> set[str]:
    """Return the names of the figures of the object behind the coat.

    The set is empty if the object is not reconstructed.
    """
    if not may_compensate(experiment):
        return set()
    names, bounds = [*_OF_A_CONTACT, "thickness_mm"], set[str]()
    if is_slab(experiment.elastomer):
        fitted_paths = experiment.specimen.slab_fit_paths
        names = [*_OF_A_CONTACT, *_of_a_slab(fitted_paths)]
        bounds = (
            {slab_bound_name(path) for path in fitted_paths} if has_bound(experiment) else set()
        )
    for number in range(1, len(shape_of(experiment.specimen).spheres()) + 1):
        names += [f"sphere_{number}_radius_mm", f"sphere_{number}_radius_sigma_um"]
    bars = bars_of(experiment.specimen) if may_wrap(experiment.elastomer) else []
    for number in range(1, len(bars) + 1):
        names += [f"bar_{number}_{name}" for name in _OF_A_BAR]
    return {f"{COMPENSATED}{name}" for name in names} | bounds


def _of_a_slab(fitted_paths: tuple[str, ...]) -> Iterator[str]:
    for path in (*fitted_paths, "travel_mm"):
        of, name = ("deg", "deg") if path.endswith("_deg") else ("mm", "um"), slab_name(path)
        yield from (f"{name}_{of[0]}", f"{name}_sigma_{of[1]}")


def figure_names(experiment: Experiment) -> set[str]:
    """Return the names of all figures that the result of the experiment may have."""
    method = experiment.method
    score = FringeScore if method.fringes else HeightScore
    names = {field.name for field in fields(score)} | set(_ALWAYS)
    names |= set(_OF_A_RECORDING) if method.fringes else set()
    names |= set(MOTION_FIGURES) if experiment.motion.moves else set()
    names |= set(OF_A_PRESS) if method.presses else set()
    balls = len(shape_of(experiment.specimen).spheres())
    for region in ("", *(region_name(radius) for radius in experiment.score.regions_mm)):
        names |= set(sphere_names(balls, region))
    if single_section(experiment.specimen):
        names |= {f"{of}{name}" for of in ("", "true_face_") for name in _OF_A_ROD}
    if experiment.specimen.nominal(NominalHexNut):
        names |= {f"{of}{name}" for of in ("", "true_face_") for name in _OF_A_NUT}
    names |= _of_the_object(experiment) | bound_names(experiment)
    return names | compensated_names(experiment)


def _of_the_object(experiment: Experiment) -> set[str]:
    features = features_of(experiment.specimen)
    unknown = [
        MeasuredQuantity(
            measurand=request,
            nominal=nominal_mm(feature_of(features, request), request),
            value=None,
            true_face=None,
            uncertainty=CombinedUncertainty(0.0),
            tolerance=tolerance_of(request),
            points_mm=None,
            why="not measured yet",
            condition="not known yet",
            covered=is_covered(experiment) and request.hidden,
        )
        for request in measurands_of(experiment)
    ]
    names = {name for name, _ in deviation_figures(None, {}, {})} | set(summary_of(tuple(unknown)))
    return names | {name for request in unknown for name, _ in quantity_figures(request)}
