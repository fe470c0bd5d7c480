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

from twin.config.models import Coating
from twin.optics.materials import mitsuba_mesh

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
    values, parameters = _parameters(coating), mi.traverse(face.bsdf())
    if any(name not in parameters for name in values):
        face.set_bsdf(mi.load_dict(coating_bsdf(coating)))
        return
    for name, value in values.items():
        parameters[name] = value
    parameters.update()


def _parameters(coating: Coating) -> dict[str, float]:
    """Values by the names under which `mi.traverse` lists those of `coating_bsdf`."""
    values = {
        "weight.value": coating.flake_fraction,
        "bsdf_1.alpha.value": coating.flake_roughness,
        "bsdf_1.eta.value": coating.flake_ior,
        "bsdf_1.k.value": coating.flake_extinction,
    }
    if coating.binder_ior == 1.0:
        return values | {"bsdf_0.reflectance.value": coating.base_albedo}
    return values | {
        "bsdf_0.diffuse_reflectance.value": coating.base_albedo,
        "bsdf_0.alpha": coating.binder_roughness,
        "bsdf_0.eta": coating.binder_ior,
    }


def coated_mesh(face: "trimesh.Trimesh", bsdf: dict[str, Any]) -> Any:
    """Return the coated face (vertices in world mm, smooth vertex normals) as `mi.Mesh`."""
    return mitsuba_mesh(COATED_FACE, face.vertices, face.faces, bsdf, normals=face.vertex_normals)
