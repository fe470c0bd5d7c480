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

_WIDTH, _HEIGHT = "image_width, pixels", "image_height, pixels"
_LENS: dict[str, tuple[int, ...]] = {"mtx": (3, 3), "dist": (5,), _WIDTH: (), _HEIGHT: ()}
_POSE: dict[str, tuple[int, ...]] = {"origin": (3,), "basis": (3, 3)}


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
        is_projector = numbers.keys() >= _POSE.keys()
        for name, shape in (_LENS | _POSE if is_projector else _LENS).items():
            stored = numbers[name].shape if name in numbers else "none"
            if stored != shape:
                raise CaptureError(f"{path}: {name}: found shape {stored}, allowed {shape}")
        device, first_px = ("projector", 0.5) if is_projector else ("camera", 0.0)
        from_corner = np.array([[0.0, 0.0, first_px], [0.0, 0.0, first_px], [0.0, 0.0, 0.0]])
        result = {
            f"{device}/matrix": numbers["mtx"] - from_corner,
            f"{device}/distortion": numbers["dist"],
            f"{device}/size": np.array([numbers[_WIDTH], numbers[_HEIGHT]]),
        }
        if is_projector:
            result |= {"R": numbers["basis"], "T": -numbers["basis"] @ numbers["origin"]}
        return result


IMPORTERS.register(ScannerSim())
