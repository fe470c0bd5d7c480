"""Reflectance of a thin, translucent ink with an object in contact behind it.

Without contact, the light that the ink transmits is lost. The effect exists in the contact-face
layout only, in which the object touches the coat; behind the coat of a sheet is the sheet.
"""

from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from reconstruction.arrays import FloatArray
from twin.config.models import Experiment
from twin.mechanics import PressedElastomer, face_mesh
from twin.optics.materials import INK_ALBEDO

if TYPE_CHECKING:
    import trimesh


def seen_face(experiment: Experiment, pressed: PressedElastomer) -> "trimesh.Trimesh":
    """Return the coated face as `face_mesh`, with `INK_ALBEDO` if the ink is translucent."""
    face, albedo = face_mesh(pressed), ink_albedo(experiment, pressed)
    if albedo is not None:
        face.vertex_attributes[INK_ALBEDO] = albedo
    return face


def ink_albedo(experiment: Experiment, pressed: PressedElastomer) -> FloatArray | None:
    """Return the ink's albedo at the vertices of the coated face, (vertex,); None: uniform.

    A specimen without material has that of the reference balls. Groups and scenes of parts have the
    specimen's own material in the whole contact.
    """
    bare = experiment.coating.albedo_over(0.0)
    if bare is None or experiment.elastomer.layout != "contact_face":
        return None
    # A film of air or wax between ink and object, and oblique incidence, change the object's
    # reflectance by less than its uncertainty.
    material = experiment.specimen.material or experiment.photometric.presses.material
    reflectance = 0.0 if material is None else material.normal_reflectance
    touched = experiment.coating.albedo_over(reflectance)
    assert touched is not None  # opacity is a property of the ink, not of the object
    return np.asarray(bare + (touched - bare) * _contact_share(pressed).ravel())


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
