"""The coating as a Mitsuba BSDF, and the coated face as a Mitsuba mesh.

Gray ink with aluminium flakes: fraction `1 - flake_fraction` of the surface is ink, the rest a
rough conductor (GGX). The ink is a diffuse pigment, bare or under a clear binder whose rough face
reflects by Fresnel; pigment and binder exchange light until it has left (J. L. Saunderson, J. Opt.
Soc. Am. 32, 727 (1942)), so a binder darkens the pigment. A convex blend of lobes that each reflect
at most all light: energy conserving by construction.

Left out: flakes below the binder's face (they lie bare), and light scattered more than once by one
rough face (it is lost, as in all single-scattering microfacet models).
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from twin.config.models import Coating

if TYPE_CHECKING:
    import trimesh

COATED_FACE = "coated_face"
"""Name of the coated mesh in every scene that holds one."""


def coating_bsdf(coating: Coating) -> dict[str, Any]:
    """Return the dictionary of the blend for `mi.load_dict`."""
    return {
        "type": "blendbsdf",
        "weight": coating.flake_fraction,
        "ink": _ink(coating),
        "flakes": {
            "type": "roughconductor",
            "distribution": "ggx",
            "alpha": coating.flake_roughness,
            "eta": {"type": "spectrum", "value": coating.flake_ior},
            "k": {"type": "spectrum", "value": coating.flake_extinction},
        },
    }


def _ink(coating: Coating) -> dict[str, Any]:
    pigment = {"type": "spectrum", "value": coating.base_albedo}
    if coating.binder_ior == 1.0:
        return {"type": "diffuse", "reflectance": pigment}
    return {
        "type": "roughplastic",
        "distribution": "ggx",
        "alpha": coating.binder_roughness,
        "int_ior": coating.binder_ior,
        "ext_ior": 1.0,
        "nonlinear": True,  # inter-reflections below the binder meet the pigment again and again
        "diffuse_reflectance": pigment,
    }


def set_coating(scene: Any, coating: Coating) -> None:
    """Give the coated face of a loaded scene another coating; geometry and BVH stay.

    Parameters
    ----------
    scene : mi.Scene
        Holds a mesh named `COATED_FACE`, as `coated_scene` makes it.
    coating : Coating
        Any: new numbers are parameter updates that keep the compiled kernel. Between a matte ink
        and one with a binder the BSDF is exchanged, which compiles one kernel more.

    Raises
    ------
    ValueError
        The scene has no coated face.
    """
    import mitsuba as mi

    face = next((shape for shape in scene.shapes() if shape.id() == COATED_FACE), None)
    if face is None:
        raise ValueError(f"the scene has no shape named {COATED_FACE}: build it with coated_scene")
    new = mi.load_dict(coating_bsdf(coating))
    values, parameters = mi.traverse(new), mi.traverse(face.bsdf())
    if values.keys() != parameters.keys():
        face.set_bsdf(new)
        return
    for name in values.keys():  # noqa: SIM118  # iterating over it gives pairs
        parameters[name] = values[name]
    parameters.update()


def coated_mesh(face: "trimesh.Trimesh", bsdf: dict[str, Any]) -> Any:
    """Return the coated face (vertices in world mm, smooth vertex normals) as `mi.Mesh`."""
    import mitsuba as mi

    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    mesh = mi.Mesh(
        COATED_FACE,
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
