"""How well a measurement can know a dimension, before it is made: bounds and spreads by noise.

Two numbers for each measurand that is a fitted length, in um:

| figure | meaning |
|---|---|
| object_NAME_crb_um | Cramer-Rao bound: the least standard deviation by noise that any unbiased fit of the shape to the decoded coordinates can have |
| object_NAME_spread_um | standard deviation by noise of the measurement's own fit, through the filter and its covariance |
| sphere_N_radius_crb_um, sphere_N_radius_spread_um | of the radius on the coat over the scored region |
| crb_radius_um, crb_width_um, crb_step_um, crb_depth_um | bound of the first measurand of that kind |
| compensated_NUMBER_crb_um, _deg | bound of a number of the object under a thick slab, through optics and mechanics (`twin.pipeline.bound`) |
| predicted_sigma_z_um | median of the standard deviation of z by noise, filtered |
| predicted_share | share of the lit pixels that will have a point |

The shape is fitted to the expected points, without noise, by the code of the measurement itself.
Systematic errors (filter bias, calibration, what the elastomer does) are no part of it.
"""  # noqa: E501 - a table

from collections.abc import Iterator

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, IntArray
from reconstruction.errors import FitError
from reconstruction.evaluate.estimates import FittedDimension, ball_radius_of_all
from reconstruction.several_periods import MICRO
from twin.config.measurands import ObjectMeasurand, Quantity
from twin.config.models import Experiment
from twin.mechanics import PressedElastomer
from twin.optics.stack import Truth
from twin.results.features import feature_of, features_of, measurands_of
from twin.results.figures import Metric
from twin.results.object_fits import fit
from twin.results.object_points import seen_object
from twin.results.prediction import PredictedMaps
from twin.results.score import region_of
from twin.specimens import shape_of

BOUNDED: dict[Quantity, str] = {
    "radius": "crb_radius_um",
    "width": "crb_width_um",
    "step_height": "crb_step_um",
    "depth": "crb_depth_um",
}
"""Quantities that have a bound, and how that of the first of them is called."""

_ALWAYS = ("predicted_sigma_z_um", "predicted_share")
_LEAST_SPHERE_POINTS = 5


def has_bound(experiment: Experiment) -> bool:
    """Tell whether the trace alone says what a measurement will know.

    Fringes on a pressed coat, by direct light: what is reflected between surfaces, or through
    clear bodies, is not in the trace. Single images of micro phase shifting know more of some
    places than of others, and have no closed form.
    """
    method = experiment.method
    direct = experiment.bounces == 0 and experiment.render.engine == "one_trace"
    closed = experiment.patterns.code != MICRO
    return method.fringes and method.presses and direct and closed


def is_bound_name(name: str) -> bool:
    """Tell whether a figure is one of `bound_figures`, whatever the experiment."""
    return name.endswith(("_crb_um", "_crb_deg", "_spread_um")) or name in {
        *_ALWAYS,
        *BOUNDED.values(),
    }


def bound_names(experiment: Experiment) -> set[str]:
    """Return the names of all figures of `bound_figures`; none without a bound."""
    if not has_bound(experiment):
        return set()
    names = set(_ALWAYS)
    for asked in _asked(experiment):
        names |= {*_names(asked), BOUNDED[asked.quantity]}
    for number in range(1, len(shape_of(experiment.specimen).spheres()) + 1):
        names |= set(_sphere_names(number))
    return names


def _asked(experiment: Experiment) -> list[ObjectMeasurand]:
    return [one for one in measurands_of(experiment) if one.quantity in BOUNDED]


def _names(asked: ObjectMeasurand) -> tuple[str, str]:
    return f"object_{asked.name}_crb_um", f"object_{asked.name}_spread_um"


def _sphere_names(number: int) -> tuple[str, str]:
    return f"sphere_{number}_radius_crb_um", f"sphere_{number}_radius_spread_um"


