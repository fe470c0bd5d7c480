"""Shapes in closed form: joined balls, and a cylinder with rounded edges.

Lengths in mm. The specimen presses from below, so that its foremost point is its highest.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from reconstruction.arrays import FloatArray
from twin.shape import Placement, Shape, SignedDistance, Sphere
from twin.specimens.solids import united

if TYPE_CHECKING:
    import trimesh

# Subdivisions of an icosahedron: 6 give 82 k facets, with chord errors up to 0.3 um on a 4 mm ball.
_SUBDIVISIONS = 6
_NECK_OVER_RADIUS = 0.1


@dataclass(frozen=True)
class SphereCluster:
    """One or more balls that move together; at first touch the highest apex is at z = 0."""

    balls: tuple[Sphere, ...]

    @property
    def top_mm(self) -> float:
        """Height of the foremost apex."""
        return max(ball.apex_z_mm for ball in self.balls)

    @property
    def bottom_mm(self) -> float:
        """Height of the lowest point."""
        return min(ball.z_mm - ball.radius_mm for ball in self.balls)

    def placed(self, pose: Placement) -> "SphereCluster":
        """Return the balls moved by a rigid motion."""
        moved = [pose.apply(_centre(ball)) for ball in self.balls]
        return SphereCluster(
            tuple(
                Sphere(float(x), float(y), float(z), ball.radius_mm)
                for ball, (x, y, z) in zip(self.balls, moved, strict=True)
            )
        )

    def height_above_lowest(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return the distance (row, col), mm, of the upper hemispheres behind the touched plane.

        It is inf outside the outlines of the balls.
        """
        height = np.full((y_mm.size, x_mm.size), np.inf)
        for ball in self.balls:
            r2 = (x_mm - ball.x_mm) ** 2 + (y_mm[:, None] - ball.y_mm) ** 2
            inside = r2 <= ball.radius_mm**2
            fall = ball.radius_mm - np.sqrt(np.where(inside, ball.radius_mm**2 - r2, 0.0))
            height = np.where(inside, np.minimum(height, fall - ball.apex_z_mm), height)
        return height

    def spheres(self) -> tuple[Sphere, ...]:
        """Return the balls in the order of the specimen's x axis."""
        return self.balls

    def distances(self) -> tuple[SignedDistance, ...]:
        """Return the signed distance to each ball; the neck between balls is omitted."""
        from twin.specimens.distance import BallDistance

        return tuple(BallDistance((b.x_mm, b.y_mm, b.z_mm), b.radius_mm) for b in self.balls)

    def bounds_mm(self) -> tuple[float, float, float, float]:
        """Return the bounds in world xy, mm: (x low, x high, y low, y high)."""
        return (
            min(b.x_mm - b.radius_mm for b in self.balls),
            max(b.x_mm + b.radius_mm for b in self.balls),
            min(b.y_mm - b.radius_mm for b in self.balls),
            max(b.y_mm + b.radius_mm for b in self.balls),
        )

    def mesh(self, touched_z_mm: float) -> "trimesh.Trimesh":
        """Return one watertight body with its foremost point at z = `touched_z_mm`.

        Notes
        -----
        Balls that touch in one point only (separation = diameter) or not at all are joined by a
        neck, because bodies that touch in one point are not watertight. The neck is a cylinder
        between their centres with 0.1 x their radius. It is 0.9 radii below the apexes, where no
        admissible press reaches it; `height_above_lowest` therefore omits it.
        """
        body = _united(self.balls).copy()
        body.apply_translation((0.0, 0.0, touched_z_mm))
        return body


@lru_cache(maxsize=2)
def _united(balls: tuple[Sphere, ...]) -> "trimesh.Trimesh":
    """Return one body; it takes a second, most of the time in which a bare specimen is loaded."""
    return united([_tessellate(ball) for ball in balls] + _necks(balls))


def _centre(ball: Sphere) -> FloatArray:
    return np.array([ball.x_mm, ball.y_mm, ball.z_mm])


def _tessellate(ball: Sphere) -> "trimesh.Trimesh":
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=_SUBDIVISIONS, radius=ball.radius_mm)
    mesh.apply_translation(_centre(ball))
    return mesh


def _necks(balls: tuple[Sphere, ...]) -> list["trimesh.Trimesh"]:
    import trimesh

    return [
        trimesh.creation.cylinder(
            radius=_NECK_OVER_RADIUS * first.radius_mm,
            segment=np.array([_centre(first), _centre(second)]),
            sections=64,
        )
        for first, second in pairwise(balls)
        if first.radius_mm + second.radius_mm - np.linalg.norm(_centre(first) - _centre(second))
        < 1e-2 * first.radius_mm
    ]


_PASSES = 60
_EXACT_MM = 1e-10
_GRAZING = 1e-9
_SECTIONS, _EDGE_STEPS = 256, 16


