"""Several specimens on one stage, and any specimen as one closed body per part."""

from dataclasses import dataclass
from functools import reduce

import numpy as np
import trimesh

from reconstruction.arrays import FloatArray
from twin.config.specimen_base import Material
from twin.config.specimens import Group, Specimen
from twin.specimens.catalogue import Placement, Shape, Sphere, raised, register, shape_of
from twin.specimens.distance import SignedDistance


@dataclass(frozen=True)
class Assembly:
    """Rigid shapes that move together."""

    parts: tuple[Shape, ...]

    @property
    def top_mm(self) -> float:
        """Height of the foremost part."""
        return max(part.top_mm for part in self.parts)

    @property
    def bottom_mm(self) -> float:
        """Height of the point farthest back of all parts."""
        return min(part.bottom_mm for part in self.parts)

    def placed(self, pose: Placement) -> "Assembly":
        """Return all parts moved."""
        return Assembly(tuple(part.placed(pose) for part in self.parts))

    def spheres(self) -> tuple[Sphere, ...]:
        """Return the balls of all parts, part by part."""
        return tuple(ball for part in self.parts for ball in part.spheres())

    def distances(self) -> tuple[SignedDistance, ...]:
        """Return the distances to the bodies of all parts, part by part."""
        return tuple(body for part in self.parts for body in part.distances())

    def bounds_mm(self) -> tuple[float, float, float, float]:
        """Return the outline in world xy: (x low, x high, y low, y high)."""
        outlines = np.array([part.bounds_mm() for part in self.parts])
        low, high = outlines.min(axis=0), outlines.max(axis=0)
        return float(low[0]), float(high[1]), float(low[2]), float(high[3])

    def height_above_lowest(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return (row, col) float, mm: the foremost part at each point."""
        heights = (part.height_above_lowest(x_mm, y_mm) for part in self.parts)
        return reduce(np.minimum, heights)

    def mesh(self, touched_z_mm: float) -> trimesh.Trimesh:
        """Return all parts as one mesh of closed bodies; parts that overlap are united."""
        bodies = [part.mesh(touched_z_mm) for part in self.parts]
        return bodies[0] if len(bodies) == 1 else trimesh.boolean.union(bodies, engine="manifold")


@register("group")
def build_group(specimen: Group) -> Assembly:
    """Place the parts, each with its foremost point at its own height."""
    return Assembly(
        tuple(shape_of(part).placed(raised(part.z_mm)) for part in specimen.parts.values())
    )


@dataclass(frozen=True, eq=False)
class Body:
    """One closed surface of one material, world frame, mm."""

    #: the part's name in a group, else the specimen's kind
    name: str
    mesh: trimesh.Trimesh
    #: None where the experiment names none
    material: Material | None


def bodies(specimen: Specimen, touched_z_mm: float = 0.0) -> tuple[Body, ...]:
    """Return the parts of a specimen at first touch, world frame, mm.

    Parameters
    ----------
    touched_z_mm : world z of the plane that the specimen touches from below, as for `specimen_mesh`

    Returns
    -------
    One per part of a group, in the file's order; a part without a material has the group's.
        Overlapping parts stay separate here. Every other kind is one body, named by its kind
    """
    shape = shape_of(specimen)
    if not isinstance(specimen, Group) or not isinstance(shape, Assembly):
        kind = str(getattr(specimen, "kind", type(specimen).__name__))
        return (Body(kind, shape.mesh(touched_z_mm), specimen.material),)
    return tuple(
        Body(name, placed.mesh(touched_z_mm), part.material or specimen.material)
        for (name, part), placed in zip(specimen.parts.items(), shape.parts, strict=True)
    )
