"""Importer of Zivid's intrinsics.yml: CX, CY, FX, FY and K1 to P2 of one device."""

from pathlib import Path

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import CaptureError
from reconstruction.rig.importers import IMPORTERS, Importer, head_of
from reconstruction.rig.storage import numbers_of_tree, read_yaml

_MATRIX = ("FX", "FY", "CX", "CY")
_DISTORTION = ("K1", "K2", "P1", "P2", "K3")
_TOP = "CameraIntrinsics:"


class Zivid(Importer):
    """Importer of the intrinsics that Zivid's SDK saves; size, projector and pose are not in it."""

    name = "zivid"
    summary = "Zivid's intrinsics.yml (CameraIntrinsics), one per device"

    def recognises(self, path: Path) -> bool:
        """Return True if the file contains the key CameraIntrinsics."""
        return _TOP in head_of(path)

    def read(self, path: Path) -> dict[str, FloatArray]:
        """Return camera matrix and distortion in OpenCV's order."""
        numbers = {
            name.removeprefix("CameraIntrinsics/").rpartition("/")[2]: float(values)
            for name, values in numbers_of_tree(read_yaml(path)).items()
            if values.size == 1
        }
        missing = [name for name in (*_MATRIX, *_DISTORTION) if name not in numbers]
        if missing:
            raise CaptureError(f"{path}: {', '.join(missing)} is missing in CameraIntrinsics")
        fx, fy, cx, cy = (numbers[name] for name in _MATRIX)
        return {
            "camera_matrix": np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
            "distortion": np.array([numbers[name] for name in _DISTORTION]),
        }


IMPORTERS.register(Zivid())
