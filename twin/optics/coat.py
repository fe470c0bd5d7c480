"""The coating as a Mitsuba BSDF, and the coated face as a Mitsuba mesh.

Gray ink with aluminium flakes: fraction `1 - flake_fraction` of the surface is ink, the rest a
rough conductor (GGX). The ink is a diffuse pigment, bare or under a clear binder whose rough face
reflects by Fresnel; pigment and binder exchange light until it has left (J. L. Saunderson, J. Opt.
Soc. Am. 32, 727 (1942)), so a binder darkens the pigment. A convex blend of lobes that each reflect
at most all light: energy conserving by construction.

Left out: flakes below the binder's face (they lie bare), and light scattered more than once by one
rough face (it is lost, as in all single-scattering microfacet models).
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from twin.config.models import Coating
from twin.optics.materials import mitsuba_mesh

if TYPE_CHECKING:
    import trimesh

COATED_FACE = "coated_face"
"""Name of the coated mesh in every scene that holds one."""

# What `mi.traverse` calls otherwise than `mi.load_dict`.
_LISTED_AS = {"ink": "bsdf_0", "flakes": "bsdf_1", "int_ior": "eta"}


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
    blend, parameters = coating_bsdf(coating), mi.traverse(face.bsdf())
    values = {name: value for name, value in _numbers(blend) if name in parameters}
    if values.keys() != set(parameters.keys()):
        face.set_bsdf(mi.load_dict(blend))
        return
    for name, value in values.items():
        parameters[name] = value
    parameters.update()


def _numbers(node: dict[str, Any], above: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers of a BSDF's dictionary under the names that `mi.traverse` may list them."""
    for key, value in node.items():
        name = above + _LISTED_AS.get(key, key)
        if isinstance(value, dict):
            yield from _numbers(value, f"{name}.")
        elif isinstance(value, float):
            yield name, value
            yield f"{name}.value", value  # where it may be a texture


def coated_mesh(face: "trimesh.Trimesh", bsdf: dict[str, Any]) -> Any:
    """Return the coated face (vertices in world mm, smooth vertex normals) as `mi.Mesh`."""
    return mitsuba_mesh(COATED_FACE, face.vertices, face.faces, bsdf, normals=face.vertex_normals)