@dataclass(frozen=True, eq=False)
class Cylinder(Shape):
    """A cylinder with rounded edges.

    Its surface is the zero set of its distance function, which is convex. Newton's steps along a
    vertical ray from above therefore approach the surface from outside and never cross it.
    """

    #: (xyz) middle
    middle_mm: FloatArray
    #: (xyz) unit vector
    axis: FloatArray
    radius_mm: float
    half_length_mm: float
    edge_radius_mm: float

    @property
    def top_mm(self) -> float:
        """Height of the foremost point."""
        return float(self.middle_mm[2] + self._reach(2))

    @property
    def bottom_mm(self) -> float:
        """Height of the lowest point."""
        return float(self.middle_mm[2] - self._reach(2))

    def placed(self, pose: Placement) -> "Cylinder":
        """Return the cylinder moved by a rigid motion."""
        return replace(self, middle_mm=pose.apply(self.middle_mm), axis=pose.rotation @ self.axis)

    def distances(self) -> tuple[SignedDistance, ...]:
        """Return the signed distance to the cylinder, the only body of this shape."""
        from twin.specimens.distance import CylinderDistance

        sizes = self.radius_mm, self.half_length_mm, self.edge_radius_mm
        return (CylinderDistance(self.middle_mm, self.axis, *sizes),)

    def bounds_mm(self) -> tuple[float, float, float, float]:
        """Return the bounds in world xy, mm: (x low, x high, y low, y high)."""
        (x, y, _), (over_x, over_y) = self.middle_mm, (self._reach(0), self._reach(1))
        return float(x - over_x), float(x + over_x), float(y - over_y), float(y + over_y)

    def height_above_lowest(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return the distance (row, col), mm, of the upper side behind the touched plane.

        It is inf outside the outline of the cylinder.
        """
        x, y = np.meshgrid(x_mm - self.middle_mm[0], y_mm - self.middle_mm[1])
        height = np.full(x.shape, np.inf)
        near = (np.abs(x) <= self._reach(0)) & (np.abs(y) <= self._reach(1))
        # z is relative to the middle; the body is within `start` of it.
        start = self._reach(2) + _EXACT_MM
        z = self._descend(x[near], y[near], start)
        height[near] = np.where(np.isnan(z), np.inf, -self.middle_mm[2] - z)
        return height

    def mesh(self, touched_z_mm: float) -> "trimesh.Trimesh":
        """Return the closed surface with rounded edges, shifted by `touched_z_mm` along z."""
        import trimesh

        turn = np.linspace(0, np.pi / 2, _EDGE_STEPS)
        core, length = self.radius_mm - self.edge_radius_mm, self.half_length_mm
        out, back = self.edge_radius_mm * np.sin(turn), self.edge_radius_mm * (1 - np.cos(turn))
        edge = np.stack((core + out, length - back), axis=-1)
        if self.edge_radius_mm == 0:
            edge = edge[:1]
        line = np.concatenate(([[0.0, length]], edge, edge[::-1] * [1, -1], [[0.0, -length]]))
        body = trimesh.creation.revolve(line[::-1], sections=_SECTIONS)
        body.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], self.axis))
        body.apply_translation(self.middle_mm + np.array([0.0, 0.0, touched_z_mm]))
        return body

    def _reach(self, direction: int) -> float:
        """Return the extent of the body from its middle along a world axis (0 to 2: x to z), mm."""
        along = abs(float(self.axis[direction]))
        across = np.sqrt(max(0.0, 1 - along**2))
        core = self.half_length_mm - self.edge_radius_mm
        disc = self.radius_mm - self.edge_radius_mm
        return float(along * core + across * disc + self.edge_radius_mm)

    def _descend(self, x: FloatArray, y: FloatArray, start_mm: float) -> FloatArray:
        """Return z of the upper surface over points (n,), NaN if the ray misses the body."""
        z = np.full(x.shape, start_mm)
        missed = np.zeros(x.shape, dtype=bool)
        for _ in range(_PASSES):
            distance, rise = self._distance(x, y, z)
            missed |= (distance > _EXACT_MM) & (rise <= 0)
            moving = (distance > _EXACT_MM) & ~missed
            if not moving.any():
                break
            # A ray that grazes the body makes a large step down and is counted as a miss.
            z = np.where(moving, z - distance / np.maximum(rise, _GRAZING), z)
            missed |= z < -start_mm
        return np.where(missed, np.nan, z)

    def _distance(
        self, x: FloatArray, y: FloatArray, z: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the signed distance (n,), mm, to the surface and its derivative by z (n,)."""
        along = x * self.axis[0] + y * self.axis[1] + z * self.axis[2]
        across = np.sqrt(np.maximum(x**2 + y**2 + z**2 - along**2, 1e-30))
        over_end = np.abs(along) - (self.half_length_mm - self.edge_radius_mm)
        over_side = across - (self.radius_mm - self.edge_radius_mm)
        end_rise = np.sign(along) * self.axis[2]
        side_rise = (z - along * self.axis[2]) / across
        beyond_end, beyond_side = np.maximum(over_end, 0), np.maximum(over_side, 0)
        corner = np.hypot(beyond_end, beyond_side)
        inner = np.maximum(over_end, over_side)
        outside = corner > 0
        divisor = np.where(outside, corner, 1.0)
        rise = np.where(
            outside,
            (beyond_end * end_rise + beyond_side * side_rise) / divisor,
            np.where(over_end > over_side, end_rise, side_rise),
        )
        return np.where(outside, corner, inner) - self.edge_radius_mm, rise


def require_cylinder_edge(edge_radius_mm: float, smallest_mm: float) -> None:
    """Raise ValueError if a cylinder's edges are rounded by more than half its smallest size."""
    if edge_radius_mm > smallest_mm / 2:
        raise ValueError(
            f"edge_radius_mm: found {edge_radius_mm:g}, allowed 0 to {smallest_mm / 2:g}, "
            "half the smaller of diameter and length"
        )
