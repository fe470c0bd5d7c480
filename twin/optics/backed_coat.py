"""Where an object behind the coat shows through a thin ink.

Where nothing touches the ink, what passes is lost. Seen by cameras that look at the touched coat
itself, the contact-face layout: behind the coat of a sheet lies the sheet.
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
    alone = experiment.coating.albedo_over(0.0)
    if alone is None or experiment.elastomer.layout != "contact_face":
        return None
    # A film of air or wax between ink and object, and slant light, move the object's reflectance
    # by less than it is known.
    material = experiment.specimen.material or experiment.photometric.presses.material
    reflectance = 0.0 if material is None else material.normal_reflectance
    touched = experiment.coating.albedo_over(reflectance)
    assert touched is not None  # whether an ink is opaque is its own, not the object's
    return np.asarray(alone + (touched - alone) * _contact_share(pressed).ravel())


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
