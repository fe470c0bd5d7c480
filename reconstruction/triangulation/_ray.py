"""Intersect the camera rays of one image row with the decoded projector coordinate, in air.

The geometry is in double precision. The iterations of the inverse lens distortion and of
Gauss-Newton run over a whole image row each, so that the compiler makes vector code of the loops.

Symbols: d is the depth along the camera's z axis, (x, y, 1) the ray in the camera frame, (u, v) the
projector pixel. X = d a + b is the point in the projector frame, with a = R (x, y, 1) and b = t
from T_proj_from_cam = [R t].
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import Any, NamedTuple

import numpy as np

from reconstruction.arrays import Reason
from reconstruction.compiling import compiled, inlined, nested
from reconstruction.decoding._rows import pack_row, unpack_row
from reconstruction.rig.pinhole import (
    INVERSE_STEPS,
    NO_DISTORTION,
    Pinhole,
    distort,
    distortion_jacobian,
    fold_square,
    is_before_fold,
    newton_step,
)

# Newton's method squares the error in each step: after a step below 1e-7 it is far below 1e-12.
RAY_TOLERANCE = 1e-7

distort_inlined = inlined(distort)
distortion_jacobian_inlined = inlined(distortion_jacobian)
newton_step_inlined = inlined(newton_step)
is_before_fold_inlined = inlined(is_before_fold)
EPIPOLAR_MISMATCH = np.uint8(Reason.EPIPOLAR_MISMATCH)
NO_POINT = np.uint8(Reason.NO_POINT)
VALID = np.uint8(Reason.VALID)
MAX_STEPS = 20
# Step, relative to the depth, that ends the iteration. The remaining error is less than 1e-3 of
# this step: at most 2e-6 mm at 200 mm.
DEPTH_TOLERANCE = 1e-5
# Prevents an infinite weight for a sigma of zero.
SMALLEST_SIGMA_PX = np.float32(1e-9)
ZERO = np.float32(0.0)

# Rows of [R t]. They are tuples, because passing arrays to a function for each pixel takes more
# time than the geometry.
Motion = tuple[tuple[float, ...], ...]


class Lens(NamedTuple):
    """Intrinsics of one device: focal lengths and centre in px, OpenCV's k1, k2, p1, p2, k3.

    is_ideal : whether there is no distortion
    fold_square : squared normalised radius of the fold, see `reconstruction.rig.pinhole`
    """

    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float]
    is_ideal: bool
    fold_square: float


class Lines(NamedTuple):
    """Work arrays for a band of rows, because the compiled code does not allocate arrays."""

    long: Any  # (line, col) float64
    short: Any  # (line, col) float32
    mask: Any  # (col,) bool


class Rays(NamedTuple):
    """Rays of the pixels (col) of one row: (x, y, 1) in the camera frame, if `is_valid`.

    x_bend, y_bend : displacement of x and y by the inverse lens distortion. The values of the row
        above are the start values, because neighbouring rows are similar: one iteration suffices
        in all but the first row
    """

    x: Any
    y: Any
    x_bend: Any
    y_bend: Any
    is_valid: Any


def lens_of(device: Pinhole) -> Lens:
    """Return the intrinsics of a device in the form that the kernels use."""
    k1, k2, p1, p2, k3 = (float(value) for value in device.distortion)
    return Lens(
        float(device.fx_px),
        float(device.fy_px),
        float(device.cx_px),
        float(device.cy_px),
        (k1, k2, p1, p2, k3),
        tuple(device.distortion) == NO_DISTORTION,
        fold_square(device.distortion),
    )


@nested
def _newton_row(row: int, camera: Lens, rays: Rays) -> Any:
    """Improve the rays of a row by one Newton step; return the number of rays not converged."""
    x, y, x_bend, y_bend, is_valid = rays
    x_scale, y_target = 1.0 / camera.fx, (row - camera.cy) / camera.fy
    pending = 0
    for col in range(x.size):
        x_target = (col - camera.cx) * x_scale
        x_old, y_old = x_target + x_bend[col], y_target + y_bend[col]
        x_now, y_now = distort_inlined(x_old, y_old, camera.distortion)
        jacobian = distortion_jacobian_inlined(x_old, y_old, camera.distortion)
        dx, dy = newton_step_inlined(x_target - x_now, y_target - y_now, jacobian)
        x[col], y[col] = x_old + dx, y_old + dy
        x_bend[col], y_bend[col] = x_bend[col] + dx, y_bend[col] + dy
        is_close = abs(dx) + abs(dy) < RAY_TOLERANCE
        is_before = is_before_fold_inlined(x_old, y_old, jacobian, camera.fold_square)
        is_valid[col] = is_close & is_before
        pending += not is_close
    return pending


@nested
def _ideal_row(row: int, camera: Lens, rays: Rays) -> None:
    x, y, is_valid = rays.x, rays.y, rays.is_valid
    x_scale, y_target = 1.0 / camera.fx, (row - camera.cy) / camera.fy
    for col in range(x.size):
        x[col], y[col], is_valid[col] = (col - camera.cx) * x_scale, y_target, True


@nested
def _reset_invalid(is_valid: Any, x_bend: Any, y_bend: Any) -> None:
    for col in range(is_valid.size):
        x_bend[col] = x_bend[col] if is_valid[col] else 0.0
        y_bend[col] = y_bend[col] if is_valid[col] else 0.0


@compiled
def ray_row(row: int, camera: Lens, rays: Rays) -> None:
    """Compute the rays of an image row; at entry `rays` has the bends of the row above, or 0."""
    if camera.is_ideal:
        _ideal_row(row, camera, rays)
        return
    for _ in range(INVERSE_STEPS):
        if _newton_row(row, camera, rays) == 0:
            break
    _reset_invalid(rays.is_valid, rays.x_bend, rays.y_bend)


class Match(NamedTuple):
    """Coordinates that determine the depth, and the tolerance of the decoded coordinates.

    A decoded coordinate may differ from that of the projected point by `tolerance_px` plus
    `tolerance_sigmas` standard deviations of the difference.
    """

    use_column: bool
    use_row: bool
    tolerance_px: float
    tolerance_sigmas: float


class Fringe(NamedTuple):
    """Decoded projector coordinates, (row, col) px, and their sigmas in half precision.

    sigma_unit_px : factor with which `unpack_row` converts a sigma to px
    """

    column: Any
    row: Any
    sigma_column: Any
    sigma_row: Any
    sigma_unit_px: np.float32


class LensPair(NamedTuple):
    """Both lenses and the transforms between the frames, translations in mm."""

    camera: Lens
    projector: Lens
    T_proj_from_cam: Motion
    T_world_from_cam: Motion


class PointRows(NamedTuple):
    """Result: points (row, 3 col) as x y z, mm; (row, col) sigma of the depth; reason codes.

    sigma_depth : in half precision
    sigma_factor : factor with which `pack_row` converts a sigma in mm to half precision
    """

    points_world_mm: Any
    sigma_depth: Any
    sigma_factor: np.float32
    reason: Any


class Pixels(NamedTuple):
    """Decoded projector coordinates of one camera row and their sigmas, each (col,) px."""

    u: Any
    v: Any
    u_sigma: Any
    v_sigma: Any


class ProjectorView(NamedTuple):
    """Projection of the points of one camera row into the projector, each field (col,).

    u_residual, v_residual : decoded minus projected pixel, px, float32
    u_slope, v_slope : change of the projected pixel per mm of depth, float32
    u_bend, v_bend : displacement of the projected pixel by the lens distortion, px, float64. The
        values of the row above are the start values
    """

    u_residual: Any
    v_residual: Any
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
def weights(su: Any, sv: Any, match: Match) -> Any:
    """Return the weights of column and row, 1 / sigma^2 up to a common factor; 0 if not used."""
    if match.use_column and match.use_row:
        su, sv = max(su, SMALLEST_SIGMA_PX), max(sv, SMALLEST_SIGMA_PX)
        return sv * sv, su * su
    return (1.0, 0.0) if match.use_column else (0.0, 1.0)


@nested
def _start_row(
    rays: Rays,
    pixels: Pixels,
    match: Match,
    rig: LensPair,
    depth: Any,
    view: ProjectorView,
    reason: Any,
) -> None:
    """Write the start value of the depth: linear solution with the lens displacement as given.

    The lens displacements in `view` are those of the row above.
    """
    x, y, is_valid, u_bend, v_bend = rays.x, rays.y, rays.is_valid, view.u_bend, view.v_bend
    u, v, su, sv = pixels
    lens, T = rig.projector, rig.T_proj_from_cam
    bx, by, bz = T[0][3], T[1][3], T[2][3]
    for col in range(depth.size):
        wu, wv = weights(su[col], sv[col], match)
        ax, ay, az = _rotate(T, x[col], y[col])
        uc, vc = u[col] - u_bend[col] - lens.cx, v[col] - v_bend[col] - lens.cy
        au, bu = lens.fx * ax - uc * az, uc * bz - lens.fx * bx
        av, bv = lens.fy * ay - vc * az, vc * bz - lens.fy * by
        depth[col] = (wu * au * bu + wv * av * bv) / (wu * au * au + wv * av * av)
        reason[col] = NO_POINT if (reason[col] == 0) & (not is_valid[col]) else reason[col]


@nested
def _step_row(
    rays: Rays, pixels: Pixels, match: Match, rig: LensPair, is_last: bool, depth: Any,
    view: ProjectorView, reason: Any,
) -> Any:  # fmt: skip
    """Take one Gauss-Newton step in the depth; return the number of pixels not converged."""
    x, y = rays.x, rays.y
    u, v, su, sv = pixels
    lens, T = rig.projector, rig.T_proj_from_cam
    bx, by, bz = T[0][3], T[1][3], T[2][3]
    u_residual, v_residual, u_slope, v_slope, u_bend, v_bend = view
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
        wu, wv = weights(su[col], sv[col], match)
        step = (wu * us * du + wv * vs * dv) / (wu * us * us + wv * vs * vs)
        is_ahead = (d > 0.0) & (z > 0.0)
        # A NaN counts as behind the device and as not converged.
        is_there = abs(step) <= DEPTH_TOLERANCE * d
        is_folded = is_there & (not is_before_fold_inlined(px, py, jacobian, lens.fold_square))
        is_lost = (not is_ahead) | (is_last & (not is_there)) | is_folded
        is_active = reason[col] == 0
        reason[col] = NO_POINT if is_active & is_lost else reason[col]
        pending += is_active & is_ahead & (not is_there)
        depth[col] = d + step
        u_residual[col], v_residual[col] = du - us * step, dv - vs * step
        u_slope[col], v_slope[col] = us, vs
        is_known = is_active & is_there
        u_bend[col] = lens.fx * (xd - px) if is_known else u_old
        v_bend[col] = lens.fy * (yd - py) if is_known else v_old
    return pending


@nested
def judge_row(pixels: Pixels, match: Match, view: ProjectorView, sigma: Any, reason: Any) -> None:
    """Write the sigma of the depth; set the code EPIPOLAR_MISMATCH beyond the tolerance."""
    su, sv = pixels.u_sigma, pixels.v_sigma
    u_residual, v_residual, u_slope, v_slope, _, _ = view
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
        # The excess over the tolerance is compared with a number of sigmas of the difference. The
        # squares of both are compared, which needs no roots.
        u_over, v_over = abs(u_residual[col]) - tolerance, abs(v_residual[col]) - tolerance
        u_along, v_along = us * s, vs * s
        u_limit = square * (u_sigma * u_sigma + u_along * u_along)
        v_limit = square * (v_sigma * v_sigma + v_along * v_along)
        is_off = (u_over > ZERO) & (u_over * u_over > u_limit)
        is_off |= (v_over > ZERO) & (v_over * v_over > v_limit)
        code = reason[col]
        code = EPIPOLAR_MISMATCH if (code == VALID) & is_off else code
        reason[col] = code
        sigma[col] = s if code == VALID else ZERO


@nested
def _place_row(rays: Rays, depth: Any, reason: Any, T: Motion, world: Any) -> None:
    """Write the points in the world frame, mm, to a line (3 col): x y z per pixel; 0 if masked."""
    x, y = rays.x, rays.y
    for col in range(depth.size):
        ray_x, ray_y, ray_z = _rotate(T, x[col], y[col])
        is_point, d = reason[col] == 0, depth[col]
        world[3 * col] = d * ray_x + T[0][3] if is_point else 0.0
        world[3 * col + 1] = d * ray_y + T[1][3] if is_point else 0.0
        world[3 * col + 2] = d * ray_z + T[2][3] if is_point else 0.0


def meet_rows(
    first_row: int, end_row: int, fringe: Fringe, match: Match, rig: LensPair, points: PointRows
) -> None:  # fmt: skip
    """Triangulate the rows from `first_row` to before `end_row` and write them to `points`.

    Only pixels with `points.reason` 0 are triangulated; those that fail get their reason code.
    """
    width = points.reason.shape[1]
    work = Lines(np.zeros((7, width)), np.zeros((8, width), np.float32), np.zeros(width, np.bool_))
    _meet_band(first_row, end_row, fringe, match, rig, work, points)


@compiled
def _meet_band(
    first_row: int, end_row: int, fringe: Fringe, match: Match, rig: LensPair, work: Lines,
    points: PointRows,
) -> None:  # fmt: skip
    lines, short = work.long, work.short
    rays = Rays(lines[0], lines[1], lines[2], lines[3], work.mask)
    depth = lines[4]
    view = ProjectorView(short[0], short[1], short[2], short[3], lines[5], lines[6])
    su, sv, sigma, spare = short[4], short[5], short[6], short[7]
    for row in range(first_row, end_row):
        pixels = Pixels(fringe.column[row], fringe.row[row], su, sv)
        reason = points.reason[row]
        unpack_row(fringe.sigma_column[row], fringe.sigma_unit_px, su)
        unpack_row(fringe.sigma_row[row], fringe.sigma_unit_px, sv)
        ray_row(row, rig.camera, rays)
        _start_row(rays, pixels, match, rig, depth, view, reason)
        for step in range(MAX_STEPS):
            is_last = step == MAX_STEPS - 1
            if _step_row(rays, pixels, match, rig, is_last, depth, view, reason) == 0:
                break
        judge_row(pixels, match, view, sigma, reason)
        pack_row(sigma, points.sigma_factor, spare, points.sigma_depth[row])
        _place_row(rays, depth, reason, rig.T_world_from_cam, points.points_world_mm[row])
