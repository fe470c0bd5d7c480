"""The pressed elastomer: pressure, force and the coated face."""

from twin.mechanics.errors import PressError, SolverError
from twin.mechanics.hardness import ModulusEstimate, estimate_modulus, young_modulus
from twin.mechanics.press import PressedElastomer, press
from twin.mechanics.relief import face_mesh, face_normals
from twin.mechanics.storage import read_press, write_mesh, write_press
from twin.mechanics.transfer import opposite_transfer
from twin.mechanics.validity import Validity

__all__ = [
    "ModulusEstimate",
    "PressError",
    "PressedElastomer",
    "SolverError",
    "Validity",
    "estimate_modulus",
    "face_mesh",
    "face_normals",
    "opposite_transfer",
    "press",
    "read_press",
    "write_mesh",
    "write_press",
    "young_modulus",
]
