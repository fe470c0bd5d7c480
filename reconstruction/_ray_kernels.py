"""Meet every camera ray with the decoded projector coordinate, in double precision.

Symbols: d depth along the camera's z axis; (x, y, 1) ray in the camera frame; X = d a + b point in
the projector frame, with a = R ray and b = t of T_proj_from_cam; (u, v) projector pixel.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import Any, NamedTuple

import numpy as np

from reconstruction._jit import compiled, inlined
from reconstruction._lens_kernels import (
    Lens,
    Rays,
    distort_inlined,
    distortion_jacobian_inlined,
)
from reconstruction.mask import Reason

EPIPOLAR_MISMATCH = int(Reason.EPIPOLAR_MISMATCH)
NO_POINT = int(Reason.NO_POINT)
MAX_STEPS = 20
# Relative depth step that ends the iteration. The error left after it is smaller by the next
# contraction, below 1e-3: at most 2e-7 mm at 200 mm.
DEPTH_TOLERANCE = 1e-6
# A caller's zero sigma must not become an infinite weight.
SMALLEST_SIGMA_PX = 1e-9

# Rows of [R t]. Tuples, because arrays handed over per pixel cost more than the geometry.
Motion = tuple[tuple[float, ...], ...]


class Match(NamedTuple):
    """Which coordinates determine the depth, and how far the other may be off."""

    use_column: bool
    use_row: bool
    tolerance_px: float
    tolerance_sigmas: float


class Fringe(NamedTuple):
    """Decoded coordinates and sigmas, (row, col), px."""

    column: Any
    row: Any
    sigma_column: Any
    sigma_row: Any


class Points(NamedTuple):
    """Result: (row, col, xyz) mm, (row, col, xyz) mm, (row, col) codes."""

    points_world_mm: Any
    sigma_xyz_mm: Any
    reason: Any


class View(NamedTuple):
    """One point as the projector sees it: pixel, its change with depth, pixel without the lens."""

    u: float
    v: float
    u_slope: float
    v_slope: float
    u_ideal: float
    v_ideal: float
    z: float


@inlined
def _linear_depth(a: Any, b: Any, u: float, v: float, wu: float, wv: float, lens: Lens) -> Any:
    """Return the depth for a lens without distortion: weighted planes through the projector."""
    uc, vc = u - lens.cx, v - lens.cy
    au, bu = lens.fx * a[0] - uc * a[2], uc * b[2] - lens.fx * b[0]
    av, bv = lens.fy * a[1] - vc * a[2], vc * b[2] - lens.fy * b[1]
    return (wu * au * bu + wv * av * bv) / (wu * au * au + wv * av * av)


@inlined
def _view(d: float, a: Any, b: Any, lens: Lens) -> Any:
    z = d * a[2] + b[2]
    inverse = 1.0 / z
    x, y = (d * a[0] + b[0]) * inverse, (d * a[1] + b[1]) * inverse
    x_slope, y_slope = (a[0] - x * a[2]) * inverse, (a[1] - y * a[2]) * inverse
    u, v = lens.fx * x + lens.cx, lens.fy * y + lens.cy
    if lens.is_ideal:
        return View(u, v, lens.fx * x_slope, lens.fy * y_slope, u, v, z)
    xd, yd = distort_inlined(x, y, lens.distortion)
    xx, xy, yy = distortion_jacobian_inlined(x, y, lens.distortion)
    u_slope = lens.fx * (xx * x_slope + xy * y_slope)
    v_slope = lens.fy * (xy * x_slope + yy * y_slope)
    return View(lens.fx * xd + lens.cx, lens.fy * yd + lens.cy, u_slope, v_slope, u, v, z)


@inlined
def _solve_depth(
    d: float, a: Any, b: Any, u: float, v: float, wu: float, wv: float, lens: Lens
) -> Any:
    """Return (depth, view, found) by Gauss-Newton on the weighted residuals, from start d."""
    view = _view(d, a, b, lens)
    for _ in range(MAX_STEPS):
        if not (d > 0.0 and view.z > 0.0):
            return d, view, False
        gradient = wu * view.u_slope * (u - view.u) + wv * view.v_slope * (v - view.v)
        step = gradient / (wu * view.u_slope * view.u_slope + wv * view.v_slope * view.v_slope)
        d += step
        if abs(step) <= DEPTH_TOLERANCE * d:
            return d, view, True
        view = _view(d, a, b, lens)
    return d, view, False


@inlined
def _is_mismatch(
    view: Any, u: float, v: float, su: float, sv: float, sigma_d: float, match: Match
) -> Any:
    """Tell whether a decoded coordinate contradicts the point that was found."""
    u_miss, v_miss = abs(u - view.u), abs(v - view.v)
    if u_miss <= match.tolerance_px and v_miss <= match.tolerance_px:
        return False
    u_sigma = np.sqrt(su * su + (view.u_slope * sigma_d) ** 2)
    v_sigma = np.sqrt(sv * sv + (view.v_slope * sigma_d) ** 2)
    u_limit = match.tolerance_px + match.tolerance_sigmas * u_sigma
    v_limit = match.tolerance_px + match.tolerance_sigmas * v_sigma
    return u_miss > u_limit or v_miss > v_limit


@inlined
def _weights(su: float, sv: float, match: Match) -> Any:
    """Weights of both coordinates up to a common factor: alone, one needs no division."""
    if match.use_column and match.use_row:
        return sv * sv, su * su
    return (1.0, 0.0) if match.use_column else (0.0, 1.0)


@inlined
def _depth_sigma(view: Any, su: float, sv: float, wu: float, wv: float, match: Match) -> Any:
    if match.use_column and match.use_row:
        both = wu * view.u_slope * view.u_slope + wv * view.v_slope * view.v_slope
        return su * sv / np.sqrt(both)
    return su / abs(view.u_slope) if match.use_column else sv / abs(view.v_slope)


@inlined
def _rotate(T: Motion, x: float, y: float) -> Any:
    return (
        T[0][0] * x + T[0][1] * y + T[0][2],
        T[1][0] * x + T[1][1] * y + T[1][2],
        T[2][0] * x + T[2][1] * y + T[2][2],
    )


@inlined
def _meet(
    x: float, y: float, u: float, v: float, su: float, sv: float, bend: tuple[float, float],
    match: Match, projector: Lens, T_proj_from_cam: Motion,
) -> Any:  # fmt: skip
    """Return (depth, its sigma, reason code, bend) of the camera ray (x, y, 1).

    bend is how far the lens moves the projector pixel; that of the row before is a good start.
    """
    su, sv = max(su, SMALLEST_SIGMA_PX), max(sv, SMALLEST_SIGMA_PX)
    wu, wv = _weights(su, sv, match)
    a = _rotate(T_proj_from_cam, x, y)
    b = (T_proj_from_cam[0][3], T_proj_from_cam[1][3], T_proj_from_cam[2][3])
    start = _linear_depth(a, b, u - bend[0], v - bend[1], wu, wv, projector)
    d, view, found = _solve_depth(start, a, b, u, v, wu, wv, projector)
    if not found:
        return 0.0, 0.0, NO_POINT, (0.0, 0.0)
    sigma_d = _depth_sigma(view, su, sv, wu, wv, match)
    if _is_mismatch(view, u, v, su, sv, sigma_d, match):
        return 0.0, 0.0, EPIPOLAR_MISMATCH, (0.0, 0.0)
    return d, sigma_d, 0, (view.u - view.u_ideal, view.v - view.v_ideal)


@compiled
def meet_rows(
    first_row: int,
    end_row: int,
    fringe: Fringe,
    match: Match,
    rays: Rays,
    projector: Lens,
    T_proj_from_cam: Motion,
    T_world_from_cam: Motion,
    points: Points,
) -> None:
    """Fill `points`, zeroed by the caller except for `reason`, which masks and is updated."""
    width = points.reason.shape[1]
    u_bend, v_bend = np.zeros(width), np.zeros(width)
    T = T_world_from_cam
    for row in range(first_row, end_row):
        u, v = fringe.column[row], fringe.row[row]
        su, sv = fringe.sigma_column[row], fringe.sigma_row[row]
        reason, sigma = points.reason[row], points.sigma_xyz_mm[row]
        world = points.points_world_mm[row]
        x, y, found = rays.x[row], rays.y[row], rays.found[row]
        for col in range(width):
            if reason[col] != 0:
                continue
            d, sigma_d, code, bend = _meet(
                x[col], y[col], u[col], v[col], su[col], sv[col], (u_bend[col], v_bend[col]),
                match, projector, T_proj_from_cam,
            )  # fmt: skip
            u_bend[col], v_bend[col] = bend
            reason[col] = code if found[col] else NO_POINT
            if reason[col] == 0:
                ray = _rotate(T, x[col], y[col])
                world[col, 0] = d * ray[0] + T[0][3]
                world[col, 1] = d * ray[1] + T[1][3]
                world[col, 2] = d * ray[2] + T[2][3]
                sigma[col, 0] = abs(ray[0]) * sigma_d
                sigma[col, 1] = abs(ray[1]) * sigma_d
                sigma[col, 2] = abs(ray[2]) * sigma_d
