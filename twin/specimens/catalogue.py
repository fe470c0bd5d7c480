"""Shapes and closed bodies of configured specimens of any kind, in their pose.

A specimen defines its shape in its own frame. This module applies its pose (a rigid motion, world =
rotation @ body + shift, mm) and shifts it along z to first touch: its foremost point is at z = 0. z
is measured upwards from the touched plane. The specimen presses from below, so that its foremost
point is its highest. A group consists of several specimens on one stage and has one closed body per
part; any other specimen is one closed body.
"""

from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from reconstruction.arrays import FloatArray
from twin.config.materials import Material
from twin.config.specimen_base import Specimen
from twin.shape import Placement, Shape, SignedDistance, Sphere
from twin.specimens.solids import united

if TYPE_CHECKING:
    import trimesh

AnySpecimen = TypeVar("AnySpecimen", bound=Specimen)


def unposed(specimen: AnySpecimen) -> AnySpecimen:
    """Return a copy of a specimen without pose and material: the cache key of its shape."""
    return type(specimen)(**specimen.model_dump(exclude=set(Specimen.model_fields) - {"kind"}))


def raised(height_mm: float) -> Placement:
    """Return the placement that shifts a shape by `height_mm` along z."""
    return Placement(np.eye(3), np.array([0.0, 0.0, height_mm]))


def pose_of(specimen: Specimen) -> Placement:
    """Return a specimen's own pose: tilt about its y axis, yaw about z, then shift in the plane."""
    tilt, yaw = np.deg2rad(specimen.tilt_deg), np.deg2rad(specimen.yaw_deg)
    c, s = np.cos(tilt), np.sin(tilt)
    tilted = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    c, s = np.cos(yaw), np.sin(yaw)
    turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return Placement(turned @ tilted, np.array([specimen.x_mm, specimen.y_mm, 0.0]))


def shape_of(specimen: Specimen) -> Shape:
    """Return the shape of a specimen in its pose at first touch: the foremost point is at z = 0.

    Raises
    ------
    InputError : a file that the specimen names cannot be used
    """
    posed = specimen.shape().placed(pose_of(specimen))
    return posed.placed(raised(-posed.top_mm))


def height_above_lowest(specimen: Specimen, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """Return the heights, on a grid, of the specimen's side that faces the elastomer.

    Parameters
    ----------
    x_mm : (col,) float, mm; world x of the columns
    y_mm : (row,) float, mm; world y of the rows

    Returns
    -------
    (row, col) float, mm; distance from the plane of first touch, away from the elastomer: 0 at
        the foremost point, inf outside the specimen. A ball is exact, not a paraboloid.
    """
    return np.maximum(shape_of(specimen).height_above_lowest(x_mm, y_mm), 0.0)


@dataclass(frozen=True)
class Assembly:
    """Several rigid shapes that move together: a group, or a specimen that consists of parts."""

    parts: tuple[Shape, ...]

    @property
    def top_mm(self) -> float:
        """Height of the foremost point of all parts."""
        return max(part.top_mm for part in self.parts)

    @property
    def bottom_mm(self) -> float:
        """Height of the lowest point of all parts."""
        return min(part.bottom_mm for part in self.parts)

    def placed(self, pose: Placement) -> "Assembly":
        """Return the assembly moved by a rigid motion."""
        return Assembly(tuple(part.placed(pose) for part in self.parts))

    def spheres(self) -> tuple[Sphere, ...]:
        """Return the balls of all parts, part by part."""
        return tuple(ball for part in self.parts for ball in part.spheres())

    def distances(self) -> tuple[SignedDistance, ...]:
        """Return the distances to the bodies of all parts, part by part."""
        return tuple(body for part in self.parts for body in part.distances())

    def bounds_mm(self) -> tuple[float, float, float, float]:
        """Return the bounds in world xy, mm: (x low, x high, y low, y high)."""
        outlines = np.array([part.bounds_mm() for part in self.parts])
        low, high = outlines.min(axis=0), outlines.max(axis=0)
        return float(low[0]), float(high[1]), float(low[2]), float(high[3])

    def height_above_lowest(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return the distance (row, col), mm, of the foremost part behind the touched plane.

        It is inf where there is no part.
        """
        heights = (part.height_above_lowest(x_mm, y_mm) for part in self.parts)
        return reduce(np.minimum, heights)

    def mesh(self, touched_z_mm: float) -> "trimesh.Trimesh":
        """Return all parts as one mesh of closed bodies; parts that overlap are united."""
        return united([part.mesh(touched_z_mm) for part in self.parts])


@dataclass(frozen=True, eq=False)
class Body:
    """One closed body of one optical material, world frame, mm."""

    #: name of the part in a group; otherwise the kind of the specimen
    name: str
    mesh: "trimesh.Trimesh"
    #: None if the experiment states no material
    material: Material | None


def bodies(specimen: Specimen, touched_z_mm: float = 0.0) -> tuple[Body, ...]:
    """Return the closed bodies of a specimen at first touch, world frame, mm.

    Parameters
    ----------
    touched_z_mm : world z of the plane that the specimen touches from below

    Returns
    -------
    For a group one body per part, in the order of the file; a part without a material has the
    material of the group, and overlapping parts remain separate. Any other specimen is one body
    """
    shape, parts = shape_of(specimen), specimen.components
    if not parts or not isinstance(shape, Assembly):
        return (Body(specimen.kind, shape.mesh(touched_z_mm), specimen.material),)
    return tuple(
        Body(name, placed.mesh(touched_z_mm), part.material or specimen.material)
        for (name, part), placed in zip(parts.items(), shape.parts, strict=True)
    )
