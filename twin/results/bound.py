"""Predicted uncertainty of dimensions by noise, before a measurement is made: bounds and spreads.

The main figures are a bound and a spread, in um, for each measurand that is a fitted length:

| figure | meaning |
|---|---|
| object_NAME_crb_um | Cramer-Rao bound: the least standard deviation by noise that any unbiased fit of the shape to the decoded coordinates can have |
| object_NAME_spread_um | standard deviation by noise of the measurement's own fit, through the filter and its covariance |
| sphere_N_radius_crb_um, sphere_N_radius_spread_um | of the radius on the coat over the scored region |
| crb_radius_um, crb_width_um, crb_step_um, crb_depth_um | bound of the first measurand of that kind (`MeasurandKind.bound_name`) |
| compensated_NUMBER_crb_um, _deg | bound of a number of the object under a thick slab, through optics and mechanics (`twin.pipeline.bound`) |
| predicted_sigma_z_um | median over the pixels of the standard deviation of z by noise, after the filter |
| predicted_share | share of the lit pixels that will have a point |
| object_NAME_bound_why, sphere_N_radius_bound_why | text: reason why bound and spread of that length have no value |

The shape is fitted to the expected points, without noise, by the code of the measurement itself.
Systematic errors (filter bias, calibration, the elastomer's effect) are not included.
"""  # noqa: E501 - a table

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, IntArray
from reconstruction.codes import code_of
from reconstruction.errors import FitError
from reconstruction.evaluate.estimates import FittedDimension, ball_radius_of_all
from reconstruction.patterns import AXES
from reconstruction.stepping import STEPPINGS
from twin.config.measurands import MEASURANDS, ObjectMeasurand
from twin.config.models import Experiment
from twin.mechanics import PressedElastomer
from twin.optics.stack import Truth
from twin.results.balls import region_of
from twin.results.features import Feature, feature_of, features_of
from twin.results.figures import Metric
from twin.results.object_fits import fit, require_determined
from twin.results.object_points import ObjectView, seen_object
from twin.results.prediction import PredictedMaps
from twin.results.quantities import measurands_of
from twin.specimens import shape_of

_ALWAYS = ("predicted_sigma_z_um", "predicted_share")
_LEAST_SPHERE_POINTS = 5


def has_bound(experiment: Experiment) -> bool:
    """Return True if bounds can be computed from the ray trace of the experiment.

    This requires fringes on a pressed coat and only direct light: the trace does not contain light
    that is reflected between surfaces or passes through clear bodies. The engine of the renderer
    must be "one_trace". White, black and the sinusoidal fringes of both axes must be projected,
    with a code and a stepping that have a closed form of the noise. Micro phase shifting has none,
    because the information of its images depends on the position in the fringe.
    """
    method = experiment.method
    direct = experiment.bounces == 0 and experiment.render.engine == "one_trace"
    patterns = experiment.patterns
    whole = patterns.steps > 0 and patterns.uniform and set(patterns.axes) == set(AXES)
    closed = whole and code_of(patterns.code).has_closed_form
    closed = closed and not STEPPINGS[patterns.stepping].is_reduced
    closed = closed and patterns.waveform == "sinusoidal"
    return method.fringes and method.presses and direct and closed


def is_bound_name(name: str) -> bool:
    """Return True if `bound_figures` gives a figure of this name for some experiment."""
    return name.endswith(("_crb_um", "_crb_deg", "_spread_um", "_bound_why")) or name in {
        *_ALWAYS,
        *filter(None, (kind.bound_name for kind in MEASURANDS)),
    }


def bound_names(experiment: Experiment) -> set[str]:
    """Return the names of all figures of `bound_figures`; empty if there are no bounds."""
    if not has_bound(experiment):
        return set()
    names = set(_ALWAYS)
    for request in _bounded_requests(experiment):
        names |= {
            *_names(request),
            MEASURANDS[request.quantity].bound_name,
            f"object_{request.name}_bound_why",
        }
    for number in range(1, len(shape_of(experiment.specimen).spheres()) + 1):
        names |= {*_sphere_names(number), f"sphere_{number}_radius_bound_why"}
    return names


def _bounded_requests(experiment: Experiment) -> list[ObjectMeasurand]:
    return [
        request for request in measurands_of(experiment) if MEASURANDS[request.quantity].bound_name
    ]


def _names(request: ObjectMeasurand) -> tuple[str, str]:
    return f"object_{request.name}_crb_um", f"object_{request.name}_spread_um"


def _sphere_names(number: int) -> tuple[str, str]:
    return f"sphere_{number}_radius_crb_um", f"sphere_{number}_radius_spread_um"


def bound_figures(
    experiment: Experiment, prediction: PredictedMaps, truth: Truth, pressed: PressedElastomer
) -> dict[str, Metric]:
    """Return the figures of the module docstring by name, except those of an object under a slab.

    A bound and its spread are None if the expected points do not determine the shape.
    """
    lit = int(truth.lit.sum())
    sigma_um = 1e3 * prediction.filtered_mm[prediction.valid]
    figures: dict[str, Metric] = {
        "predicted_sigma_z_um": float(np.median(sigma_um)) if len(sigma_um) else None,
        "predicted_share": len(sigma_um) / lit if lit else None,
    }
    figures |= dict(_of_spheres(experiment, prediction))
    first: dict[str, Metric] = {}
    for request, expected in _expected_fits(experiment, prediction, truth, pressed):
        values, why = _figures_of(request.quantity, expected, prediction)
        figures |= dict(zip(_names(request), values, strict=True))
        figures |= {f"object_{request.name}_bound_why": why} if why else {}
        first.setdefault(MEASURANDS[request.quantity].bound_name, values[0])
    return figures | first