def bound_figures(
    experiment: Experiment, prediction: PredictedMaps, truth: Truth, pressed: PressedElastomer
) -> dict[str, Metric]:
    """Return the figures; None where the expected points do not fix a shape."""
    lit = int(truth.lit.sum())
    sigma_um = 1e3 * prediction.filtered_mm[prediction.valid]
    found: dict[str, Metric] = {
        "predicted_sigma_z_um": float(np.median(sigma_um)) if len(sigma_um) else None,
        "predicted_share": len(sigma_um) / lit if lit else None,
    }
    found |= dict(_of_spheres(experiment, prediction))
    first: dict[str, Metric] = {}
    for asked, estimate, pixels, each in _estimates(experiment, prediction, truth, pressed):
        values: _Values = (None, None)
        if estimate is not None:
            values = _bound_and_spread_um(estimate, pixels, prediction, each)
        found |= dict(zip(_names(asked), values, strict=True))
        first.setdefault(BOUNDED[asked.quantity], values[0])
    return found | first


_Values = tuple[float | None, float | None]
_Found = tuple[ObjectMeasurand, FittedDimension | None, IntArray, float]


def _estimates(
    experiment: Experiment, prediction: PredictedMaps, truth: Truth, pressed: PressedElastomer
) -> Iterator[_Found]:
    """Yield each measurand with its fit to the expected points, their pixels, and each's share."""
    points = prediction.points.points_world_mm, prediction.valid, prediction.filtered_mm
    seen = seen_object(experiment, points, truth, pressed)
    features, nowhere = features_of(experiment.specimen), np.zeros(0, np.int64)
    for asked in _asked(experiment):
        try:
            fitted = seen and fit(asked, feature_of(features, asked), seen, seen.measured)
        except FitError:
            fitted = None
        if not fitted or fitted.estimate is None or fitted.of is None or fitted.of.pixels is None:
            yield asked, None, nowhere, 1.0
        else:
            yield asked, fitted.estimate, fitted.of.pixels, fitted.of.points_each


def _of_spheres(experiment: Experiment, prediction: PredictedMaps) -> Iterator[tuple[str, Metric]]:
    """Yield bound and spread of the radii over the scored regions, fitted as by `score_sphere`."""
    world_mm = prediction.points.points_world_mm
    for number, ball in enumerate(shape_of(experiment.specimen).spheres(), start=1):
        roi = region_of(ball, world_mm, prediction.valid, experiment.score.roi_radius_mm)
        values: _Values = (None, None)
        if roi.sum() >= _LEAST_SPHERE_POINTS:
            values = _sphere_values(prediction, roi)
        yield from zip(_sphere_names(number), values, strict=True)


def _sphere_values(prediction: PredictedMaps, roi: BoolImage) -> _Values:
    try:
        estimate = ball_radius_of_all(prediction.points.points_world_mm[roi].astype(np.float64))
    except FitError:
        return None, None
    return _bound_and_spread_um(estimate, np.flatnonzero(roi).astype(np.int64), prediction, 1.0)


def _bound_and_spread_um(
    estimate: FittedDimension, pixels: IntArray, prediction: PredictedMaps, each: float
) -> _Values:
    """Return bound and spread of one fit.

    Parameters
    ----------
    pixels : (n,) index of each point's pixel
    each : how many pixels each point stands for
    """
    slope = np.zeros(prediction.reason.shape)
    slope.ravel()[pixels] = estimate.slope
    single_mm = prediction.single_mm.ravel()[pixels]
    bound_mm = estimate.bound_mm(single_mm, each)
    return (None if bound_mm is None else 1e3 * bound_mm), 1e3 * prediction.noise_mm(slope)


def information_shares(
    experiment: Experiment, prediction: PredictedMaps, truth: Truth, pressed: PressedElastomer
) -> dict[str, FloatArray]:
    """Return where the information about each bound comes from: (row, col), summing to 1.

    That is the derivative of the bound's logarithm by that of each pixel's sigma.
    """
    found: dict[str, FloatArray] = {}
    single_mm = prediction.single_mm.ravel()
    for asked, estimate, pixels, _ in _estimates(experiment, prediction, truth, pressed):
        shares = None if estimate is None else estimate.bound_shares(single_mm[pixels])
        if shares is not None:
            image = np.zeros(prediction.reason.shape)
            image.ravel()[pixels] = shares
            found[_names(asked)[0]] = image
            found.setdefault(BOUNDED[asked.quantity], image)
    return found
