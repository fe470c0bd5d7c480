"""The bare specimen on its stage, seen directly: metal, clear plastic, print.

The specimen stands with its foremost point at world z = 0, where the coat would be, and a matte
stage lies below it.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.config.models import Experiment, Material
from twin.optics.bsdfs import level
from twin.optics.checks import check_materials
from twin.optics.materials import mitsuba_mesh
from twin.specimens import bodies

if TYPE_CHECKING:
    import trimesh

    from twin.optics.scene import Surfaces

STAGE = "stage"

AIR_GAP_MM = 0.02
"""Between stage and specimen. Bodies do not wet the table: there is always air below them. It also
keeps the two surfaces apart by ten times the length by which rays leave a surface."""

CREASE_DEG = 20.0
"""Facets that meet at less than this are one smooth surface."""


@dataclass(frozen=True)
class DirectScene:
    """Mitsuba scene of specimen and stage, and what the tracer must know of it."""

    scene: Any
    surfaces: "Surfaces"


@dataclass(frozen=True, eq=False)
class Solid:
    """A closed surface (or the stage) as the renderer and the stock export take it, world mm."""

    name: str
    mesh: "trimesh.Trimesh"
    bsdf: dict[str, Any]
    #: None for the stage
    material: Material | None = None


def solids(experiment: Experiment) -> tuple[Solid, ...]:
    """Return the stage and every part of the specimen; sharp edges kept, curved sides smooth.

    Raises
    ------
    InputError : a part of the specimen has no material
    """
    parts = bodies(experiment.specimen, 0.0)
    check_materials(parts)
    lowest_mm = min(float(part.mesh.bounds[0, 2]) for part in parts)
    return (
        _stage(experiment, lowest_mm - AIR_GAP_MM),
        *(
            Solid(
                f"part_{k}_{part.name}",
                _smooth(part.mesh),
                part.material.bsdf(),
                part.material,
            )
            for k, part in enumerate(parts)
            if part.material is not None
        ),
    )


def direct_scene(experiment: Experiment) -> DirectScene:
    """Build specimen and stage.

    Raises
    ------
    InputError : a part of the specimen has no material
    """
    import mitsuba as mi

    from twin.optics.scene import Sharp, Surfaces

    parts = solids(experiment)
    meshes = {
        part.name: mitsuba_mesh(
            part.name,
            part.mesh.vertices,
            part.mesh.faces,
            part.bsdf,
            normals=part.mesh.vertex_normals,
        )
        for part in parts
    }
    # optimize=False: since 3.7 load_dict merges shapes.
    scene = mi.load_dict({"type": "scene", **meshes}, optimize=False)
    shapes = {shape.id(): shape for shape in scene.shapes()}
    found = tuple(
        Sharp(shapes[part.name], part.material.bulk_absorption_per_mm)
        for part in parts
        if part.material is not None and part.material.is_sharp
    )
    return DirectScene(scene, Surfaces(found, shapes[STAGE]))


def _stage(experiment: Experiment, z_mm: float) -> Solid:
    import trimesh

    half = experiment.stage.size_mm / 2
    corners = np.array([(-half, -half), (half, -half), (half, half), (-half, half)])
    vertices = np.column_stack([corners, np.full(4, z_mm)])
    mesh = trimesh.Trimesh(
        vertices,
        [(0, 1, 2), (0, 2, 3)],
        vertex_normals=np.tile([0.0, 0.0, 1.0], (4, 1)),
        process=False,
    )
    return Solid(STAGE, mesh, {"type": "diffuse", "reflectance": level(experiment.stage.albedo)})


def _smooth(mesh: "trimesh.Trimesh") -> "trimesh.Trimesh":
    """Split the vertices along creases, so that normals are smooth on each side of them."""
    import trimesh.graph

    return trimesh.graph.smooth_shade(mesh, angle=np.deg2rad(CREASE_DEG))
