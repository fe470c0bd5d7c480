"""Importer of ROS `camera_info` files: one file per device, lengths in metres.

It reads the files of camera_calibration (camera_matrix, ...) and echoed messages
sensor_msgs/CameraInfo (K, D, R, P; ROS 2: k, d, r, p). R and P of both devices together give the
pose of a rectified pair.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import CaptureError
from reconstruction.rig.importers import IMPORTERS, Importer, head_of
from reconstruction.rig.storage import numbers_of_tree, read_yaml

_NAMES = {
    "camera_matrix": ("camera_matrix", "k"),
    "distortion_coefficients": ("distortion_coefficients", "d"),
    "rectification_matrix": ("rectification_matrix", "r"),
    "projection_matrix": ("projection_matrix", "p"),
    "image_width": ("image_width", "width"),
    "image_height": ("image_height", "height"),
}
_MODELS = ("plumb_bob", "rational_polynomial")
_MARKS = (r"(?m)^distortion_model:", r"(?mi)^(camera_matrix|K):")


class Ros(Importer):
    """Importer of YAML files of camera_calibration and of echoed CameraInfo messages."""

    name = "ros"
    unit = "m"
    summary = "ROS camera_info (camera_matrix, distortion_model, projection_matrix), one per device"

    def recognises(self, path: Path) -> bool:
        """Return True if the file has a distortion model and a camera matrix at its top level."""
        return all(re.search(mark, head_of(path)) for mark in _MARKS)

    def read(self, path: Path) -> dict[str, FloatArray]:
        """Return the numbers by the names of camera_calibration."""
        tree = read_yaml(path, is_first=True)
        _require_model(path, tree.get("distortion_model"))
        numbers = {name.lower(): values for name, values in numbers_of_tree(tree).items()}
        result = {
            name: next(numbers[form] for form in forms if form in numbers)
            for name, forms in _NAMES.items()
            if numbers.keys() & set(forms)
        }
        # An empty list of coefficients is a lens without distortion.
        result.setdefault("distortion_coefficients", np.zeros(5))
        return result


def _require_model(path: Path, model: Any) -> None:
    if model not in (*_MODELS, "", None):
        raise CaptureError(
            f"{path}: distortion_model is {model}, allowed {' or '.join(_MODELS)}; calibrate with "
            "one of these"
        )


IMPORTERS.register(Ros())
