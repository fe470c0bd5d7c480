"""Shape of a specimen: the interface between its description and mechanics, rendering and scoring.

Lengths are in mm. z is the height above the plane of first touch (the touched plane). The specimen
approaches from below, so its foremost point is its highest point.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from reconstruction.arrays import FloatArray

if TYPE_CHECKING:
    import trimesh

Distances = tuple[FloatArray, FloatArray, FloatArray]
"""Signed distance (n,), mm, with its gradient (n, xyz) and its Hessian (n, xyz, xyz), 1/mm."""


@dataclass(frozen=True, eq=False)
class Placement:
    """Rigid motion of points: a rotation about the origin, then a shift."""

    #: (3, 3) rotation matrix
    rotation: FloatArray
    #: (xyz) shift, mm
    shift_mm: FloatArray

    def apply(self, points_mm: FloatArray) -> FloatArray:
        """Return the points (..., xyz), mm, rotated and then shifted."""
        return np.asarray(points_mm @ self.rotation.T + self.shift_mm)

    def then(self, later: "Placement") -> "Placement":
        """Return the combined motion: first this motion, then `later`."""
        return Placement(later.rotation @ self.rotation, later.apply(self.shift_mm))

    @property
    def matrix(self) -> FloatArray:
        """Homogeneous (4, 4) matrix of the motion, for column vectors (x, y, z, 1) in mm."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.shift_mm
        return matrix


UNMOVED = Placement(np.eye(3), np.zeros(3))


@dataclass(frozen=True)
class Sphere:
    """One ball of a specimen: its centre at first touch, in mm, and its radius.

    x and y are in the frame of the shape; z is the height above the touched plane.
    """

    x_mm: float
    y_mm: float
    #: height of the centre above the touched plane (negative: the specimen is below the plane)
    z_mm: float
    radius_mm: float

    @property
    def apex_z_mm(self) -> float:
        """Height of the ball's top above the touched plane, mm; 0 for the first ball touched."""
        return self.z_mm + self.radius_mm


class SignedDistance(Protocol):
    """Signed distance to the surface of one rigid body: negative inside the body."""

    def evaluate(self, points_mm: FloatArray, reach_mm: float) -> Distances:
        """Return the signed distance at points, its gradient and its Hessian.

        Parameters
        ----------
        points_mm : (n, xyz) float, mm; frame of the shape
        reach_mm : largest distance outside the body that is computed exactly, mm. Farther outside,
            the returned distance is any value of at least `reach_mm`; gradient and Hessian are 0
            there

        Returns
        -------
        Distance (n,) float, mm; gradient (n, xyz) float; Hessian (n, xyz, xyz) float, 1/mm
        """
        ...


class Shape(Protocol):
    """Geometry of a specimen in its pose, as mechanics, rendering and scoring use it."""

    @property
    def top_mm(self) -> float:
        """Height z of the foremost point, mm; 0 at first touch."""
        ...

    @property
    def bottom_mm(self) -> float:
        """Height z of the rearmost point, mm, which is at the specimen's plate."""
        ...

    def placed(self, pose: Placement) -> "Shape":
        """Return this shape after the rigid motion `pose`."""
        ...

    def height_above_lowest(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return the depth of the front surface behind the touched plane, (row, col) float, mm.

        `x_mm` and `y_mm` are (row, col) arrays. The depth is inf where the specimen is absent.
        """
        ...

    def mesh(self, touched_z_mm: float) -> "trimesh.Trimesh":
        """Return the closed surface, mm, shifted so that its top is at z = `touched_z_mm`."""
        ...

    def spheres(self) -> tuple[Sphere, ...]:
        """Return the balls with a radius to be fitted, sorted by x; empty by default."""
        return ()

    def distances(self) -> tuple[SignedDistance, ...]:
        """Return the signed distance of each rigid body; their contact potentials are added."""
        ...

    def bounds_mm(self) -> tuple[float, float, float, float]:
        """Return the bounding rectangle in world xy, mm: (x low, x high, y low, y high)."""
        ...
