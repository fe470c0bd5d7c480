"""What an object behind the coat adds to its reflectance: a thin ink lets some light through.

Of the light on the ink the share R comes back from its pigment and T passes. An object that touches
it throws the share r of that back, again and again between the two (Kubelka and Munk 1931, a layer
on a ground; G. Kortuem, Reflectance Spectroscopy, Springer 1969):

    R_contact = R + T^2 r / (1 - R r)

Where nothing touches the ink, what passes is lost. Seen by cameras that look at the touched coat
itself, the contact-face layout: behind the coat of a sheet lies the sheet.
"""

from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from reconstruction.arrays import FloatArray
from twin.config.models import (
    Coating,
    Conductor,
    Dielectric,
    Diffuse,
    Experiment,
    Material,
    Plastic,
)
from twin.mechanics import PressedElastomer, face_mesh
from twin.optics.materials import INK_ALBEDO

if TYPE_CHECKING:
    import trimesh


def reflectance_behind(material: Material | None) -> float:
    """Return the share of light that an object throws back into the ink; 0 without material.

    Metals and clear bodies by Fresnel at normal incidence against air (a clear body by both faces,
    without absorption), matte ones and plastics by their albedo: a film of air or wax between ink
    and object, and slant light, move it by less than it is known.
    """
    match material:
        case Conductor():
            return _fresnel(material.ior, material.extinction)
        case Dielectric():
            once = _fresnel(material.ior, 0.0)
            return 2.0 * once / (1.0 + once)
        case Diffuse() | Plastic():
            return material.albedo
        case None:
            return 0.0


def contact_albedo(coating: Coating, material: Material | None) -> float:
    """Return the share of light that the ink reflects with an object of a material behind it."""
    ink, behind = coating.base_albedo, reflectance_behind(material)
    return ink + coating.transmittance**2 * behind / (1.0 - ink * behind)


def seen_face(experiment: Experiment, pressed: PressedElastomer) -> "trimesh.Trimesh":
    """Return the coated face as `face_mesh`; where the ink lets light through with `INK_ALBEDO`."""
    face, albedo = face_mesh(pressed), ink_albedo(experiment, pressed)
    if albedo is not None:
        face.vertex_attributes[INK_ALBEDO] = albedo
    return face


def ink_albedo(experiment: Experiment, pressed: PressedElastomer) -> FloatArray | None:
    """Return the ink's albedo at the vertices of the coated face, (vertex,); None: alike all over.

    A specimen without material is taken for the one of the reference balls. Of a group, and of a
    scene of parts, the whole contact has the specimen's own material.
    """
    coating = experiment.coating
    if not coating.transmittance or experiment.elastomer.layout != "contact_face":
        return None
    material = experiment.specimen.material or experiment.photometric.presses.material
    brighter = contact_albedo(coating, material) - coating.base_albedo
    return np.asarray(coating.base_albedo + brighter * _contact_share(pressed).ravel())


def _contact_share(pressed: PressedElastomer) -> FloatArray:
    """Return the share of contact round each node of the coated face, (row, col)."""
    share = RegularGridInterpolator(
        (pressed.y_mm, pressed.x_mm),
        pressed.contact.astype(np.float64),
        bounds_error=False,
        fill_value=0.0,
    )
    y_mm, x_mm = np.meshgrid(pressed.face_y_mm, pressed.face_x_mm, indexing="ij")
    return np.asarray(share(np.stack([y_mm, x_mm], axis=-1)))


def _fresnel(n: float, k: float) -> float:
    return ((n - 1.0) ** 2 + k**2) / ((n + 1.0) ** 2 + k**2)
