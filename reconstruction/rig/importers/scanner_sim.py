"""Importer of scanner-sim's camera_geometry.json and projector_geometry.json (Koch et al. 2021).

Both files have the same names. That of the projector also has its position in the camera's frame
("origin", mm) and, as the rows of "basis", its axes. Projector pixels are measured from the corner
of the first one, whose centre therefore is (0.5, 0.5); camera pixels from the centre.
"""

from pathlib import Path

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import CaptureError
from reconstruction.rig.importers import IMPORTERS, head_of
from reconstruction.rig.importers.json_file import Json

_POSE = {"origin", "basis"}
_WIDTH, _HEIGHT = "image_width, pixels", "image_height, pixels"
_SIZES = {"mtx": (3, 3), "origin": (3,), "basis": (3, 3)}


class ScannerSim(Json):
    """Importer of the JSON files of scanner-sim, one of the camera and one of the projector."""

    name = "scanner_sim"
    is_general = False
    unit = "mm"
    summary = "scanner-sim's camera_geometry.json and projector_geometry.json"

    def recognises(self, path: Path) -> bool:
        """Return True if the file is JSON with a matrix, its fit and the image size in pixels."""
        names = ('"mtx"', '"new_mtx"', f'"{_WIDTH}"')
        return super().recognises(path) and all(name in head_of(path) for name in names)

    def read(self, path: Path) -> dict[str, FloatArray]:
        """Return the numbers by name after that of the device, and the pose as R and T."""
        numbers = super().read(path)
        for name, shape in _SIZES.items():
            if name in numbers and numbers[name].shape != shape:
                raise CaptureError(
                    f"{path}: {name} has shape {numbers[name].shape}, allowed {shape}"
                )
        is_projector = numbers.keys() >= _POSE
        device = "projector" if is_projector else "camera"
        first_px = 0.5 if is_projector else 0.0
        result = {
            f"{device}/matrix": numbers["mtx"] - first_px * np.eye(3, k=2)[[0, 0, 2]] * [0, 0, 1],
            f"{device}/distortion": numbers.get("dist", np.zeros(5)),
            f"{device}/size": np.array([numbers[_WIDTH], numbers[_HEIGHT]]),
        }
        if is_projector:
            result["R"] = numbers["basis"]
            result["T"] = -numbers["basis"] @ numbers["origin"]
        return result


IMPORTERS.register(ScannerSim())
