"""Flatness (ISO 12781-1) and areal roughness (ISO 25178-2): what a reference plane leaves."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.errors import FitError
from reconstruction.evaluate.fit import PlaneFit, fit_plane, inliers

_MOST_TURNS = 20
# Gaussian of ISO 16610-61: exp(-pi (x / (a L))^2) / (a L)^2 with a = sqrt(ln 2 / pi).
_SIGMA_OVER_NESTING = np.sqrt(np.log(2.0) / np.pi) / np.sqrt(2.0 * np.pi)
_LEAST_SUPPORT = 0.5


@dataclass(frozen=True, eq=False)
class Flatness:
    """Deviations of points from their plane.

    Attributes
    ----------
    peak_to_valley_mm, rms_mm : float
        ISO 12781-1's peak-to-valley and RMS flatness deviation, over the points kept.
    kept : (n,) bool
        Points that are no outliers.
    plane : PlaneFit
        Through the points kept.
    """

    peak_to_valley_mm: float
    rms_mm: float
    kept: BoolImage
    plane: PlaneFit


def flatness(points_mm: ArrayLike) -> Flatness:
    """Fit the reference plane (least squares, repeated without outliers) and rate the deviations.

    Parameters
    ----------
    points_mm : (n, 3) float

    Raises
    ------
    FitError : too few points, or they lie on a line
    """
    points = np.asarray(points_mm, np.float64)
    plane = fit_plane(points)
    kept = np.ones(len(points), bool)
    for _ in range(_MOST_TURNS):
        now = inliers(distances_mm(points, plane))
        if np.array_equal(now, kept):
            break
        kept = now
        plane = fit_plane(points[kept])
    residuals = plane.residuals_mm
    return Flatness(float(np.ptp(residuals)), float(np.sqrt(np.mean(residuals**2))), kept, plane)


def distances_mm(points_mm: FloatArray, plane: PlaneFit) -> FloatArray:
    """Signed distances of points (n, 3) from a plane."""
    distances: FloatArray = (points_mm - plane.centroid_mm) @ plane.normal
    return distances


@dataclass(frozen=True)
class ArealRoughness:
    """Height parameters of the S-L surface; Sz is the height between highest and lowest point."""

    sa_mm: float
    sq_mm: float
    sz_mm: float


def areal_roughness(
    z_mm: ArrayLike, valid: ArrayLike, pitch_mm: float, nesting_mm: float
) -> ArealRoughness:
    """Remove the plane, then the waviness (Gaussian L-filter of ISO 16610-61), and rate the rest.

    Parameters
    ----------
    z_mm : (row, col) float
        Heights on a square grid.
    valid : (row, col) bool
        Where there is a height.
    pitch_mm : float
        Distance of the grid's nodes.
    nesting_mm : float
        Nesting index of the L-filter: half of a wave this long passes into the roughness.

    Raises
    ------
    FitError : too few heights, or a nesting index below two pitches
    """
    z, kept = np.asarray(z_mm, np.float64), np.asarray(valid, bool)
    if nesting_mm < 2.0 * pitch_mm:
        raise FitError(f"nesting_mm: found {nesting_mm:g}, allowed at least {2 * pitch_mm:g}")
    y, x = np.mgrid[: z.shape[0], : z.shape[1]] * pitch_mm
    plane = flatness(np.column_stack([x[kept], y[kept], z[kept]])).plane
    tilt = (
        plane.centroid_mm[2]
        - (
            (x - plane.centroid_mm[0]) * plane.normal[0]
            + (y - plane.centroid_mm[1]) * plane.normal[1]
        )
        / plane.normal[2]
    )
    level = np.where(kept, z - tilt, 0.0)
    rough = _without_waviness(level, kept, _SIGMA_OVER_NESTING * nesting_mm / pitch_mm)
    return ArealRoughness(
        float(np.mean(np.abs(rough))), float(np.sqrt(np.mean(rough**2))), float(np.ptp(rough))
    )


def _without_waviness(level: FloatArray, kept: FloatArray, sigma_px: float) -> FloatArray:
    """Heights less their Gaussian mean, where half of the filter's weight lies on heights."""
    weight = gaussian_filter(kept.astype(np.float64), sigma_px, mode="constant")
    wave = gaussian_filter(level, sigma_px, mode="constant") / np.maximum(weight, 1e-12)
    rated = kept & (weight >= _LEAST_SUPPORT)
    rough: FloatArray = (level - wave)[rated]
    if not rough.size:
        raise FitError("roughness: no height has enough neighbours; take a smaller nesting_mm")
    return np.asarray(rough - rough.mean())
