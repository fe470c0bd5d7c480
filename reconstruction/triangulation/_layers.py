"""Intersect camera rays below plane clear layers with the decoded projector coordinate.

Frame: world, z up. Medium 0 is air, above medium 1; the surface is in the last medium m. Medium i
has the refractive index n_i. The path of a ray in it has the vertical component w_i. In AIR the
angle between ray and vertical has the tangent t. By Snell's law the horizontal component of the
whole path is

    r(t) = sum_i w_i t / q_i,   q_i = sqrt(n_i^2 + (n_i^2 - 1) t^2),
    dr/dt = sum_i w_i n_i^2 / q_i^3,

and the tangent of the angle in the last medium is t / q_m.

A camera ray with known t enters the last medium at a known point A. Its direction there is
G = (h / q_m, -1), with the horizontal vector h of its path in air per mm of height. The unknown of
the point X = A + s G is s, the depth below the last interface.

The t of the ray from the projector, at P, to X solves r(t) = |X - P|, the horizontal distance. The
function r is concave and increasing, so Newton's method from the left of the root never overshoots.
The derivative of the projector pixel by s follows from the implicit function theorem.

Light reflected between the interfaces is neglected.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import Any, NamedTuple

import numpy as np

from reconstruction.compiling import compiled, inlined, nested
from reconstruction.decoding._rows import unpack_row
from reconstruction.triangulation._ray import (
    MAX_STEPS,
    NO_POINT,
    Fringe,
    Lens,
    Lines,
    Match,
    Motion,
    Pixels,
    ProjectorView,
    Rays,
    distort_inlined,
    distortion_jacobian_inlined,
    is_before_fold_inlined,
    judge_row,
    ray_row,
    weights,
)

# Most Newton iterations for t. From the straight line, a gel behind a window needs two of them,
# thick layers of index 3 need five.
MAX_TURNS = 20
TANGENT_TOLERANCE = 1e-12
# A step below this value ends the iteration. The remaining error is less than 1e-3 of the step.
STEP_TOLERANCE_MM = 1e-5
# Least cosine of the angle to the vertical in air (89.9 degrees) of a camera ray with a point.
FLATTEST = 1e-3


class LayeredRig(NamedTuple):
    """Lenses, transforms between the frames, mm, and clear media from the top down.

    projector_mm : position of the projector in the world frame
    tops_mm, iors : (medium,) float64, world z of the upper interface and refractive index
    """

    camera: Lens
    projector: Lens
    T_world_from_cam: Motion
    T_proj_from_world: Motion
    projector_mm: tuple[float, float, float]
    tops_mm: Any
    iors: Any


class SpreadRows(NamedTuple):
    """Result: points and their sigmas, each (row, 3 col) as x y z, mm; (row, col) reason codes."""

    points_world_mm: Any
    sigma_xyz_mm: Any
    reason: Any


class LayerEntry(NamedTuple):
    """For each pixel (col) of one row, where and how its camera ray enters the last medium.

    x, y : world coordinates of the entry point, mm
    x_slope, y_slope : direction (x_slope, y_slope, -1) of the ray in the last medium
    depth : depth of the triangulated point below the last interface, mm
    """

    x: Any
    y: Any
    x_slope: Any
    y_slope: Any
    depth: Any


@inlined
def _reach(t_square: float, air_mm: float, last_mm: float, rig: LayeredRig) -> Any:
    """Return r / t, dr / dt and q_m at t^2 = `t_square`.

    air_mm, last_mm : vertical path in the air and in the last medium, w_0 and w_m
    """
    tops, iors = rig.tops_mm, rig.iors
    reach, slope, q = air_mm, air_mm, 1.0
    for i in range(tops.size):
        thickness_mm = tops[i] - tops[i + 1] if i + 1 < tops.size else last_mm
        square = iors[i] * iors[i]
        q = np.sqrt(square + (square - 1.0) * t_square)
        reach += thickness_mm / q
        slope += thickness_mm * square / (q * q * q)
    return reach, slope, q


@nested
def _enter_row(rays: Rays, rig: LayeredRig, entry: LayerEntry, reason: Any) -> None:
    T = rig.T_world_from_cam
    air_mm = T[2][3] - rig.tops_mm[0]
    for col in range(reason.size):
        x, y = rays.x[col], rays.y[col]
        down = -(T[2][0] * x + T[2][1] * y + T[2][2])
        is_ray = rays.is_valid[col] and down > FLATTEST * np.sqrt(x * x + y * y + 1.0)
        if reason[col] == 0 and not is_ray:
            reason[col] = NO_POINT
        down = down if is_ray else 1.0
        along_x = (T[0][0] * x + T[0][1] * y + T[0][2]) / down
        along_y = (T[1][0] * x + T[1][1] * y + T[1][2]) / down
        reach, _, q = _reach(along_x * along_x + along_y * along_y, air_mm, 0.0, rig)
        entry.x[col], entry.y[col] = T[0][3] + reach * along_x, T[1][3] + reach * along_y
        entry.x_slope[col], entry.y_slope[col] = along_x / q, along_y / q


@inlined
def _towards(x: float, y: float, depth: float, tangent: float, rig: LayeredRig) -> Any:
    """Return the tangent t in air of the projector's ray to a point, and r / t, dr / dt and q_m.

    x, y : horizontal position of the point relative to the projector, mm
    depth : depth of the point below the last interface, mm
    tangent : start value of t, at most the solution
    """
    distance = np.sqrt(x * x + y * y)
    air_mm = rig.projector_mm[2] - rig.tops_mm[0]
    reach, slope, q = _reach(tangent * tangent, air_mm, depth, rig)
    for _ in range(MAX_TURNS):
        step = (distance - reach * tangent) / slope
        tangent += step
        reach, slope, q = _reach(tangent * tangent, air_mm, depth, rig)
        if abs(step) <= TANGENT_TOLERANCE * (1.0 + tangent):
            break
    return tangent, reach, slope, q


@inlined
def _projector_ray(
    x: float, y: float, x_slope: float, y_slope: float, depth: float, rig: LayeredRig
) -> Any:
    """Return the projector's ray to a point, (x, y, z) in its frame, and its derivative by depth.

    x, y : horizontal position of the point relative to the projector, mm
    x_slope, y_slope : derivative of x and y by the depth
    depth : depth of the point below the last interface, mm
    """
    air_mm = rig.projector_mm[2] - rig.tops_mm[0]
    height = air_mm + rig.tops_mm[0] - rig.tops_mm[-1] + depth
    distance = np.sqrt(x * x + y * y)
    tangent, reach, slope, q = _towards(x, y, depth, distance / height, rig)
    scale = 1.0 / distance if distance > 0.0 else 0.0
    ex, ey = x * scale, y * scale
    outwards = ex * x_slope + ey * y_slope
    tangent_slope = (outwards - tangent / q) / slope
    hx, hy = x / reach, y / reach
    hx_slope = tangent_slope * ex + (x_slope - ex * outwards) / reach
    hy_slope = tangent_slope * ey + (y_slope - ey * outwards) / reach
    R = rig.T_proj_from_world
    ray = (
        R[0][0] * hx + R[0][1] * hy - R[0][2],
        R[1][0] * hx + R[1][1] * hy - R[1][2],
        R[2][0] * hx + R[2][1] * hy - R[2][2],
    )
    turn = (
        R[0][0] * hx_slope + R[0][1] * hy_slope,
        R[1][0] * hx_slope + R[1][1] * hy_slope,
        R[2][0] * hx_slope + R[2][1] * hy_slope,
    )
    return ray, turn


@inlined
def _image(ray: Any, turn: Any, lens: Lens) -> Any:
    """Return the projector pixel of a ray, its derivative by depth, and whether it is valid.

    The pixel is valid if the ray points forward and is before the fold of the lens model.

    ray, turn : (x, y, z) of the ray in the projector's frame, and the derivative of it by depth
    """
    inverse = 1.0 / ray[2]
    px, py = ray[0] * inverse, ray[1] * inverse
    px_slope, py_slope = (turn[0] - px * turn[2]) * inverse, (turn[1] - py * turn[2]) * inverse
    xd, yd = distort_inlined(px, py, lens.distortion)
    jacobian = distortion_jacobian_inlined(px, py, lens.distortion)
    xx, xy, yy = jacobian
    us = lens.fx * (xx * px_slope + xy * py_slope)
    vs = lens.fy * (xy * px_slope + yy * py_slope)
    is_shown = (ray[2] > 0.0) & is_before_fold_inlined(px, py, jacobian, lens.fold_square)
    return lens.fx * xd + lens.cx, lens.fy * yd + lens.cy, us, vs, is_shown


@nested
def _meet_row(
    pixels: Pixels,
    match: Match,
    rig: LayeredRig,
    entry: LayerEntry,
    view: ProjectorView,
    reason: Any,
) -> None:
    """Compute the depth of each pixel by Gauss-Newton steps, from the depth of the pixel before."""
    place, lens = rig.projector_mm, rig.projector
    start = 0.0
    for col in range(reason.size):
        if reason[col] != 0:
            continue
        wu, wv = weights(pixels.u_sigma[col], pixels.v_sigma[col], match)
        x_slope, y_slope = entry.x_slope[col], entry.y_slope[col]
        depth, is_there = start, False
        for _ in range(MAX_STEPS):
            x = entry.x[col] + depth * x_slope - place[0]
            y = entry.y[col] + depth * y_slope - place[1]
            ray, turn = _projector_ray(x, y, x_slope, y_slope, depth, rig)
            u, v, us, vs, is_shown = _image(ray, turn, lens)
            du, dv = pixels.u[col] - u, pixels.v[col] - v
            step = (wu * us * du + wv * vs * dv) / (wu * us * us + wv * vs * vs)
            # A point above the last interface is invalid; a NaN counts as not converged.
            is_there = is_shown & (abs(step) <= STEP_TOLERANCE_MM)
            depth = max(depth + step, 0.0)
            if is_there:
                break
        view.u_residual[col], view.v_residual[col] = du - us * step, dv - vs * step
        view.u_slope[col], view.v_slope[col] = us, vs
        entry.depth[col] = depth
        reason[col] = reason[col] if is_there else NO_POINT
        start = depth if is_there else start


@nested
def _place_row(
    entry: LayerEntry, floor_mm: float, sigma: Any, reason: Any, world: Any, spread: Any
) -> None:
    """Write points and their sigmas in the world frame, mm, to lines (3 col): x y z per pixel."""
    for col in range(reason.size):
        if reason[col] != 0:
            continue
        depth, x_slope, y_slope = entry.depth[col], entry.x_slope[col], entry.y_slope[col]
        world[3 * col] = entry.x[col] + depth * x_slope
        world[3 * col + 1] = entry.y[col] + depth * y_slope
        world[3 * col + 2] = floor_mm - depth
        spread[3 * col] = sigma[col] * abs(x_slope)
        spread[3 * col + 1] = sigma[col] * abs(y_slope)
        spread[3 * col + 2] = sigma[col]


def meet_rows_below(
    first_row: int, end_row: int, fringe: Fringe, match: Match, rig: LayeredRig, points: SpreadRows
) -> None:  # fmt: skip
    """Triangulate the rows from `first_row` to before `end_row` and write them to `points`.

    Only pixels with `points.reason` 0 are triangulated; those that fail get their reason code.
    """
    width = points.reason.shape[1]
    work = Lines(np.zeros((11, width)), np.zeros((7, width), np.float32), np.zeros(width, np.bool_))
    _meet_band(first_row, end_row, fringe, match, rig, work, points)


@compiled
def _meet_band(
    first_row: int, end_row: int, fringe: Fringe, match: Match, rig: LayeredRig, work: Lines,
    points: SpreadRows,
) -> None:  # fmt: skip
    lines, short = work.long, work.short
    rays = Rays(lines[0], lines[1], lines[2], lines[3], work.mask)
    entry = LayerEntry(lines[4], lines[5], lines[6], lines[7], lines[8])
    view = ProjectorView(short[0], short[1], short[2], short[3], lines[9], lines[10])
    su, sv, sigma = short[4], short[5], short[6]
    for row in range(first_row, end_row):
        pixels = Pixels(fringe.column[row], fringe.row[row], su, sv)
        reason = points.reason[row]
        unpack_row(fringe.sigma_column[row], fringe.sigma_unit_px, su)
        unpack_row(fringe.sigma_row[row], fringe.sigma_unit_px, sv)
        ray_row(row, rig.camera, rays)
        _enter_row(rays, rig, entry, reason)
        _meet_row(pixels, match, rig, entry, view, reason)
        judge_row(pixels, match, view, sigma, reason)
        _place_row(
            entry, rig.tops_mm[-1], sigma, reason,
            points.points_world_mm[row], points.sigma_xyz_mm[row],
        )  # fmt: skip
