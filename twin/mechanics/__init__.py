"""Press a rigid specimen into the elastomer: pressure, force and shape of the coated face."""

from twin.mechanics.choice import check_press, press_with
from twin.mechanics.contact_transfer import (
    ContactTransfer,
    contact_transfer,
    ridge_height_mm,
    ridge_transfer,
)
from twin.mechanics.errors import PressError, SolverError
from twin.mechanics.hardness import (
    ModulusEstimate,
    calibrate_modulus,
    estimate_modulus,
    estimate_modulus_00,
    young_modulus,
)
from twin.mechanics.press import PressedElastomer, ShearFields, SheetFields, fields_at, press
from twin.mechanics.relief import face_mesh, face_normals, slab_mesh
from twin.mechanics.storage import read_press, write_in_plane, write_mesh, write_press
from twin.mechanics.texture import (
    Field,
    in_plane_displacement,
    material_points,
    texture_field,
    texture_figures,
    textured,
)
from twin.mechanics.transfer import opposite_transfer
from twin.mechanics.validity import Validity

__all__ = [
    "ContactTransfer",
    "Field",
    "ModulusEstimate",
    "PressError",
    "PressedElastomer",
    "ShearFields",
    "SheetFields",
    "SolverError",
    "Validity",
    "calibrate_modulus",
    "check_press",
    "contact_transfer",
    "estimate_modulus",
    "estimate_modulus_00",
    "face_mesh",
    "face_normals",
    "fields_at",
    "in_plane_displacement",
    "material_points",
    "opposite_transfer",
    "press",
    "press_with",
    "read_press",
    "ridge_height_mm",
    "ridge_transfer",
    "slab_mesh",
    "texture_field",
    "texture_figures",
    "textured",
    "write_in_plane",
    "write_mesh",
    "write_press",
    "young_modulus",
]
