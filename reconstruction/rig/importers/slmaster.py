"""Importer of SLMaster's caliInfo.yml: the left camera (1) with the projector (4).

The file has the camera's image size, but not the projector's.
"""

from types import MappingProxyType

from reconstruction.rig.importers import IMPORTERS
from reconstruction.rig.importers.opencv import NamedStorage


class SLMaster(NamedStorage):
    """Importer of the YAML files that SLMaster saves of a camera and a projector."""

    name = "slmaster"
    summary = "SLMaster's caliInfo.yml (M1, D1, M4, D4, Rlp, Tlp)"
    keys = MappingProxyType(
        {
            "camera_matrix": "M1",
            "camera_distortion": "D1",
            "camera_size": "S",
            "projector_matrix": "M4",
            "projector_distortion": "D4",
            "rotation": "Rlp",
            "translation": "Tlp",
        }
    )


IMPORTERS.register(SLMaster())
