"""Importer of procam-calibration's calibration_result.xml; the program spells rotation "roration".

The file has the camera's image size as (rows, columns), but not the projector's size.
"""

from types import MappingProxyType

from reconstruction.rig.importers import IMPORTERS
from reconstruction.rig.importers.opencv import NamedStorage


class Procam(NamedStorage):
    """Importer of the XML files that kamino410's procam-calibration writes."""

    name = "procam"
    summary = "procam-calibration's calibration_result.xml (cam_int, proj_int, roration)"
    keys = MappingProxyType(
        {
            "camera_matrix": "cam_int",
            "camera_distortion": "cam_dist",
            "camera_shape": "img_shape",
            "projector_matrix": "proj_int",
            "projector_distortion": "proj_dist",
            "rotation": "roration",
            "translation": "translation",
        }
    )


IMPORTERS.register(Procam())
