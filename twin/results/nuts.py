"""Figures of a hex nut in a relief: depth of its hole, and how hexagonal its outline is.

The outline is a contour of the relief below the ring, the flat face of the nut round its hole. It
is as far below as the chamfer descends at the corners, because there the nut itself is a whole
hexagon. A free span of the sheet has a round contour. The hexagon share is the sixth harmonic of
the contour, in phase with the nut, over that of a hexagon. It is 0 for a circle, 1 for a hexagon,
and 0.87 for the bare nut, because heights are averaged over 0.1 mm across its walls. Noise does
not change its mean.
"""

from math import pi, radians, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray
from twin.config.models import Experiment
from twin.config.nominal import NominalHexNut

_DIRECTIONS = 72
_RADIAL_MM = 0.1
_RING_MM, _CENTRE_MM = 0.2, 0.4
# A contour farther out than this multiple of the corner radius is not that of the nut.
_FARTHEST = 1.8
_LEAST_SEEN = 0.9
# Least depth of the contour below the ring, needed for a nut without a chamfer: the contour must
# be below the noise of the ring.
_LEAST_DOWN_MM = 0.2


def nut_figures(
    experiment: Experiment, points_mm: NDArray[np.floating[Any]], prefix: str = ""
) -> dict[str, float]:
    """Return the figures of a nut from points (n, xyz), world frame, mm; empty without a nut.

    `nut_hole_depth_mm` is the depth of the middle below the ring. `nut_hexagon_share` is the
    hexagon share of the contour; it is 0 if the relief is too flat to have the contour. A figure
    is missing if there are no points to compute it. `prefix` is put before each name.
    """
    pose, nuts = experiment.specimen, experiment.specimen.nominal(NominalHexNut)
    if not nuts:
        return {}
    nut, (x, y, z) = nuts[0], points_mm.astype(np.float64).T
    x, y = x - pose.x_mm, y - pose.y_mm
    radius, azimuth = np.hypot(x, y), np.arctan2(y, x) - radians(pose.yaw_deg)
    on_ring = np.abs(radius - nut.ring_radius_mm) < _RING_MM
    if not on_ring.any():
        return {}
    ring_mm = float(np.median(z[on_ring]))
    figures, middle = {}, z[radius < _CENTRE_MM]
    if middle.size:
        figures[f"{prefix}nut_hole_depth_mm"] = ring_mm - float(np.median(middle))
    level = ring_mm - max(nut.chamfer_fall_mm, _LEAST_DOWN_MM)
    between_mm = nut.ring_radius_mm, _FARTHEST * nut.across_flats_mm / sqrt(3)
    contour = contour_radii_mm(radius, azimuth, z, level, between_mm)
    figures[f"{prefix}nut_hexagon_share"] = hexagon_share(contour, nut.across_flats_mm)
    return figures


def contour_radii_mm(
    radius_mm: FloatArray,
    azimuth_rad: FloatArray,
    z_mm: FloatArray,
    level_mm: float,
    between_mm: tuple[float, float],
) -> FloatArray:
    """Return the radii (direction,), mm, at which a relief first drops below a level, or NaN.

    The points, given as three (n,) arrays, are averaged in sectors of azimuth and steps of radius.
    Steps without points are skipped.
    """
    from_mm, to_mm = between_mm
    sector = np.floor((azimuth_rad % (2 * pi)) / (2 * pi) * _DIRECTIONS).astype(int) % _DIRECTIONS
    step = np.floor((radius_mm - from_mm) / _RADIAL_MM).astype(int)
    steps = int(np.ceil((to_mm - from_mm) / _RADIAL_MM))
    inside = (step >= 0) & (step < steps)
    bins = sector[inside] * steps + step[inside]
    count, r, z = (
        np.bincount(bins, weight, _DIRECTIONS * steps).reshape(_DIRECTIONS, steps)
        for weight in (None, radius_mm[inside], z_mm[inside])
    )
    with np.errstate(invalid="ignore"):
        sections = zip(r / count, z / count, count > 0, strict=True)
    return np.array([_falls_below(r[has], z[has], level_mm) for r, z, has in sections])


def _falls_below(r_mm: FloatArray, z_mm: FloatArray, level_mm: float) -> float:
    below = np.flatnonzero(z_mm < level_mm)
    if not below.size or not below[0]:
        return float("nan")
    i = int(below[0])
    part = (z_mm[i - 1] - level_mm) / (z_mm[i - 1] - z_mm[i])
    return float(r_mm[i - 1] + part * (r_mm[i] - r_mm[i - 1]))


def hexagon_share(contour_mm: FloatArray, across_flats_mm: float) -> float:
    """Return the hexagon share of a contour, given by its radii (direction,), mm.

    The nut has a corner at azimuth 0. The share is 0 if more than 10 % of the contour is missing.
    """
    azimuth = (np.arange(contour_mm.size) + 0.5) / contour_mm.size * 2 * pi
    known = np.isfinite(contour_mm)
    if known.mean() < _LEAST_SEEN:
        return 0.0
    filled = np.interp(azimuth, azimuth[known], contour_mm[known], period=2 * pi)
    from_flat = (azimuth % (pi / 3)) - pi / 6
    hexagon = across_flats_mm / 2 / np.cos(from_flat)
    wave = np.cos(6 * azimuth)
    return float(filled @ wave / (hexagon @ wave))
