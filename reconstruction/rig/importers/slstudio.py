"""Importer of SLStudio's calibration.xml (Wilm et al. 2014); R and T lead from camera to projector.

The names of camera matrix and distortion differ by case only.
"""

from types import MappingProxyType

from reconstruction.rig.importers import IMPORTERS
from reconstruction.rig.importers.opencv import NamedStorage


class SLStudio(NamedStorage):
    """Importer of the XML files that SLStudio saves."""

    name = "slstudio"
    summary = "SLStudio's calibration.xml (Kc, kc, Kp, kp, Rp, Tp)"
    keys = MappingProxyType(
        {
            "camera_matrix": "Kc",
            "camera_distortion": "kc",
            "camera_width": "frameWidth",
            "camera_height": "frameHeight",
            "projector_matrix": "Kp",
            "projector_distortion": "kp",
            "projector_width": "screenResX",
            "projector_height": "screenResY",
            "rotation": "Rp",
            "translation": "Tp",
        }
    )


IMPORTERS.register(SLStudio())
