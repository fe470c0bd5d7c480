"""Printed dots in scenes of stock Mitsuba: a blend of the coat with black, by a texture.

The texture is one cell of the lattice, repeated over the material coordinates of the face, which
are the texture coordinates of its vertices. With the weight w of black, the BSDF is 1 - w times
that of the coat, as in `twin.optics.printed_dots`.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from reconstruction.arrays import FloatArray, FloatImage
from twin.config.lamps import Markers
from twin.mechanics.relief import MATERIAL_MM
from twin.optics.bsdfs import level
from twin.optics.materials import bitmap

if TYPE_CHECKING:
    import trimesh

    from twin.mechanics.relief import FaceGrid

TEXELS = 512
"""Texels along a side of the lattice cell: an edge is blurred by one of them."""

_REPEATED = {"wrap_mode": "repeat"}


def dot_cell(markers: Markers) -> FloatImage:
    """Return the weight of black over one lattice cell, (row, col) float32, the dot in its middle.

    Texels have the mean over their area, of 4 x 4 points.
    """
    fine = 4 * TEXELS
    across = (np.arange(fine) + 0.5) / fine - 0.5
    x_mm, y_mm = across * markers.pitch_x_mm, across[:, None] * markers.pitch_y_mm
    inside = x_mm**2 + y_mm**2 < markers.radius_mm**2
    share = inside.reshape(TEXELS, 4, TEXELS, 4).mean(axis=(1, 3))
    return np.asarray((1.0 - markers.relative_albedo) * share, np.float32)


def cell_coordinates(markers: Markers, face: "trimesh.Trimesh | FaceGrid") -> FloatArray:
    """Return the texture coordinates (vertex, 2) of a face, in lattice cells."""
    places_mm = np.asarray(face.vertices)[:, :2]
    material_mm = face.vertex_attributes.get(MATERIAL_MM, places_mm)
    return np.asarray(material_mm / (markers.pitch_x_mm, markers.pitch_y_mm) + 0.5)


def cell_texture(markers: Markers) -> dict[str, Any]:
    """Return the weight of black as a texture for `mi.load_dict`."""
    return bitmap(dot_cell(markers)) | _REPEATED


def cell_texture_in_file(name: str) -> dict[str, Any]:
    """Return the weight of black as a texture of a scene file, read from an image beside it."""
    settings = {"raw": True, "format": "variant", "filter_type": "bilinear"}
    return {"type": "bitmap", "filename": name, **settings, **_REPEATED}


def dotted(coat: dict[str, Any], texture: dict[str, Any]) -> dict[str, Any]:
    """Return the BSDF of a coat with dots, for `mi.load_dict`.

    Parameters
    ----------
    texture : weight of black
    """
    black = {"type": "diffuse", "reflectance": level(0.0)}
    return {"type": "blendbsdf", "weight": texture, "bsdf_0": coat, "bsdf_1": black}
