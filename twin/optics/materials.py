"""Surfaces as Mitsuba has them: materials and the coating as BSDFs, and meshes.

A surface whose reflection or refraction is sharp cannot be connected to a pinhole projector from a
surface behind it: that light is traced from the projector instead (see `photons`).

The coating is gray ink with aluminium flakes: fraction `1 - flake_fraction` of the surface is ink,
the rest a rough conductor (GGX). The ink is a diffuse pigment, bare or under a clear binder whose
rough face reflects by Fresnel; pigment and binder exchange light until it has left (J. L.
Saunderson, J. Opt. Soc. Am. 32, 727 (1942)), so a binder darkens the pigment. A convex blend of
lobes that each reflect at most all light: energy conserving by construction.

Left out: flakes below the binder's face (they lie bare), and light scattered more than once by one
rough face (it is lost, as in all single-scattering microfacet models). A white pigment shows what
is lost: with a binder of index 1.5 and roughness 0.02, 0.1, 0.2, 0.3 it throws back 3, 9, 20, 31 %
too little facing the camera, 2, 12, 24, 36 % at 80 deg and up to 11, 13, 25, 40 % at 89 deg.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, assert_never

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import FloatImage
from twin.config.models import Coating, Conductor, Dielectric, Diffuse, Material, Plastic

if TYPE_CHECKING:
    import trimesh


SHARP_BELOW_ROUGHNESS = 0.3
"""Metals below this GGX alpha throw light that only photons find without fireflies: the lobe's
peak is 1 / (pi alpha^2), 3.5 here and 127 at 0.05."""


def sharp(material: Material) -> bool:
    """Tell whether light that this surface throws on others is traced from the projector."""
    if isinstance(material, Conductor):
        return material.roughness < SHARP_BELOW_ROUGHNESS
    return isinstance(material, Dielectric)


def absorption_per_mm(material: Material) -> float:
    """Napierian absorption coefficient of the bulk; 0 where no light gets in."""
    return material.absorption_per_mm if isinstance(material, Dielectric) else 0.0


def mitsuba_mesh(
    name: str,
    vertices_mm: ArrayLike,
    facets: ArrayLike,
    bsdf: dict[str, Any] | None = None,
    *,
    normals: ArrayLike | None = None,
    texture: ArrayLike | None = None,
    shade: ArrayLike | None = None,
) -> Any:
    """Return a triangle mesh as `mi.Mesh`.

    Parameters
    ----------
    vertices_mm : (vertex, xyz) float, mm, world
    facets : (facet, 3) int, indices of vertices
    bsdf : for `mi.load_dict`
    normals : (vertex, xyz) float; unit normals of a smooth surface; faceted without
    texture : (vertex, 2) float; coordinates on the bitmap
    shade : (vertex,) float; the attribute `vertex_shade`
    """
    import mitsuba as mi

    properties = mi.Properties()
    properties.set_id(name)
    if bsdf is not None:
        properties["bsdf"] = mi.load_dict(bsdf)
    fields = {"vertex_positions": vertices_mm}
    fields |= {} if normals is None else {"vertex_normals": normals}
    fields |= {} if texture is None else {"vertex_texcoords": texture}
    mesh = mi.Mesh(
        name,
        vertex_count=len(np.asarray(vertices_mm)),
        face_count=len(np.asarray(facets)),
        has_vertex_normals=normals is not None,
        has_vertex_texcoords=texture is not None,
        props=properties,
    )
    if shade is not None:
        mesh.add_attribute("vertex_shade", 1, np.asarray(shade).tolist())
    parameters = mi.traverse(mesh)
    for key, values in fields.items():
        parameters[key] = np.asarray(values, np.float32).ravel()
    parameters["faces"] = np.asarray(facets, np.uint32).ravel()
    parameters.update()
    return mesh


def bitmap(light: FloatImage) -> dict[str, Any]:
    """Return numbers (row, col) as a texture for `mi.load_dict`, interpolated between texels."""
    import mitsuba as mi

    return {
        "type": "bitmap",
        "bitmap": mi.Bitmap(np.ascontiguousarray(light[..., None], np.float32)),
        "raw": True,  # the numbers are light, not sRGB
        "format": "variant",  # float32, not half precision
        "filter_type": "bilinear",
        "wrap_mode": "clamp",
    }


def bsdf_of(material: Material) -> dict[str, Any]:
    """Return the dictionary of a material's BSDF for `mi.load_dict`."""
    match material:
        case Conductor():
            eta, k = level(material.ior), level(material.extinction)
            return _microfacets("conductor", material.roughness, eta=eta, k=k)
        case Dielectric():
            index = {"int_ior": material.ior, "ext_ior": 1.0}
            return _microfacets("dielectric", material.roughness, **index)
        case Diffuse():
            return {"type": "diffuse", "reflectance": level(material.albedo)}
        case Plastic():
            index, pigment = {"int_ior": material.ior, "ext_ior": 1.0}, level(material.albedo)
            return _microfacets("plastic", material.roughness, **index, diffuse_reflectance=pigment)
    assert_never(material)


