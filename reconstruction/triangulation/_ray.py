"""Meet every camera ray with the decoded projector coordinate, in double precision.

Symbols: d depth along the camera's z axis; (x, y, 1) ray in the camera frame; X = d a + b point in
the projector frame, with a = R ray and b = t of T_proj_from_cam; (u, v) projector pixel.

A whole image row takes each Gauss-Newton step together, so that the loops become vector code.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import Any, NamedTuple

import numpy as np

from reconstruction._jit import compiled, inlined
from reconstruction.decoding._half import pack_row, unpack_row
from reconstruction.mask import Reason
from reconstruction.triangulation._lens import (
    Lens,
    distort_inlined,
    distortion_jacobian_inlined,
    is_before_fold_inlined,
    ray_row,
)

EPIPOLAR_MISMATCH = np.uint8(Reason.EPIPOLAR_MISMATCH)
NO_POINT = np.uint8(Reason.NO_POINT)
VALID = np.uint8(Reason.VALID)
MAX_STEPS = 20
# Relative depth step that ends the iteration. The error left after it is smaller by the next
# contraction, below 1e-3: at most 2e-6 mm at 200 mm.
DEPTH_TOLERANCE = 1e-5
# A caller's zero sigma must not become an infinite weight.
SMALLEST_SIGMA_PX = np.float32(1e-9)
ZERO = np.float32(0.0)

# Rows of [R t]. Tuples, because arrays handed over per pixel cost more than the geometry.
Motion = tuple[tuple[float, ...], ...]


class Match(NamedTuple):
    """Which coordinates determine the depth, and how far the other may be off."""

    use_column: bool
    use_row: bool
    tolerance_px: float
    tolerance_sigmas: float


class Fringe(NamedTuple):
    """Decoded coordinates, (row, col) px, and their sigmas in half precision.

    sigma_unit_px : factor for `unpack_row`
    """

    column: Any
    row: Any
    sigma_column: Any
    sigma_row: Any
    sigma_unit_px: np.float32


class Rig(NamedTuple):
    """Both lenses and the motions between the frames, mm."""

    camera: Lens
    projector: Lens
    T_proj_from_cam: Motion
    T_world_from_cam: Motion


class Points(NamedTuple):
    """Result: (row, 3 col) x y z mm, (row, col) sigma of the depth in half precision and codes.

    sigma_factor : for `pack_row`
    """

    points_world_mm: Any
    sigma_depth: Any
    sigma_factor: np.float32
    reason: Any


class View(NamedTuple):
    """Lines of one row: what the projector sees of each point.

    How far the pixel misses the decoded one and its change per mm of depth, single precision; how
    far the lens moves it, double precision: that of the row before is a good start.
    """

    u_miss: Any
    v_miss: Any
    u_slope: Any
    v_slope: Any
    u_bend: Any
    v_bend: Any


@inlined
def _rotate(T: Motion, x: float, y: float) -> Any:
    return (
        T[0][0] * x + T[0][1] * y + T[0][2],
        T[1][0] * x + T[1][1] * y + T[1][2],
        T[2][0] * x + T[2][1] * y + T[2][2],
    )


@inlined
def _weights(su: Any, sv: Any, match: Match) -> Any:
    """Weights of both coordinates up to a common factor: alone, one needs no division."""
    if match.use_column and match.use_row:
        su, sv = max(su, SMALLEST_SIGMA_PX), max(sv, SMALLEST_SIGMA_PX)
        return sv * sv, su * su
    return (1.0, 0.0) if match.use_column else (0.0, 1.0)


@compiled
def _start_row(
    x: Any, y: Any, found: Any, u: Any, v: Any, su: Any, sv: Any, u_bend: Any, v_bend: Any,
    match: Match, rig: Rig, depth: Any, reason: Any,
) -> None:  # fmt: skip
    """Write the depth for a lens that bends as in the row before: weighted planes."""
    lens, T = rig.projector, rig.T_proj_from_cam
    bx, by, bz = T[0][3], T[1][3], T[2][3]
    for col in range(depth.size):
        wu, wv = _weights(su[col], sv[col], match)
        ax, ay, az = _rotate(T, x[col], y[col])
        uc, vc = u[col] - u_bend[col] - lens.cx, v[col] - v_bend[col] - lens.cy
        au, bu = lens.fx * ax - uc * az, uc * bz - lens.fx * bx
        av, bv = lens.fy * ay - vc * az, vc * bz - lens.fy * by
        depth[col] = (wu * au * bu + wv * av * bv) / (wu * au * au + wv * av * av)
        reason[col] = NO_POINT if (reason[col] == 0) & (not found[col]) else reason[col]


@compiled
def _step_row(
    x: Any, y: Any, u: Any, v: Any, su: Any, sv: Any, match: Match, rig: Rig, is_last: bool,
    depth: Any, view: View, reason: Any,
) -> Any:  # fmt: skip
    """Take one Gauss-Newton step on the weighted residuals; return how many are not there yet."""
    lens, T = rig.projector, rig.T_proj_from_cam
    bx, by, bz = T[0][3], T[1][3], T[2][3]
    u_miss, v_miss, u_slope, v_slope = view.u_miss, view.v_miss, view.u_slope, view.v_slope
    u_bend, v_bend = view.u_bend, view.v_bend
    pending = 0
    for col in range(depth.size):
        # Read before the first write, see `_add_six`.
        d, u_old, v_old = depth[col], u_bend[col], v_bend[col]
        ax, ay, az = _rotate(T, x[col], y[col])
        z = d * az + bz
        inverse = 1.0 / z
        px, py = (d * ax + bx) * inverse, (d * ay + by) * inverse
        px_slope, py_slope = (ax - px * az) * inverse, (ay - py * az) * inverse
        xd, yd = distort_inlined(px, py, lens.distortion)
        jacobian = distortion_jacobian_inlined(px, py, lens.distortion)
        xx, xy, yy = jacobian
        us = lens.fx * (xx * px_slope + xy * py_slope)
        vs = lens.fy * (xy * px_slope + yy * py_slope)
        du, dv = u[col] - lens.fx * xd - lens.cx, v[col] - lens.fy * yd - lens.cy
        wu, wv = _weights(su[col], sv[col], match)
        step = (wu * us * du + wv * vs * dv) / (wu * us * us + wv * vs * vs)
        is_ahead = (d > 0.0) & (z > 0.0)
        # A NaN counts as ahead of nothing and as not there.
        is_there = abs(step) <= DEPTH_TOLERANCE * d
        is_folded = is_there & (not is_before_fold_inlined(px, py, jacobian, lens.fold_square))
        is_lost = (not is_ahead) | (is_last & (not is_there)) | is_folded
        is_active = reason[col] == 0
        reason[col] = NO_POINT if is_active & is_lost else reason[col]
        pending += is_active & is_ahead & (not is_there)
        depth[col] = d + step
        u_miss[col], v_miss[col] = du - us * step, dv - vs * step
        u_slope[col], v_slope[col] = us, vs
        is_known = is_active & is_there
        u_bend[col] = lens.fx * (xd - px) if is_known else u_old
        v_bend[col] = lens.fy * (yd - py) if is_known else v_old
    return pending


@compiled
def _judge_row(su: Any, sv: Any, match: Match, view: View, sigma: Any, reason: Any) -> None:
    """Write the sigma of the depth, and mark coordinates that contradict the point."""
    u_miss, v_miss, u_slope, v_slope = view.u_miss, view.v_miss, view.u_slope, view.v_slope
    tolerance = np.float32(match.tolerance_px)
    square = np.float32(match.tolerance_sigmas * match.tolerance_sigmas)
    for col in range(sigma.size):
        u_sigma, v_sigma = max(su[col], SMALLEST_SIGMA_PX), max(sv[col], SMALLEST_SIGMA_PX)
        us, vs = u_slope[col], v_slope[col]
        if match.use_column and match.use_row:
            u_share, v_share = us * v_sigma, vs * u_sigma
            s = u_sigma * v_sigma / np.sqrt(u_share * u_share + v_share * v_share)
        else:
            s = u_sigma / abs(us) if match.use_column else v_sigma / abs(vs)
        # Squares, not roots: beyond the tolerance by so many sigmas of the difference.
        u_over, v_over = abs(u_miss[col]) - tolerance, abs(v_miss[col]) - tolerance
        u_along, v_along = us * s, vs * s
        u_limit = square * (u_sigma * u_sigma + u_along * u_along)
        v_limit = square * (v_sigma * v_sigma + v_along * v_along)
        is_off = (u_over > ZERO) & (u_over * u_over > u_limit)
        is_off |= (v_over > ZERO) & (v_over * v_over > v_limit)
        code = reason[col]
        code = EPIPOLAR_MISMATCH if (code == VALID) & is_off else code
        reason[col] = code
        sigma[col] = s if code == VALID else ZERO


@compiled
def _place_row(x: Any, y: Any, depth: Any, reason: Any, T: Motion, world: Any) -> None:
    """Write the points in the world frame, x y z of one pixel after the other."""
    for col in range(depth.size):
        ray_x, ray_y, ray_z = _rotate(T, x[col], y[col])
        is_point, d = reason[col] == 0, depth[col]
        world[3 * col] = d * ray_x + T[0][3] if is_point else 0.0
        world[3 * col + 1] = d * ray_y + T[1][3] if is_point else 0.0
        world[3 * col + 2] = d * ray_z + T[2][3] if is_point else 0.0


@compiled
def meet_rows(
    first_row: int, end_row: int, fringe: Fringe, match: Match, rig: Rig, points: Points
) -> None:  # fmt: skip
    """Fill `points` of some rows; `reason` masks and is updated."""
    width = points.reason.shape[1]
    lines, short = np.zeros((7, width)), np.zeros((8, width), np.float32)
    x, y, x_bend, y_bend, depth = lines[0], lines[1], lines[2], lines[3], lines[4]
    view = View(short[0], short[1], short[2], short[3], lines[5], lines[6])
    su, sv, sigma, spare = short[4], short[5], short[6], short[7]
    found = np.zeros(width, np.bool_)
    for row in range(first_row, end_row):
        u, v = fringe.column[row], fringe.row[row]
        reason = points.reason[row]
        unpack_row(fringe.sigma_column[row], fringe.sigma_unit_px, su)
        unpack_row(fringe.sigma_row[row], fringe.sigma_unit_px, sv)
        ray_row(row, rig.camera, x_bend, y_bend, x, y, found)
        _start_row(x, y, found, u, v, su, sv, view.u_bend, view.v_bend, match, rig, depth, reason)
        for step in range(MAX_STEPS):
            is_last = step == MAX_STEPS - 1
            if _step_row(x, y, u, v, su, sv, match, rig, is_last, depth, view, reason) == 0:
                break
        _judge_row(su, sv, match, view, sigma, reason)
        pack_row(sigma, points.sigma_factor, spare, points.sigma_depth[row])
        _place_row(x, y, depth, reason, rig.T_world_from_cam, points.points_world_mm[row])
