"""The interface between a specimen's description and mechanics, rendering and scoring: its shape.

Lengths in mm. z is the height above the touched plane: the specimen approaches from below, so its
foremost point is its highest.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from reconstruction.arrays import FloatArray

if TYPE_CHECKING:
    import trimesh

Distances = tuple[FloatArray, FloatArray, FloatArray]
"""Distance (n,), mm; gradient (n, xyz); Hessian (n, xyz, xyz), 1/mm."""


@dataclass(frozen=True, eq=False)
class Placement:
    """A rotation and a shift."""

    #: (3, 3) rotation
    rotation: FloatArray
    #: (xyz) shift, mm
    shift_mm: FloatArray

    def apply(self, points_mm: FloatArray) -> FloatArray:
        """Move points (..., xyz)."""
        return np.asarray(points_mm @ self.rotation.T + self.shift_mm)

    def then(self, later: "Placement") -> "Placement":
        """Return this motion followed by another."""
        return Placement(later.rotation @ self.rotation, later.apply(self.shift_mm))

    @property
    def matrix(self) -> FloatArray:
        """(4, 4) homogeneous matrix."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.shift_mm
        return matrix


UNMOVED = Placement(np.eye(3), np.zeros(3))


@dataclass(frozen=True)
class Sphere:
    """One ball of a specimen at first touch; z counts from the touched plane, upwards."""

    x_mm: float
    y_mm: float
    #: height of the centre above the touched plane (negative: the specimen is below the plane)
    z_mm: float
    radius_mm: float

    @property
    def apex_z_mm(self) -> float:
        """Height of the ball's top above the touched plane; 0 for the ball that touches first."""
        return self.z_mm + self.radius_mm


class SignedDistance(Protocol):
    """Distance to the surface of one rigid body, negative inside."""

    def evaluate(self, points_mm: FloatArray, reach_mm: float) -> Distances:
        """Return distance, gradient and Hessian at points.

        Parameters
        ----------
        points_mm : (n, xyz) float, mm; frame of the shape
        reach_mm : largest distance outside the body that is resolved: beyond it the distance is any
            value of at least `reach_mm`, gradient and Hessian are 0

        Returns
        -------
        (n,) float, mm; (n, xyz) float; (n, xyz, xyz) float, 1/mm
        """
        ...


class Shape(Protocol):
    """Geometry of a specimen in its pose."""

    @property
    def top_mm(self) -> float:
        """Height of the foremost point, 0 at first touch."""
        ...

    @property
    def bottom_mm(self) -> float:
        """Height of the point farthest back, at the specimen's plate."""
        ...

    def placed(self, pose: Placement) -> "Shape":
        """Return the shape moved."""
        ...

    def height_above_lowest(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return (row, col) float, mm: distance behind the touched plane, inf where absent."""
        ...

    def mesh(self, touched_z_mm: float) -> "trimesh.Trimesh":
        """Return the closed surface with its foremost point at z = `touched_z_mm`."""
        ...

    def spheres(self) -> tuple[Sphere, ...]:
        """Return the balls to fit, in the order of the specimen's x axis; none by default."""
        return ()

    def distances(self) -> tuple[SignedDistance, ...]:
        """Return the signed distances to the bodies; their contact potentials are summed."""
        ...

    def bounds_mm(self) -> tuple[float, float, float, float]:
        """Return the outline in world xy: (x low, x high, y low, y high)."""
        ...
