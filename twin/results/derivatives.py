"""Derivatives of a bound by design fields, from the tangents of the trace on.

What follows the trace is closed form: levels, contrast and sigma (`prediction`) are differentiated
by a complex step, exact to the last digit; the triangulation's slope likewise, for a camera that
stays; the exposure that the white frame asks for by the pixels at its percentile; the bound by the
share of its information that each pixel gives, d ln bound = sum shares d ln sigma. The pixels that
a fit rests on stay, and so does the surface.
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
    """Return the fields that move neither the press nor what each camera pixel sees.

    Those of the coat are what its kind states to be differentiable.
    """
    of_the_coat = (f"coating.{name}" for name in experiment.coating.differentiable)
    return (*of_the_coat, *OF_THE_PROJECTOR, *OF_THE_NUMBERS)


@dataclass(frozen=True, eq=False)
class Moved:
    """One field: what it does to the description, and to the trace.

    Attributes
    ----------
    vary : the experiment with the field moved by so much
    step : by which it is moved for numbers of the description
    maps : derivatives of the trace; None where it does not move
    """

    vary: Vary
    step: float
    maps: TraceMaps | None


def log_sigma_tangent(
    experiment: Experiment, maps: TraceMaps, truth: Truth, prediction: PredictedMaps, moved: Moved
) -> FloatArray:
    """Return d ln sigma / d field of every single pixel's height, (row, col); 0 without a point."""
    white = white_radiance(maps, experiment)
    used: tuple[Axis, ...] = AXES if experiment.decode.use == "both" else (experiment.decode.use,)
    stepped = _stepped(maps, moved.maps)
    numbers, along = _numbers(experiment, white, stepped, moved)
    total, information = np.zeros(maps.lit.shape), np.zeros(maps.lit.shape)
    for axis, one in zip(used, prediction.axes, strict=True):
        light = stepped.weight * outlines(stepped, numbers.moved(along, _STEP), experiment)
        found = axis_levels(
            stepped, numbers.moved(along, _STEP), steps_of(experiment, axis), axis, light
        )
        tangent = _log(found.sigma_px) - _log_slope_tangent(experiment, truth, axis, moved)
        share = (one.height_by_px * one.sigma_px) ** 2
        total, information = total + share * tangent, information + share
    usable = prediction.valid & (information > 0.0)
    return np.divide(total, information, out=np.zeros(total.shape), where=usable)


def _log(value: Any) -> FloatArray:
    """Return the derivative of the logarithm of what a complex step was taken through."""
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
    """Return the numbers between irradiance and sigma, and their derivatives."""

    def at(step: float) -> FringeNumbers:
        seen = moved.vary(step) if step else experiment
        return FringeNumbers.of(seen, choose_exposure_ms(seen, white))

    low, middle, high = at(-moved.step), at(0.0), at(moved.step)
    names = [one.name for one in fields(middle)]
    slopes = {n: (getattr(high, n) - getattr(low, n)) / (2.0 * moved.step) for n in names}
    if experiment.camera.exposure_ms == "auto" and moved.maps is not None:
        brighter = _percentile_tangent(experiment, middle, stepped)
        for name in ("electrons_per_radiance", "dark_e"):
            slopes[name] -= brighter * getattr(middle, name)
    return middle, FringeNumbers(**slopes)


def _percentile_tangent(
    experiment: Experiment, numbers: FringeNumbers, stepped: TraceMaps
) -> float:
    """Return d ln of the white frame's percentile, on which the exposure is chosen."""
    white = (stepped.weight * outlines(stepped, numbers, experiment)).ravel()
    place = EXPOSURE_PERCENTILE / 100.0 * (white.size - 1)
    order = np.argsort(np.real(white), kind="stable")
    below, share = int(place), place - int(place)
    ends = white[order[below]], white[order[min(below + 1, white.size - 1)]]
    return float(_log(ends[0] * (1.0 - share) + ends[1] * share))


def _log_slope_tangent(
    experiment: Experiment, truth: Truth, axis: Axis, moved: Moved
) -> FloatArray:
    """Return d ln |du / dd|: of the coordinate by the depth along each camera ray, (row, col)."""

    def numbers(seen: Experiment) -> FloatArray:
        found = true_calibration(seen)
        lens = found.projector
        pose = np.linalg.inv(found.T_world_from_proj)[:3].ravel()
        return np.concatenate([[lens.fx_px, lens.fy_px], pose])

    still = numbers(experiment)
    slopes = (numbers(moved.vary(moved.step)) - numbers(moved.vary(-moved.step))) / (2 * moved.step)
    if not slopes.any():
        return np.zeros(truth.lit.shape)
    fx, fy, *rows = still + _STEP * slopes
    rig = true_calibration(experiment)
    slope = coordinate_slope(np.array(rows).reshape(3, 4), (fx, fy), rig, truth, axis)
    return _log(np.where(truth.lit, slope, 1.0))
