"""Specimens made of balls: one ball, and two joined ones (the paper's artefact).

mm. The specimen comes from below, so its foremost point is its highest.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import trimesh

from reconstruction.arrays import FloatArray
from twin.config.models import Ball, TwoBalls
from twin.specimens.catalogue import Placement, Sphere, register
from twin.specimens.distance import BallDistance, SignedDistance

# Level 6 has 82 k facets; its chords stay within 0.3 um of a 4 mm ball.
_SUBDIVISIONS = 6
_NECK_OVER_RADIUS = 0.1


@dataclass(frozen=True)
class SphereCluster:
    """Rigid balls; at first touch the highest apex is at z = 0."""

    balls: tuple[Sphere, ...]

    @property
    def top_mm(self) -> float:
        """Height of the foremost apex."""
        return max(ball.apex_z_mm for ball in self.balls)

    @property
    def bottom_mm(self) -> float:
        """Height of the point farthest back."""
        return min(ball.z_mm - ball.radius_mm for ball in self.balls)

    def placed(self, pose: Placement) -> "SphereCluster":
        """Return the balls moved."""
        moved = [pose.apply(_centre(ball)) for ball in self.balls]
        return SphereCluster(
            tuple(
                Sphere(float(x), float(y), float(z), ball.radius_mm)
                for ball, (x, y, z) in zip(self.balls, moved, strict=True)
            )
        )

    def height_above_lowest(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return (row, col) float, mm: upper hemispheres only, inf outside their outlines."""
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
        """Return the distance to each ball; the neck that joins them is out of reach."""
        return tuple(BallDistance((b.x_mm, b.y_mm, b.z_mm), b.radius_mm) for b in self.balls)

    def bounds_mm(self) -> tuple[float, float, float, float]:
        """Return the outline in world xy: (x low, x high, y low, y high)."""
        return (
            min(b.x_mm - b.radius_mm for b in self.balls),
            max(b.x_mm + b.radius_mm for b in self.balls),
            min(b.y_mm - b.radius_mm for b in self.balls),
            max(b.y_mm + b.radius_mm for b in self.balls),
        )

    def mesh(self, touched_z_mm: float) -> trimesh.Trimesh:
        """Return one watertight body with its foremost point at z = `touched_z_mm`.

        Notes
        -----
        Balls that touch in a point only (separation = diameter) or not at all are joined by a
        thin cylinder between their centres, a tenth of the radius thick: a body that hangs
        together in one point is not watertight. The neck lies 0.9 radii behind the apexes, so
        `height_above_lowest` leaves it out: no admissible press reaches it.
        """
        parts = [_tessellate(ball) for ball in self.balls] + _necks(self.balls)
        body = parts[0] if len(parts) == 1 else trimesh.boolean.union(parts, engine="manifold")
        body.apply_translation((0.0, 0.0, touched_z_mm))
        return body


@register("ball")
def build_ball(specimen: Ball) -> SphereCluster:
    """Centre one ball."""
    return SphereCluster((Sphere(0.0, 0.0, 0.0, specimen.diameter_mm / 2),))


@register("two_balls")
def build_two_balls(specimen: TwoBalls) -> SphereCluster:
    """Lay two balls along the specimen's x axis, round their midpoint."""
    half = specimen.separation_mm / 2
    return SphereCluster(
        tuple(Sphere(side * half, 0.0, 0.0, specimen.diameter_mm / 2) for side in (-1, 1))
    )


def _centre(ball: Sphere) -> FloatArray:
    return np.array([ball.x_mm, ball.y_mm, ball.z_mm])


def _tessellate(ball: Sphere) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=_SUBDIVISIONS, radius=ball.radius_mm)
    mesh.apply_translation(_centre(ball))
    return mesh


def _necks(balls: tuple[Sphere, ...]) -> list[trimesh.Trimesh]:
    return [
        trimesh.creation.cylinder(
            radius=_NECK_OVER_RADIUS * first.radius_mm,
            segment=np.array([_centre(first), _centre(second)]),
            sections=64,
        )
        for first, second in pairwise(balls)
        if _overlap(first, second) < 1e-2 * first.radius_mm
    ]


def _overlap(first: Sphere, second: Sphere) -> float:
    distance = float(np.linalg.norm(_centre(first) - _centre(second)))
    return first.radius_mm + second.radius_mm - distance
