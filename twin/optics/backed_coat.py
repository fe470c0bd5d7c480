"""Reflectance of a thin, translucent ink with an object in contact behind it.

Without contact, the light that the ink transmits is lost. The effect exists only in the
contact-face layout, in which the object touches the coat. In the sheet layouts, the sheet separates
the coat from the object.
"""

from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from reconstruction.arrays import FloatArray
from twin.config.models import Experiment
from twin.mechanics import PressedElastomer, face_mesh, material_points
from twin.mechanics.relief import MATERIAL_MM
from twin.optics.materials import INK_ALBEDO

if TYPE_CHECKING:
    import trimesh


def seen_face(experiment: Experiment, pressed: PressedElastomer) -> "trimesh.Trimesh":
    """Return the mesh of the coated face, world mm, for the renderer.

    If the ink is translucent, the mesh has the vertex attribute `INK_ALBEDO`; if dots are printed
    on the coat, it has `MATERIAL_MM`.
    """
    face, albedo = material_face(experiment, pressed), ink_albedo(experiment, pressed)
    if albedo is not None:
        face.vertex_attributes[INK_ALBEDO] = albedo
    return face


def material_face(experiment: Experiment, pressed: PressedElastomer) -> "trimesh.Trimesh":
    """Return the mesh of the coated face, world mm, with `MATERIAL_MM` if dots are printed."""
    face = face_mesh(pressed)
    if experiment.photometric.markers is not None:
        material = material_points(pressed, experiment.elastomer, experiment.press)
        face.vertex_attributes[MATERIAL_MM] = np.stack([of.ravel() for of in material], axis=-1)
    return face


def ink_albedo(experiment: Experiment, pressed: PressedElastomer) -> FloatArray | None:
    """Return the ink's albedo at each vertex of the coated face, (vertex,); None if it is uniform.

    If the specimen has no material, the material of the reference balls is assumed. A specimen of
    several parts is assumed to have the material `specimen.material` in the whole contact.
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
    """Return the share of contact (0 to 1) at each node of the coated face, (row, col).

    The share is interpolated from the contact map of the press and is 0 outside this map.
    """
    share = RegularGridInterpolator(
        (pressed.y_mm, pressed.x_mm),
        pressed.contact.astype(np.float64),
        bounds_error=False,
        fill_value=0.0,
    )
    y_mm, x_mm = np.meshgrid(pressed.face_y_mm, pressed.face_x_mm, indexing="ij")
    return np.asarray(share(np.stack([y_mm, x_mm], axis=-1)))
