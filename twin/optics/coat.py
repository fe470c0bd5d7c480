"""The coating as a Mitsuba BSDF, and the coated face as a Mitsuba mesh.

Gray ink with aluminium flakes: fraction `1 - flake_fraction` of the surface reflects diffusely
with the base albedo, the rest is a rough conductor (GGX). A convex blend of two lobes that each
reflect at most all light: energy conserving by construction.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from twin.config.models import Coating

if TYPE_CHECKING:
    import trimesh


def coating_bsdf(coating: Coating) -> dict[str, Any]:
    """Return the dictionary of the blend for `mi.load_dict`."""
    return {
        "type": "blendbsdf",
        "weight": coating.flake_fraction,
        "ink": {
            "type": "diffuse",
            "reflectance": {"type": "spectrum", "value": coating.base_albedo},
        },
        "flakes": {
            "type": "roughconductor",
            "distribution": "ggx",
            "alpha": coating.flake_roughness,
            "eta": {"type": "spectrum", "value": coating.flake_ior},
            "k": {"type": "spectrum", "value": coating.flake_extinction},
        },
    }


def coated_mesh(face: "trimesh.Trimesh", bsdf: dict[str, Any]) -> Any:
    """Return the coated face (vertices in world mm, smooth vertex normals) as `mi.Mesh`."""
    import mitsuba as mi

    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    mesh = mi.Mesh(
        "coated_face",
        vertex_count=len(face.vertices),
        face_count=len(face.faces),
        has_vertex_normals=True,
        props=properties,
    )
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.asarray(face.vertices, np.float32).ravel()
    parameters["vertex_normals"] = np.asarray(face.vertex_normals, np.float32).ravel()
    parameters["faces"] = np.asarray(face.faces, np.uint32).ravel()
    parameters.update()
    return mesh
