"""A specimen as the renderer wants it: one closed mesh per part, each with its material."""

from dataclasses import dataclass

import trimesh

from twin.config.materials import Material
from twin.config.specimens import Group, Specimen
from twin.specimens.catalogue import shape_of
from twin.specimens.group import Assembly


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
    specimen : Specimen
        Configured specimen; its pose is honoured.
    touched_z_mm : float, mm
        World z of the plane that the specimen touches from below, as for `specimen_mesh`.

    Returns
    -------
    tuple of Body
        One per part of a group, in the file's order; a part without a material has the group's.
        Overlapping parts stay separate here. Every other kind is one body, named by its kind.
    """
    shape = shape_of(specimen)
    if not isinstance(specimen, Group) or not isinstance(shape, Assembly):
        kind = str(getattr(specimen, "kind", type(specimen).__name__))
        return (Body(kind, shape.mesh(touched_z_mm), specimen.material),)
    return tuple(
        Body(name, placed.mesh(touched_z_mm), part.material or specimen.material)
        for (name, part), placed in zip(specimen.parts.items(), shape.parts, strict=True)
    )
