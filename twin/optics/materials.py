"""Build Mitsuba meshes and textures, and change the numbers of a BSDF."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import FloatImage

if TYPE_CHECKING:
    import trimesh

    from twin.mechanics.relief import FaceGrid


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
    bsdf : dictionary for `mi.load_dict`; None: Mitsuba's default
    normals : (vertex, xyz) float; unit normals of a smooth surface; None: the surface is faceted
    texture : (vertex, 2) float; coordinates on the bitmap, 0 to 1
    shade : (vertex,) float; values of the vertex attribute `vertex_shade`
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
    """Return an image (row, col) as a texture for `mi.load_dict`, interpolated between texels."""
    import mitsuba as mi

    return {
        "type": "bitmap",
        "bitmap": mi.Bitmap(np.ascontiguousarray(light[..., None], np.float32)),
        "raw": True,  # the numbers are light, not sRGB
        "format": "variant",  # float32, not half precision
        "filter_type": "bilinear",
        "wrap_mode": "clamp",
    }


COATED_FACE = "coated_face"
"""Name of the coated mesh in every scene that has one."""

INK_ALBEDO = "ink_albedo"
"""Attribute of a face's vertices, (vertex,): the ink's albedo, higher with an object behind it."""

SHADE = {"type": "mesh_attribute", "name": "vertex_shade"}
"""Texture of a mesh's attribute `vertex_shade`."""

# Names of `mi.traverse` that differ from those of `mi.load_dict`.
_LISTED_AS = {"int_ior": "eta"}


def updated(face: Any, bsdf: dict[str, Any], before: dict[str, Any]) -> bool:
    """Set the numbers of a mesh's BSDF; return False if a changed number cannot be set.

    Parameters
    ----------
    face : `mi.Mesh`
    bsdf : dictionary with the numbers that are set
    before : dictionary of the present BSDF, with the same structure as `bsdf`
    """
    import mitsuba as mi

    parameters, present = mi.traverse(face.bsdf()), dict(bsdf_numbers(before))
    for name, value in bsdf_numbers(bsdf):
        listed = listed_as(name, parameters)
        if listed is not None:
            parameters[listed] = value
        elif value != present[name]:
            return False
    parameters.update()
    return True


def structure_of(bsdf: dict[str, Any]) -> dict[str, Any]:
    """Return a BSDF's dictionary with the type `float` in place of each floating-point number."""
    return {
        key: structure_of(value) if isinstance(value, dict) else _without_number(value)
        for key, value in bsdf.items()
    }


def _without_number(value: Any) -> Any:
    return float if isinstance(value, float) else value


def bsdf_numbers(bsdf: dict[str, Any], above: str = "") -> Iterator[tuple[str, float]]:
    """Yield the name and the value of each number in a BSDF's dictionary.

    The names are those of `mi.traverse`; `above` is the prefix of nested dictionaries.
    """
    for key, value in bsdf.items():
        name = above + _LISTED_AS.get(key, key)
        if isinstance(value, dict):
            yield from bsdf_numbers(value, f"{name}.")
        elif isinstance(value, float):
            yield name, value


def listed_as(name: str, parameters: Any) -> str | None:
    """Return the key in `parameters` of a number or of its texture; None if it has no key.

    Parameters
    ----------
    name : of the number, as in `bsdf_numbers`
    parameters : result of `mi.traverse`
    """
    return next((key for key in (name, f"{name}.value") if key in parameters), None)


def coated_mesh(
    face: "trimesh.Trimesh | FaceGrid", bsdf: dict[str, Any], texture: ArrayLike | None = None
) -> Any:
    """Return the coated face (vertices in world mm, smooth vertex normals) as `mi.Mesh`.

    The vertex attribute `INK_ALBEDO` of the face, if present, is `vertex_shade` of the `mi.Mesh`.

    Parameters
    ----------
    texture : (vertex, 2) float; texture coordinates; None: no texture of `bsdf` needs them
    """
    return mitsuba_mesh(
        COATED_FACE,
        face.vertices,
        face.faces,
        bsdf,
        normals=face.vertex_normals,
        texture=texture,
        shade=face.vertex_attributes.get(INK_ALBEDO),
    )
