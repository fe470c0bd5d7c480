"""Signed distances to rigid bodies with gradient and Hessian, for the contact of a sheet.

Frame of the shape, mm: z = 0 is the plane of first touch, and the body is below. Distances are
negative inside. This module has the bodies with a closed form; `sampled_distance` has meshes. The
closed forms are exact outside a body. Inside, they are smooth up to a depth of the edge radius, at
which the nearest face changes.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.compiling import NESTED, Function, compile_and_keep, digest_of_sources
from reconstruction.machine import threads
from twin.shape import Distances, Shape, SignedDistance

_BAND = 8192
# Least radius of edges, mm: the curvature of a sharper edge is too large for Newton steps. With
# this radius an edge is 4 um lower; all other parts of the surface are unchanged.
SHARPEST_MM = 0.01
_TINY_MM = 1e-9

# No fused multiply-add: the same bytes on every CPU type.
_OPTIONS = {"nogil": True, "_nrt": False, "error_model": "numpy"}
_SOURCES = ("distance.py", "sampled_distance.py", "triangles.py")
_SOURCE_DIGEST = digest_of_sources(Path(__file__).parent, _SOURCES)


def compiled(function: Function) -> Function:
    """Return a kernel that is compiled at its first call and cached on disk.

    Callers of the kernel allocate all its arrays.
    """
    return compile_and_keep(function, _OPTIONS, _SOURCE_DIGEST)


def nested(function: Function) -> Function:
    """Return a compiled function that other kernels can call, but not Python."""
    return compile_and_keep(function, _OPTIONS | NESTED, _SOURCE_DIGEST)


def distances_of(shape: Shape) -> tuple[SignedDistance, ...]:
    """Return the signed distances to the bodies of a shape in its pose.

    The contact potentials of the bodies are summed.
    """
    return shape.distances()


@dataclass(frozen=True)
class BallDistance:
    """Signed distance to a ball."""

    centre_mm: tuple[float, float, float]
    radius_mm: float

    def evaluate(self, points_mm: FloatArray, reach_mm: float) -> Distances:
        """Return distance, gradient and Hessian, see `SignedDistance`."""
        return over_points(_ball, points_mm, reach_mm, np.array(self.centre_mm), self.radius_mm)


@dataclass(frozen=True, eq=False)
class CylinderDistance:
    """Signed distance to a cylinder with rounded edges; their least radius is `SHARPEST_MM`."""

    #: (xyz) middle
    middle_mm: FloatArray
    #: (xyz) unit vector
    axis: FloatArray
    radius_mm: float
    half_length_mm: float
    edge_radius_mm: float

    def evaluate(self, points_mm: FloatArray, reach_mm: float) -> Distances:
        """Return distance, gradient and Hessian, see `SignedDistance`."""
        edge = _edge_mm(self.edge_radius_mm, min(self.radius_mm, self.half_length_mm))
        core = self.radius_mm - edge, self.half_length_mm - edge
        return over_points(_cylinder, points_mm, reach_mm, self.middle_mm, self.axis, *core, edge)


@dataclass(frozen=True, eq=False)
class BoxDistance:
    """Signed distance to a block with rounded edges; their least radius is `SHARPEST_MM`."""

    #: (xyz) middle
    middle_mm: FloatArray
    #: (xyz, axis) the block's own axes as columns
    rotation: FloatArray
    #: (axis) half of each side
    half_mm: FloatArray
    edge_radius_mm: float

    def evaluate(self, points_mm: FloatArray, reach_mm: float) -> Distances:
        """Return distance, gradient and Hessian, see `SignedDistance`."""
        edge = _edge_mm(self.edge_radius_mm, float(self.half_mm.min()))
        core = self.half_mm - edge
        return over_points(_boxed, points_mm, reach_mm, self.middle_mm, self.rotation, core, edge)


@dataclass(frozen=True)
class HalfSpace:
    """Signed distance to the half-space behind a plane: normal . point - offset."""

    #: (xyz) unit vector that points out of the material
    normal: tuple[float, float, float]
    offset_mm: float

    def evaluate(self, points_mm: FloatArray, reach_mm: float) -> Distances:
        """Return distance, gradient and Hessian, see `SignedDistance`."""
        return over_points(_half_space, points_mm, reach_mm, np.array(self.normal), self.offset_mm)


@dataclass(frozen=True)
class RoundWall:
    """Signed distance to a body that fills the space outside a cylinder about the z axis."""

    radius_mm: float

    def evaluate(self, points_mm: FloatArray, reach_mm: float) -> Distances:
        """Return distance, gradient and Hessian, see `SignedDistance`."""
        return over_points(_round_wall, points_mm, reach_mm, self.radius_mm)


@dataclass(frozen=True)
class RectangularInside:
    """Opening of a rectangular frame, centred on the z axis."""

    half_x_mm: float
    half_y_mm: float


@dataclass(frozen=True)
class RoundInside:
    """Opening of a round frame, centred on the z axis."""

    radius_mm: float


def plate(z_mm: float) -> SignedDistance:
    """Return the signed distance to the half-space below z = `z_mm`."""
    return HalfSpace((0.0, 0.0, 1.0), z_mm)


def frame_wall(outline: RectangularInside | RoundInside) -> tuple[SignedDistance, ...]:
    """Return the signed distances to the walls of a frame's opening, vertical and unbounded."""
    if isinstance(outline, RoundInside):
        return (RoundWall(outline.radius_mm),)
    x, y = -outline.half_x_mm, -outline.half_y_mm
    return (
        HalfSpace((-1.0, 0.0, 0.0), x),
        HalfSpace((1.0, 0.0, 0.0), x),
        HalfSpace((0.0, -1.0, 0.0), y),
        HalfSpace((0.0, 1.0, 0.0), y),
    )