_Values = tuple[float | None, float | None]


@dataclass(frozen=True, eq=False)
class _ExpectedFit:
    """A shape fitted to the expected points, which have no noise.

    Attributes
    ----------
    estimate : the fit; None if there is no fit, `why` gives the reason
    pixels : (n,) flat index of the camera pixel of each point
    each : number of pixels that each point represents
    points_mm : (n, xyz) fitted points, world frame
    why : reason why there is no fit; else empty
    """

    estimate: FittedDimension | None = None
    pixels: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    each: float = 1.0
    points_mm: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    why: str = ""


def _figures_of(
    quantity: str, expected: _ExpectedFit, prediction: PredictedMaps
) -> tuple[_Values, str]:
    """Return bound and spread, um, and the reason why both are None; the reason is else empty."""
    if expected.estimate is None:
        return (None, None), expected.why
    values = _bound_and_spread_um(expected.estimate, expected.pixels, prediction, expected.each)
    try:
        require_determined(quantity, 1e-3 * max(v or 0.0 for v in values), expected.points_mm)
    except FitError as error:
        return (None, None), str(error)
    return values, ""


def _expected_fits(
    experiment: Experiment, prediction: PredictedMaps, truth: Truth, pressed: PressedElastomer
) -> Iterator[tuple[ObjectMeasurand, _ExpectedFit]]:
    """Yield each measurand that has a bound with its fit to the expected points."""
    points = prediction.points.points_world_mm, prediction.valid, prediction.filtered_mm
    observed = seen_object(experiment, points, truth, pressed)
    features = features_of(experiment.specimen)
    for request in _bounded_requests(experiment):
        yield request, _expected_fit(request, feature_of(features, request), observed)


def _expected_fit(
    request: ObjectMeasurand, feature: Feature, observed: ObjectView | None
) -> _ExpectedFit:
    if observed is None:
        return _ExpectedFit(why="no points of the object are expected")
    try:
        fitted = fit(request, feature, observed, observed.measured)
    except FitError as error:
        return _ExpectedFit(why=str(error))
    of, pixels = fitted.of, None if fitted.of is None else fitted.of.pixels
    if fitted.estimate is None or of is None or pixels is None:
        return _ExpectedFit(why=f"{request.quantity}: no fitted shape with a known bound")
    return _ExpectedFit(fitted.estimate, pixels, of.points_each, fitted.points_mm)


def _of_spheres(experiment: Experiment, prediction: PredictedMaps) -> Iterator[tuple[str, Metric]]:
    """Yield bound and spread, um, of each ball's radius over the scored region, with names.

    The spheres are fitted in the same way as in `score_sphere`.
    """
    world_mm = prediction.points.points_world_mm
    for number, ball in enumerate(shape_of(experiment.specimen).spheres(), start=1):
        roi = region_of(ball, world_mm, prediction.valid, experiment.score.roi_radius_mm)
        values, why = _figures_of("radius", _expected_sphere(prediction, roi), prediction)
        yield from zip(_sphere_names(number), values, strict=True)
        if why:
            yield f"sphere_{number}_radius_bound_why", why


def _expected_sphere(prediction: PredictedMaps, roi: BoolImage) -> _ExpectedFit:
    points_mm = prediction.points.points_world_mm[roi].astype(np.float64)
    if len(points_mm) < _LEAST_SPHERE_POINTS:
        return _ExpectedFit(why=f"radius: {len(points_mm)} points expected, it takes 5")
    try:
        estimate = ball_radius_of_all(points_mm)
    except FitError as error:
        return _ExpectedFit(why=str(error))
    return _ExpectedFit(estimate, np.flatnonzero(roi).astype(np.int64), 1.0, points_mm)


def _bound_and_spread_um(
    estimate: FittedDimension, pixels: IntArray, prediction: PredictedMaps, each: float
) -> _Values:
    """Return bound and spread, um, of one fit; the bound may be None.

    Parameters
    ----------
    pixels : (n,) flat index of the camera pixel of each point
    each : number of pixels that each point represents
    """
    slope = np.zeros(prediction.reason.shape)
    slope.ravel()[pixels] = estimate.slope
    single_mm = prediction.single_mm.ravel()[pixels]
    bound_mm = estimate.bound_mm(single_mm, each)
    return (None if bound_mm is None else 1e3 * bound_mm), 1e3 * prediction.noise_mm(slope)


def information_shares(
    experiment: Experiment, prediction: PredictedMaps, truth: Truth, pressed: PressedElastomer
) -> dict[str, FloatArray]:
    """Return, by name of each bound, the share (row, col) of each pixel in the information.

    The shares of a bound sum to 1. The share of a pixel is d ln bound / d ln sigma, with sigma the
    standard deviation of the pixel's height.
    """
    images: dict[str, FloatArray] = {}
    single_mm = prediction.single_mm.ravel()
    for request, expected in _expected_fits(experiment, prediction, truth, pressed):
        shares = (
            None
            if expected.estimate is None
            else expected.estimate.bound_shares(single_mm[expected.pixels])
        )
        if shares is not None:
            image = np.zeros(prediction.reason.shape)
            image.ravel()[expected.pixels] = shares
            images[_names(request)[0]] = image
            images.setdefault(MEASURANDS[request.quantity].bound_name, image)
    return images
