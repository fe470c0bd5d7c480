"""Surfaces as Mitsuba has them: materials as BSDFs, and meshes; how their light is transported.

A surface whose reflection or refraction is sharp cannot be connected to a pinhole projector from a
surface behind it: that light is traced from the projector instead (see `photons`).
"""

from typing import Any, assert_never

import numpy as np
from numpy.typing import ArrayLike

from twin.config.models import Conductor, Dielectric, Diffuse, Material, Plastic

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
    bsdf : dict, optional
        For `mi.load_dict`.
    normals : (vertex, xyz) float, optional
        Unit normals of a smooth surface; faceted without.
    texture : (vertex, 2) float, optional
        Coordinates on the bitmap.
    shade : (vertex,) float, optional
        The attribute `vertex_shade`.
    """
    import mitsuba as mi

    properties = mi.Properties()
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


def bsdf_of(material: Material) -> dict[str, Any]:
    """Return the dictionary of a material's BSDF for `mi.load_dict`."""
    match material:
        case Conductor():
            return _conductor(material)
        case Dielectric():
            return _dielectric(material)
        case Diffuse():
            return {"type": "diffuse", "reflectance": _level(material.albedo)}
        case Plastic():
            return {
                "type": "roughplastic",
                "distribution": "ggx",
                "alpha": material.roughness,
                "int_ior": material.ior,
                "ext_ior": 1.0,
                "diffuse_reflectance": _level(material.albedo),
            }
    assert_never(material)


def _conductor(material: Conductor) -> dict[str, Any]:
    index = {"eta": _level(material.ior), "k": _level(material.extinction)}
    if material.roughness == 0.0:
        return {"type": "conductor", **index}
    return {
        "type": "roughconductor",
        "distribution": "ggx",
        "alpha": material.roughness,
        **index,
    }


def _dielectric(material: Dielectric) -> dict[str, Any]:
    index = {"int_ior": material.ior, "ext_ior": 1.0}
    if material.roughness == 0.0:
        return {"type": "dielectric", **index}
    return {
        "type": "roughdielectric",
        "distribution": "ggx",
        "alpha": material.roughness,
        **index,
    }


def _level(value: float) -> dict[str, Any]:
    return {"type": "spectrum", "value": value}