def is_clear_of(
    body: SignedDistance, low_mm: FloatArray, high_mm: FloatArray, reach_mm: float
) -> bool:
    """Return True if a plane or a round wall is farther than `reach_mm` from a whole box.

    The box is given by its corners of least and largest coordinates (xyz). The result is False for
    all other bodies: their distance must be evaluated point by point.
    """
    if isinstance(body, HalfSpace):
        normal = np.array(body.normal)
        least = float(np.minimum(normal * low_mm, normal * high_mm).sum()) - body.offset_mm
    elif isinstance(body, RoundWall):
        farthest = np.maximum(np.abs(low_mm[:2]), np.abs(high_mm[:2]))
        least = body.radius_mm - float(np.hypot(*farthest))
    else:
        return False
    return least > reach_mm


def over_points(
    kernel: Callable[..., None], points_mm: FloatArray, reach_mm: float, *body: Any
) -> Distances:
    """Return distance, gradient and Hessian at points (n, xyz), computed by a kernel.

    `kernel(points, reach, (distance, gradient, hessian), body)` is called for bands of points, in
    threads, and fills the results, which start as zeros. Points are independent of each other, so
    that the results do not depend on the bands.
    """
    points = np.ascontiguousarray(points_mm, dtype=np.float64)
    count = len(points)
    out = np.zeros(count), np.zeros((count, 3)), np.zeros((count, 3, 3))
    bands = [slice(first, first + _BAND) for first in range(0, count, _BAND)]

    def fill(band: slice) -> None:
        distance, gradient, hessian = (part[band] for part in out)
        kernel(points[band], float(reach_mm), (distance, gradient, hessian), body)

    if len(bands) < 2 or threads() == 1:
        for band in bands:
            fill(band)
    else:
        list(_pool(threads()).map(fill, bands))
    return out


@cache
def _pool(workers: int) -> ThreadPoolExecutor:
    # A press evaluates thousands of times; starting threads would take as long as a coarse sheet.
    return ThreadPoolExecutor(workers, thread_name_prefix="distance")


def _edge_mm(edge_radius_mm: float, half_mm: float) -> float:
    return max(edge_radius_mm, min(SHARPEST_MM, half_mm / 2))


@compiled
def _ball(points: FloatArray, reach: float, out: Distances, body: tuple[FloatArray, float]) -> None:
    distance, gradient, hessian = out
    centre, radius = body
    for i in range(len(points)):
        x, y, z = points[i, 0] - centre[0], points[i, 1] - centre[1], points[i, 2] - centre[2]
        far = max(np.sqrt(x * x + y * y + z * z), _TINY_MM)
        distance[i] = far - radius
        if distance[i] > reach:
            continue
        n = (x / far, y / far, z / far)
        for a in range(3):
            gradient[i, a] = n[a]
            for b in range(3):
                hessian[i, a, b] = -n[a] * n[b] / far
            hessian[i, a, a] += 1 / far


