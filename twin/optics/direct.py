"""Scene of the bare specimen on its stage, for direct fringe projection (no elastomer).

The foremost point of the specimen is at world z = 0, the plane of the coat in the contact method. A
matte stage is below the specimen.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from reconstruction.arrays import FloatArray
from twin.config.models import Experiment, Material
from twin.optics.bsdfs import level
from twin.optics.checks import check_materials
from twin.optics.creases import split_at_creases
from twin.optics.materials import mitsuba_mesh
from twin.specimens import bodies

if TYPE_CHECKING:
    import trimesh

    from twin.optics.scene import Surfaces

STAGE = "stage"

AIR_GAP_MM = 0.02
"""Air gap between stage and specimen: bodies do not wet the table. The gap is also 10 x the offset
at which rays start from a surface."""


@dataclass(frozen=True)
class DirectScene:
    """Mitsuba scene of specimen and stage, with the sharp (clear or polished) surfaces in it."""

    scene: Any
    surfaces: "Surfaces"


@dataclass(frozen=True, eq=False)
class Solid:
    """Mesh (world mm) and BSDF of a part of the specimen, or of the stage.

    The renderer and the export as stock Mitsuba scene use these solids.
    """

    name: str
    mesh: "trimesh.Trimesh"
    bsdf: dict[str, Any]
    #: material of the part; None for the stage
    material: Material | None = None


def solids(experiment: Experiment) -> tuple[Solid, ...]:
    """Return the stage and every part of the specimen; normals are smooth except at creases.

    All are displaced to the instant `motion.time_s`, if the experiment states one.

    Raises
    ------
    InputError : a part of the specimen has no material
    """
    parts = bodies(experiment.specimen, 0.0)
    check_materials(parts)
    lowest_mm = min(float(part.mesh.bounds[0, 2]) for part in parts)
    pose = experiment.motion.pose
    return (
        _displaced(_stage(experiment, lowest_mm - AIR_GAP_MM), pose),
        *(
            Solid(
                f"part_{k}_{part.name}",
                split_at_creases(part.mesh).apply_transform(pose),
                part.material.bsdf(),
                part.material,
            )
            for k, part in enumerate(parts)
            if part.material is not None
        ),
    )


def direct_scene(experiment: Experiment) -> DirectScene:
    """Build the Mitsuba scene of the bare specimen on its stage.

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
    sharp = tuple(
        Sharp(shapes[part.name], part.material.bulk_absorption_per_mm)
        for part in parts
        if part.material is not None and part.material.is_sharp
    )
    return DirectScene(scene, Surfaces(sharp, shapes[STAGE]))


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


def _displaced(solid: Solid, pose: FloatArray) -> Solid:
    return replace(solid, mesh=solid.mesh.copy().apply_transform(pose))
