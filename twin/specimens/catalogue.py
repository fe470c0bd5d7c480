"""The catalogue of rigid specimens: which shape belongs to which `kind` of the experiment file.

A builder makes the shape in its own frame; its pose (a rigid motion, world = rotation @ body +
shift, mm) and the height of its foremost point are given to it here, the same way for every kind.
z counts from the touched plane, upwards: the specimen comes from below, so its foremost point is
its highest.
Groups are several specimens on one stage; any specimen is one closed body per part.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from typing import Protocol, TypeVar

import numpy as np
import trimesh

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError
from twin.config.materials import Material
from twin.config.specimen_base import Specimen
from twin.config.specimens import Group
from twin.specimens.distance import SignedDistance

AnySpecimen = TypeVar("AnySpecimen", bound=Specimen)


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


def unposed(specimen: AnySpecimen) -> AnySpecimen:
    """Return what a specimen's shape alone depends on: a key under which to keep the shape."""
    return type(specimen)(**specimen.model_dump(exclude=set(Specimen.model_fields)))


def raised(height_mm: float) -> Placement:
    """Return a shift along z."""
    return Placement(np.eye(3), np.array([0.0, 0.0, height_mm]))


def pose_of(specimen: Specimen) -> Placement:
    """Return a specimen's own pose: tilt about its y axis, yaw about z, then shift in the plane."""
    tilt, yaw = np.deg2rad(specimen.tilt_deg), np.deg2rad(specimen.yaw_deg)
    c, s = np.cos(tilt), np.sin(tilt)
    tilted = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    c, s = np.cos(yaw), np.sin(yaw)
    turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return Placement(turned @ tilted, np.array([specimen.x_mm, specimen.y_mm, 0.0]))


@dataclass(frozen=True)
class Sphere:
    """One ball of a specimen at first touch; z counts from the touched plane, upwards."""

    x_mm: float
    y_mm: float
    #: height of the centre above the touched plane (negative: the specimen comes from below)
    z_mm: float
    radius_mm: float

    @property
    def apex_z_mm(self) -> float:
        """Height of the ball's own foremost point, 0 where it is the first to touch."""
        return self.z_mm + self.radius_mm


class Shape(Protocol):
    """What mechanics, rendering and scoring ask of a specimen in its pose."""

    @property
    def top_mm(self) -> float:
        """Height of the foremost point, 0 at first touch."""
        ...

    @property
    def bottom_mm(self) -> float:
        """Height of the point farthest back, where it stands on its plate."""
        ...

    def placed(self, pose: Placement) -> "Shape":
        """Return the shape moved."""
        ...

    def height_above_lowest(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return (row, col) float, mm: distance behind the touched plane, inf where absent."""
        ...

    def mesh(self, touched_z_mm: float) -> trimesh.Trimesh:
        """Return the closed surface with its foremost point at z = `touched_z_mm`."""
        ...

    def spheres(self) -> tuple[Sphere, ...]:
        """Return the balls to fit, in the order of the specimen's x axis; none by default."""
        return ()

    def distances(self) -> tuple[SignedDistance, ...]:
        """Return the signed distances to the bodies, whose contact potentials add."""
        ...

    def bounds_mm(self) -> tuple[float, float, float, float]:
        """Return the outline in world xy: (x low, x high, y low, y high)."""
        ...


Builder = TypeVar("Builder", bound=Callable[..., Shape])
_builders: dict[str, Callable[..., Shape]] = {}


def register(kind: str) -> Callable[[Builder], Builder]:
    """Enter the decorated builder under `kind`.

    It takes the configured specimen and returns the shape in the specimen's own frame.
    """

    def enter(builder: Builder) -> Builder:
        _builders[kind] = builder
        return builder

    return enter


def kinds() -> tuple[str, ...]:
    """Return the known kinds in alphabetical order."""
    return tuple(sorted(_builders))


def shape_of(specimen: Specimen) -> Shape:
    """Build the shape of a configured specimen, in its pose, at first touch.

    Raises
    ------
    InputError : no shape is registered under the specimen's kind, or its mesh file is of no use
    """
    kind = getattr(specimen, "kind", type(specimen).__name__)
    if kind not in _builders:
        raise InputError(f"specimen.kind: found '{kind}', allowed: {', '.join(kinds())}")
    posed = _builders[kind](specimen).placed(pose_of(specimen))
    return posed.placed(raised(-posed.top_mm))


def height_above_lowest(specimen: Specimen, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """Sample the specimen's side that faces the elastomer.

    Parameters
    ----------
    x_mm : (col,) float, mm; world x of the columns
    y_mm : (row,) float, mm; world y of the rows

    Returns
    -------
    (row, col) float, mm; distance from the plane of first touch, counted away from the elastomer: 0
        at the foremost point, inf where there is no specimen. Exact, not a paraboloid.
    """
    return np.maximum(shape_of(specimen).height_above_lowest(x_mm, y_mm), 0.0)


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
    touched_z_mm : world z of the plane that the specimen touches from below

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
