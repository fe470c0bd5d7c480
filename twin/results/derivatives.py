"""Derivatives of a bound with respect to design fields, given the derivatives of the ray trace.

The steps after the trace have closed forms. Levels, contrast and sigma (`prediction`) are
differentiated by a complex step, which is exact to the last digit. The slope of the triangulation
is differentiated likewise, for a fixed camera. The derivative of an automatic exposure follows from
the pixels at the percentile of the white frame. The derivative of the bound follows from the share
of each pixel in the information: d ln bound = sum shares d ln sigma. The set of fitted pixels and
the surface are taken as constant.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray, FloatImage
from reconstruction.patterns import AXES, Axis
from twin.camera import choose_exposure_ms
from twin.config.bounds import EXPOSURE_PERCENTILE
from twin.config.models import Experiment
from twin.optics.rig import true_calibration
from twin.optics.stack import TraceMaps, Truth
from twin.results.fringe_levels import (
    FringeNumbers,
    axis_levels,
    outlines,
    steps_of,
    white_radiance,
)
from twin.results.prediction import PredictedMaps, coordinate_slope

Vary = Callable[[float], Experiment]
_STEP = 1e-20j

OF_THE_PROJECTOR = (
    "projector.flux_mw", "projector.blur_px", "projector.focus_mm", "projector.aperture_mm",
    "projector.pose.standoff_mm", "projector.pose.polar_deg", "projector.pose.azimuth_deg",
    "projector.pose.roll_deg", "projector.throw_ratio", "projector.offset_percent",
)  # fmt: skip
OF_THE_NUMBERS = (
    "patterns.period_px", "camera.exposure_ms", "camera.auto_level", "camera.f_number",
    "camera.quantum_efficiency", "camera.lens_transmission", "camera.read_noise_e",
)  # fmt: skip


def differentiated(experiment: Experiment) -> tuple[str, ...]:
    """Return the paths of the fields that change neither the press nor the view of a camera pixel.

    Fields of the coat are included if the kind of coat declares them differentiable.
    """
    of_the_coat = (f"coating.{name}" for name in experiment.coating.differentiable)
    return (*of_the_coat, *OF_THE_PROJECTOR, *OF_THE_NUMBERS)


@dataclass(frozen=True, eq=False)
class Moved:
    """One varied field: its effect on the experiment and on the ray trace.

    Attributes
    ----------
    vary : function that returns the experiment with the field changed by a given amount
    step : change of the field for central differences of numbers of the experiment, in its unit
    maps : derivatives of the trace with respect to the field; None if the trace does not change
    """

    vary: Vary
    step: float
    maps: TraceMaps | None


def log_sigma_tangent(
    experiment: Experiment, maps: TraceMaps, truth: Truth, prediction: PredictedMaps, moved: Moved
) -> FloatArray:
    """Return d ln sigma / d field of each pixel's height before the filter, (row, col).

    It is 0 for pixels without a point.
    """
    white = white_radiance(maps, experiment)
    used: tuple[Axis, ...] = AXES if experiment.decode.use == "both" else (experiment.decode.use,)
    stepped = _stepped(maps, moved.maps)
    numbers, along = _numbers(experiment, white, stepped, moved)
    total, information = np.zeros(maps.lit.shape), np.zeros(maps.lit.shape)
    for axis, axis_maps in zip(used, prediction.axes, strict=True):
        light = stepped.weight * outlines(stepped, numbers.moved(along, _STEP), experiment)
        levels = axis_levels(
            stepped, numbers.moved(along, _STEP), steps_of(experiment, axis), axis, light
        )
        tangent = _log(levels.sigma_px) - _log_slope_tangent(experiment, truth, axis, moved)
        share = (axis_maps.height_by_px * axis_maps.sigma_px) ** 2
        total, information = total + share * tangent, information + share
    usable = prediction.valid & (information > 0.0)
    return np.divide(total, information, out=np.zeros(total.shape), where=usable)


def _log(value: Any) -> FloatArray:
    """Return the derivative of the logarithm of a value that was computed with a complex step."""
    return np.asarray(np.imag(value) / np.real(value) / abs(_STEP), np.float64)


def _stepped(maps: TraceMaps, tangent: TraceMaps | None) -> TraceMaps:
    if tangent is None:
        return maps
    names = ("weight", "column_px", "row_px", "axial_mm")
    moved = {n: getattr(maps, n) + _STEP * getattr(tangent, n) for n in names}
    return replace(maps, **moved)


def _numbers(
    experiment: Experiment, white: FloatImage, stepped: TraceMaps, moved: Moved
) -> tuple[FringeNumbers, FringeNumbers]:
    """Return the numbers that link irradiance to sigma, and their derivatives by the field."""

    def at(step: float) -> FringeNumbers:
        varied = moved.vary(step) if step else experiment
        return FringeNumbers.of(varied, choose_exposure_ms(varied, white))

    low, middle, high = at(-moved.step), at(0.0), at(moved.step)
    names = [field.name for field in fields(middle)]
    slopes = {n: (getattr(high, n) - getattr(low, n)) / (2.0 * moved.step) for n in names}
    if experiment.camera.exposure_ms == "auto" and moved.maps is not None:
        brighter = _percentile_tangent(experiment, middle, stepped)
        for name in ("electrons_per_radiance", "dark_e"):
            slopes[name] -= brighter * getattr(middle, name)
    return middle, FringeNumbers(**slopes)


def _percentile_tangent(
    experiment: Experiment, numbers: FringeNumbers, stepped: TraceMaps
) -> float:
    """Return d ln p / d field, with p the percentile of the white frame that sets the exposure."""
    white = (stepped.weight * outlines(stepped, numbers, experiment)).ravel()
    place = EXPOSURE_PERCENTILE / 100.0 * (white.size - 1)
    order = np.argsort(np.real(white), kind="stable")
    below, share = int(place), place - int(place)
    ends = white[order[below]], white[order[min(below + 1, white.size - 1)]]
    return float(_log(ends[0] * (1.0 - share) + ends[1] * share))


def _log_slope_tangent(
    experiment: Experiment, truth: Truth, axis: Axis, moved: Moved
) -> FloatArray:
    """Return the derivative of ln |du / dd| with respect to the field, (row, col).

    u is the projector coordinate and d the depth along the camera ray of each pixel.
    """

    def numbers(varied: Experiment) -> FloatArray:
        calibration = true_calibration(varied)
        lens = calibration.projector
        pose = np.linalg.inv(calibration.T_world_from_proj)[:3].ravel()
        return np.concatenate([[lens.fx_px, lens.fy_px], pose])

    still = numbers(experiment)
    slopes = (numbers(moved.vary(moved.step)) - numbers(moved.vary(-moved.step))) / (2 * moved.step)
    if not slopes.any():
        return np.zeros(truth.lit.shape)
    fx, fy, *rows = still + _STEP * slopes
    rig = true_calibration(experiment)
    slope = coordinate_slope(np.array(rows).reshape(3, 4), (fx, fy), rig, truth, axis)
    return _log(np.where(truth.lit, slope, 1.0))
