"""Measure flatness (ISO 12781-1), roughness (ISO 25178-2), steps and bar widths; lengths in mm."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.errors import FitError
from reconstruction.evaluate.fit import PlaneFit, fit_inliers, fit_plane, rms
from reconstruction.evaluate.robust import fit_heights

# Standard deviation over nesting index L of the Gaussian of ISO 16610-61,
# exp(-pi (x / (a L))^2) / (a L)^2 with a = sqrt(ln 2 / pi).
_SIGMA_OVER_NESTING = np.sqrt(np.log(2.0) / np.pi) / np.sqrt(2.0 * np.pi)
_LEAST_SUPPORT = 0.5


@dataclass(frozen=True, eq=False)
class Flatness:
    """Flatness deviations of points from their reference plane.

    Attributes
    ----------
    peak_to_valley_mm, rms_mm : float
        Peak-to-valley and RMS flatness deviation of ISO 12781-1, over the inliers.
    inliers : (n,) bool
        Points that are no outliers.
    plane : PlaneFit
        Reference plane, fitted to the inliers.
    """

    peak_to_valley_mm: float
    rms_mm: float
    inliers: BoolImage
    plane: PlaneFit


def flatness(points_mm: ArrayLike) -> Flatness:
    """Return the flatness deviations of points from their reference plane.

    The plane is fitted by least squares; the fit is repeated with the outliers excluded.

    Parameters
    ----------
    points_mm : (n, 3) float

    Raises
    ------
    FitError : too few points, or all on one line
    """
    points = np.asarray(points_mm, np.float64)
    fit = fit_inliers(
        lambda used: fit_plane(points[used]),
        lambda plane: distances_mm(points, plane),
        np.ones(len(points), bool),
    )
    residuals = fit.shape.residuals_mm
    return Flatness(float(np.ptp(residuals)), rms(residuals), fit.fitted, fit.shape)


def distances_mm(points_mm: FloatArray, plane: PlaneFit) -> FloatArray:
    """Return the signed distances (n,) of points (n, 3) from a plane, positive along its normal."""
    distances: FloatArray = (points_mm - plane.centroid_mm) @ plane.normal
    return distances


@dataclass(frozen=True)
class ArealRoughness:
    """Height parameters of the S-L surface by ISO 25178-2.

    sa_mm is the arithmetic mean height Sa and sq_mm the RMS height Sq. sz_mm is the maximum height
    Sz, from the lowest to the highest point.
    """

    sa_mm: float
    sq_mm: float
    sz_mm: float


_LONGEST_NESTING = 10.0
"""Largest nesting index over the longer side of the field: the memory and run time of the Gaussian
filter increase with the nesting index."""


def areal_roughness(
    z_mm: ArrayLike, valid: ArrayLike, pitch_mm: float, nesting_mm: float
) -> ArealRoughness:
    """Return height parameters after removal of plane and waviness.

    The waviness is removed by the Gaussian L-filter of ISO 16610-61.

    Parameters
    ----------
    z_mm : (row, col) float
        Heights on a square grid.
    valid : (row, col) bool
        True at grid nodes with a height.
    pitch_mm : float
        Distance of neighbouring grid nodes.
    nesting_mm : float
        Nesting index of the L-filter: the wavelength of which 50 % of the amplitude remains in the
        roughness.

    Raises
    ------
    FitError : there are too few heights, or the nesting index is below two pitches or above ten
        times the longer side of the field
    """
    z, has_height = np.asarray(z_mm, np.float64), np.asarray(valid, bool)
    longest_mm = _LONGEST_NESTING * max(z.shape) * pitch_mm
    if not 2.0 * pitch_mm <= nesting_mm <= longest_mm:
        raise FitError(
            f"nesting_mm: found {nesting_mm:g}, allowed at least {2 * pitch_mm:g} (two pitches) "
            f"and at most {longest_mm:g} (ten fields): a longer wave has no effect"
        )
    y, x = np.mgrid[: z.shape[0], : z.shape[1]] * pitch_mm
    plane = flatness(np.column_stack([x[has_height], y[has_height], z[has_height]])).plane
    tilt = (
        plane.centroid_mm[2]
        - (
            (x - plane.centroid_mm[0]) * plane.normal[0]
            + (y - plane.centroid_mm[1]) * plane.normal[1]
        )
        / plane.normal[2]
    )
    level = np.where(has_height, z - tilt, 0.0)
    rough = _without_waviness(level, has_height, _SIGMA_OVER_NESTING * nesting_mm / pitch_mm)
    return ArealRoughness(float(np.mean(np.abs(rough))), rms(rough), float(np.ptp(rough)))


def _without_waviness(level: FloatArray, has_height: FloatArray, sigma_px: float) -> FloatArray:
    """Return heights minus their Gaussian mean, minus the mean of the difference, (n,) mm.

    Nodes are left out if less than 50 % of the filter's weight there is at nodes with a height.

    Parameters
    ----------
    level : (row, col) heights after removal of the plane, 0 at nodes without a height
    sigma_px : standard deviation of the Gaussian, in pitches
    """
    weight = gaussian_filter(has_height.astype(np.float64), sigma_px, mode="constant")
    wave = gaussian_filter(level, sigma_px, mode="constant") / np.maximum(weight, 1e-12)
    rated = has_height & (weight >= _LEAST_SUPPORT)
    rough: FloatArray = (level - wave)[rated]
    if not rough.size:
        raise FitError("roughness: no height has enough neighbours; take a smaller nesting_mm")
    return np.asarray(rough - rough.mean())


_LEAST_POINTS = 5
_MOST_LINE_FITS = 10
_STEPS_PER_SIGMA = 4
# Least change of slope that counts as an edge and not as texture, over the largest one on a side.
_STRONG = 0.5
_REACH_STEPS = 4 * _STEPS_PER_SIGMA


@dataclass(frozen=True)
class StepHeight:
    """Height of a ridge or groove by ISO 5436-1, type A1.

    Attributes
    ----------
    height_mm : float
        Height of a ridge; negative for a groove.
    rms_mm : float
        RMS of the residuals from the two parallel lines.
    """

    height_mm: float
    rms_mm: float


@dataclass(frozen=True)
class BarWidth:
    """Width of a raised bar or crest in a profile.

    Attributes
    ----------
    width_mm : float
        Distance of the two ends.
    height_mm : float
        Height of the top above the ground, as the function that measured it defines both.
    left_mm, right_mm : float
        Positions of the two ends along the profile, interpolated between samples.
    """

    width_mm: float
    height_mm: float
    left_mm: float
    right_mm: float


def step_height(s_mm: ArrayLike, z_mm: ArrayLike, left_mm: float, right_mm: float) -> StepHeight:
    """Return the height h of a ridge or groove between two edges in a profile.

    z = a + b s + h d(s) is fitted to the profile. d is 1 over the middle third of the width W
    between the edges. d is 0 on each side over a stretch that starts W / 3 outside of the edge and
    is 2 W / 3 long (ISO 5436-1, 7.2). All other points are not used. The fit is repeated with
    the outliers excluded.

    Parameters
    ----------
    s_mm, z_mm : (n,) float
        Positions along the profile and heights; the caller removes points without a height.
    left_mm, right_mm : float
        Positions of the edges.

    Raises
    ------
    FitError : one of the three stretches has fewer than five points
    """
    s, z = np.asarray(s_mm, np.float64), np.asarray(z_mm, np.float64)
    width = right_mm - left_mm
    inside = np.abs(s - (left_mm + right_mm) / 2) <= width / 6
    before = (s >= left_mm - width) & (s <= left_mm - width / 3)
    after = (s >= right_mm + width / 3) & (s <= right_mm + width)
    for name, part in (("ridge", inside), ("left", before), ("right", after)):
        if part.sum() < _LEAST_POINTS:
            raise FitError(f"step height: {part.sum()} points on the {name} stretch, 5 needed")
    used = inside | before | after
    design = np.column_stack([np.ones_like(s), s, inside.astype(np.float64)])[used]
    fit = fit_heights(design, z[used], most_fits=_MOST_LINE_FITS)
    residuals = z[used] - design @ fit.shape
    return StepHeight(float(fit.shape[2]), rms(residuals[fit.inliers]))


def bar_width(s_mm: ArrayLike, z_mm: ArrayLike, fraction: float = 0.5) -> BarWidth:
    """Measure the width of a bar between the positions where it reaches a fraction of its height.

    The ground is the median of the lowest third of the heights, the top the median of the highest
    10 %.

    Parameters
    ----------
    s_mm, z_mm : (n,) float
        Positions along the profile, ascending, and heights.
    fraction : float
        Height above the ground at which the width is measured, divided by the height of the bar;
        between 0 and 1.

    Raises
    ------
    FitError : the profile has fewer than 20 points, or no bar with ground on both sides
    """
    s, z = np.asarray(s_mm, np.float64), np.asarray(z_mm, np.float64)
    if not 0.0 < fraction < 1.0 or s.size < 4 * _LEAST_POINTS:
        raise FitError("bar width: needs a fraction between 0 and 1, and at least 20 points")
    order = np.sort(z)
    ground, top = np.median(order[: s.size // 3]), np.median(order[-(s.size // 10 or 1) :])
    level = ground + fraction * (top - ground)
    above = np.flatnonzero(z >= level)
    first, last = above[0], above[-1]
    if first == 0 or last == s.size - 1:
        raise FitError("bar width: the bar reaches the profile's end; give a longer profile")
    left, right = _crossing(s, z, first - 1, level), _crossing(s, z, last, level)
    return BarWidth(right - left, float(top - ground), left, right)


def break_width(s_mm: ArrayLike, z_mm: ArrayLike, sigma_mm: float) -> BarWidth:
    """Measure the width of a crest between the two positions where its curvature is largest.

    The profile is smoothed by a Gaussian. Each end is the position, in the upper half of a side of
    the crest, where the downward curvature -z'' / (1 + z'^2)^(3/2) is largest. On a trapezoid this
    is the upper edge; for steep flanks it is up to one sigma inside of the edge. A round crest has
    no such edge and no break width. The ground is the median of the lowest third of the heights,
    the top is the largest height.

    Parameters
    ----------
    s_mm, z_mm : (n,) float
        Positions along the profile, ascending, and heights.
    sigma_mm : float
        Standard deviation of the Gaussian.

    Raises
    ------
    FitError : the profile does not bend down on both sides of its middle, or the distance of the
        two ends is less than sigma_mm, as on a round crest
    """
    return _width_between_bends(s_mm, z_mm, sigma_mm, _curvature)


def slope_change_width(s_mm: ArrayLike, z_mm: ArrayLike, sigma_mm: float) -> BarWidth:
    """Measure the width of a crest between the positions where its slope changes fastest.

    Parameters and errors are those of `break_width`. At each end -z'' of the smoothed profile is
    largest, which is the upper edge of a trapezoid with flanks of any steepness. A sheet that spans
    free over the flanks may bend a second time further outside. The end is therefore the first
    maximum of -z'', from the middle outwards, that is at least 50 % of the largest value.
    """
    return _width_between_bends(s_mm, z_mm, sigma_mm, _slope_change, _first_strong)


def _width_between_bends(
    s_mm: ArrayLike,
    z_mm: ArrayLike,
    sigma_mm: float,
    bend: Callable[[FloatArray, float], FloatArray],
    pick: Callable[[FloatArray], int] = lambda outward: int(np.argmax(outward)),
) -> BarWidth:
    s, z = np.asarray(s_mm, np.float64), np.asarray(z_mm, np.float64)
    if s.size < 4 * _LEAST_POINTS or sigma_mm <= 0.0:
        raise FitError("break width: needs at least 20 points, and sigma_mm above 0")
    step = sigma_mm / _STEPS_PER_SIGMA
    even = np.arange(s[0], s[-1], step)
    heights = np.interp(even, s, z)
    ground, top = float(np.median(np.sort(z)[: s.size // 3])), float(z.max())
    upper = heights >= (ground + top) / 2
    down = np.where(upper, -bend(heights, step), 0.0)
    # The Gaussian continues both ends by a level ground, towards which they bend.
    down[:_REACH_STEPS] = down[-_REACH_STEPS:] = 0.0
    middle = int(np.flatnonzero(upper)[[0, -1]].mean())
    left, right = middle - 1 - pick(down[:middle][::-1]), middle + pick(down[middle:])
    if min(down[left], down[right]) <= 0.0:
        raise FitError("break width: the profile does not bend down on both sides of its middle")
    ends = _summit(even, down, left), _summit(even, down, right)
    if ends[1] - ends[0] < sigma_mm:
        raise FitError(
            f"break width: the crest is round: the distance of its bends is "
            f"{max(ends[1] - ends[0], 0.0):.3f} mm, less than the {sigma_mm:g} mm of the filter"
        )
    return BarWidth(ends[1] - ends[0], top - ground, *ends)


def _first_strong(outward: FloatArray) -> int:
    """Return the index of the first local maximum of at least 50 % of the largest value.

    It is the index of the largest value if there is no such local maximum.
    """
    higher = np.r_[False, outward[1:-1] >= np.maximum(outward[:-2], outward[2:]), False]
    strong = np.flatnonzero(higher & (outward >= _STRONG * outward.max()))
    return int(strong[0]) if strong.size else int(np.argmax(outward))


def _summit(s: FloatArray, values: FloatArray, at: int) -> float:
    """Return the position, mm, of the maximum of a parabola through three samples about `at`."""
    if not 0 < at < s.size - 1:
        return float(s[at])
    before, here, after = values[at - 1 : at + 2]
    bend = before - 2.0 * here + after
    shift = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return float(s[at] + shift * (s[1] - s[0]))


def _curvature(z: FloatArray, step: float) -> FloatArray:
    """Return the curvature (n,), 1/mm, of heights (n,) at a step, mm, after smoothing.

    The standard deviation of the Gaussian is `_STEPS_PER_SIGMA` samples.
    """
    slope = gaussian_filter1d(z, _STEPS_PER_SIGMA, order=1, mode="nearest") / step
    return np.asarray(_slope_change(z, step) / (1.0 + slope**2) ** 1.5)


def _slope_change(z: FloatArray, step: float) -> FloatArray:
    """Return the second derivative (n,), 1/mm, of heights (n,) at a step, mm, after smoothing.

    The standard deviation of the Gaussian is `_STEPS_PER_SIGMA` samples.
    """
    return np.asarray(gaussian_filter1d(z, _STEPS_PER_SIGMA, order=2, mode="nearest") / step**2)


def _crossing(s: FloatArray, z: FloatArray, at: int, level: float) -> float:
    """Return the position, mm, between samples `at` and `at + 1` where z crosses a level."""
    share = (level - z[at]) / (z[at + 1] - z[at])
    return float(s[at] + share * (s[at + 1] - s[at]))