@compiled
def _cylinder(
    points: FloatArray,
    reach: float,
    out: Distances,
    body: tuple[FloatArray, FloatArray, float, float, float],
) -> None:
    """Fill the distance to a cylinder with its derivatives.

    In the plane through point and axis it is the distance to a rectangle, less the edge's radius.
    """
    distance, gradient, hessian = out
    middle, axis, core_radius, core_length, edge = body
    ax, ay, az = axis[0], axis[1], axis[2]
    for i in range(len(points)):
        x, y, z = points[i, 0] - middle[0], points[i, 1] - middle[1], points[i, 2] - middle[2]
        along = x * ax + y * ay + z * az
        wx, wy, wz = x - along * ax, y - along * ay, z - along * az
        across = np.sqrt(wx * wx + wy * wy + wz * wz)
        over_end, over_side = abs(along) - core_length, across - core_radius
        end, side, bend = 0.0, 0.0, 0.0
        if over_end > 0 and over_side > 0:
            far = max(np.sqrt(over_end * over_end + over_side * over_side), _TINY_MM)
            end, side, bend = over_end / far, over_side / far, 1 / far
        elif over_end > over_side:
            far, end = over_end, 1.0
        else:
            far, side = over_side, 1.0
        distance[i] = far - edge
        if distance[i] > reach:
            continue
        forth = -1.0 if along < 0 else 1.0
        outward = 1 / max(across, _TINY_MM)
        a = (forth * ax, forth * ay, forth * az)
        u = (wx * outward, wy * outward, wz * outward)
        for p in range(3):
            gradient[i, p] = end * a[p] + side * u[p]
            round_edge = bend * (side * a[p] - end * u[p])
            for q in range(3):
                round_axis = (1.0 if p == q else 0.0) - a[p] * a[q] - u[p] * u[q]
                hessian[i, p, q] = round_edge * (side * a[q] - end * u[q])
                hessian[i, p, q] += side * outward * round_axis


@nested
def _beyond_core(
    at: FloatArray, rotation: FloatArray, core: FloatArray, over: FloatArray, sign: FloatArray
) -> tuple[float, int]:
    """Return the distance of a point to the core of a block, and the axis of the nearest face.

    Sets `over`, the distance beyond the nearer face of each axis, and `sign`, the side of the face.
    """
    squared, foremost = 0.0, 0
    for k in range(3):
        along = rotation[0, k] * at[0] + rotation[1, k] * at[1] + rotation[2, k] * at[2]
        sign[k] = -1.0 if along < 0 else 1.0
        over[k] = abs(along) - core[k]
        squared += max(over[k], 0.0) ** 2
        if over[k] > over[foremost]:
            foremost = k
    # If the point is beyond a single face, a square root would add a rounding error.
    single_face = squared <= max(over[foremost], 0.0) ** 2
    return over[foremost] if single_face else np.sqrt(squared), foremost


@nested
def _bend(
    n: FloatArray, rotation: FloatArray, over: FloatArray, far: float, hessian: FloatArray
) -> None:
    """Set the Hessian (I - n n) / far, restricted to axes along which the point is beyond the core.

    `n` is the gradient and `far` the distance to the core.
    """
    for p in range(3):
        for q in range(p, 3):
            bend = -n[p] * n[q]
            for k in range(3):
                if over[k] > 0:
                    bend += rotation[p, k] * rotation[q, k]
            hessian[p, q] = hessian[q, p] = bend / far


Box = tuple[FloatArray, FloatArray, FloatArray, float]


def _boxed(points: FloatArray, reach: float, out: Distances, body: Box) -> None:
    _box(points, reach, out, body, np.zeros((3, 3)))


@compiled
def _box(points: FloatArray, reach: float, out: Distances, body: Box, lines: FloatArray) -> None:
    """Fill the distance to a block with its derivatives: that to its core, less the edge's radius.

    Inside the core it is the distance to the nearest face.
    """
    distance, gradient, hessian = out
    middle, rotation, core, edge = body
    at, over, n = lines[0], lines[1], lines[2]
    for i in range(len(points)):
        for p in range(3):
            at[p] = points[i, p] - middle[p]
        far, foremost = _beyond_core(at, rotation, core, over, n)
        distance[i] = far - edge
        if distance[i] > reach:
            continue
        for k in range(3):
            if far > over[foremost]:
                n[k] *= max(over[k], 0.0) / far
            elif k != foremost:
                n[k] = 0.0
        for p in range(3):
            for k in range(3):
                gradient[i, p] += rotation[p, k] * n[k]
        if far > over[foremost]:
            _bend(gradient[i], rotation, over, far, hessian[i])


@compiled
def _half_space(
    points: FloatArray, reach: float, out: Distances, body: tuple[FloatArray, float]
) -> None:
    distance, gradient, _hessian = out
    normal, offset = body
    for i in range(len(points)):
        at = normal[0] * points[i, 0] + normal[1] * points[i, 1] + normal[2] * points[i, 2]
        distance[i] = at - offset
        if distance[i] <= reach:
            for k in range(3):  # a slice would compile error texts, which takes 2 s
                gradient[i, k] = normal[k]


@compiled
def _round_wall(points: FloatArray, reach: float, out: Distances, body: tuple[float]) -> None:
    distance, gradient, hessian = out
    (radius,) = body
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        across = max(np.sqrt(x * x + y * y), _TINY_MM)
        distance[i] = radius - across
        if distance[i] > reach:
            continue
        x, y = x / across, y / across
        gradient[i, 0], gradient[i, 1] = -x, -y
        hessian[i, 0, 0], hessian[i, 1, 1] = -y * y / across, -x * x / across
        hessian[i, 0, 1] = hessian[i, 1, 0] = x * y / across