def _microfacets(kind: str, roughness: float, **index: Any) -> dict[str, Any]:
    """Return a smooth surface of a kind, or its rough form with GGX microfacets."""
    if roughness == 0.0:
        return {"type": kind, **index}
    return {"type": f"rough{kind}", "distribution": "ggx", "alpha": roughness, **index}


def level(value: float) -> dict[str, Any]:
    """Return a number as a spectrum: what `mi.load_dict` would take for a colour otherwise."""
    return {"type": "spectrum", "value": value}


COATED_FACE = "coated_face"
"""Name of the coated mesh in every scene that holds one."""

INK_ALBEDO = "ink_albedo"
"""Attribute of a face's vertices, (vertex,): where an object shows through the ink it is higher."""

# What `mi.traverse` calls otherwise than `mi.load_dict`.
_LISTED_AS = {"ink": "bsdf_0", "flakes": "bsdf_1", "int_ior": "eta"}


def coating_bsdf(coating: Coating, *, shaded: bool = False) -> dict[str, Any]:
    """Return the dictionary of the blend for `mi.load_dict`.

    Parameters
    ----------
    shaded : the ink's albedo is the mesh's attribute `vertex_shade`, not the coating's
    """
    pigment = {"type": "mesh_attribute", "name": "vertex_shade"}
    return {
        "type": "blendbsdf",
        "weight": coating.flake_fraction,
        "ink": _ink(coating, pigment if shaded else level(coating.base_albedo)),
        "flakes": _microfacets(
            "conductor",
            coating.flake_roughness,
            eta=level(coating.flake_ior),
            k=level(coating.flake_extinction),
        ),
    }


def is_matte(coating: Coating) -> bool:
    """Whether the coating reflects alike into all directions: no flakes, no face of a binder."""
    return coating.flake_fraction == 0.0 and coating.binder_ior == 1.0


def _ink(coating: Coating, pigment: dict[str, Any]) -> dict[str, Any]:
    if coating.binder_ior == 1.0:
        return {"type": "diffuse", "reflectance": pigment}
    return _microfacets(
        "plastic",
        coating.binder_roughness,
        int_ior=coating.binder_ior,
        ext_ior=1.0,
        nonlinear=True,  # inter-reflections below the binder meet the pigment again and again
        diffuse_reflectance=pigment,
    )


def set_coating(scene: Any, coating: Coating) -> None:
    """Give the coated face of a loaded scene another coating; its geometry stays.

    Parameters
    ----------
    scene : holds a mesh named `COATED_FACE`, as `coated_scene` makes it
    coating : any: new numbers are parameter updates that keep the compiled kernel. Between a matte
        ink and one with a binder the BSDF is exchanged, which compiles one kernel more.

    Raises
    ------
    ValueError : the scene has no coated face
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


def coating_numbers(coating: Coating) -> Iterator[tuple[str, float]]:
    """Yield the numbers of a coat's BSDF under the names that `mi.traverse` may list them."""
    yield from _numbers(coating_bsdf(coating))


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
    """Return the coated face (vertices in world mm, smooth vertex normals) as `mi.Mesh`.

    Its attribute `INK_ALBEDO`, where it has one, is the mesh's `vertex_shade`.
    """
    return mitsuba_mesh(
        COATED_FACE,
        face.vertices,
        face.faces,
        bsdf,
        normals=face.vertex_normals,
        shade=face.vertex_attributes.get(INK_ALBEDO),
    )
