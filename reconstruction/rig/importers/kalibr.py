"""Importer of Kalibr's camchain.yaml: cam0 and cam1, lengths in metres.

T_cn_cnm1 of cam1 maps coordinates in cam0 to coordinates in cam1.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import CaptureError
from reconstruction.rig.importers import IMPORTERS, Importer, head_of
from reconstruction.rig.storage import numbers_of_tree, read_yaml

_MODELS = ("radtan", "none")
_DEVICES = {"cam0": "camera", "cam1": "projector"}


class Kalibr(Importer):
    """Importer of camera chains of two pinhole devices: cam0 the camera, cam1 the projector."""

    name = "kalibr"
    unit = "m"
    summary = "Kalibr's camchain.yaml (cam0, cam1, T_cn_cnm1)"

    def recognises(self, path: Path) -> bool:
        """Return True if the file has a key cam0 at its top level."""
        return re.search(r"(?m)^cam0:\s*$", head_of(path)) is not None

    def read(self, path: Path) -> dict[str, FloatArray]:
        """Return the numbers of cam0 as `camera/...`, those of cam1 as `projector/...`."""
        tree = read_yaml(path)
        missing = [name for name in _DEVICES if not isinstance(tree.get(name), dict)]
        if missing:
            raise CaptureError(
                f"{path}: {', '.join(missing)} is missing; a rig needs cam0 (camera) and cam1 "
                "(projector)"
            )
        return {
            key: values
            for name, device in _DEVICES.items()
            for key, values in _device(f"{path}: {name}", device, tree[name])
        }


def _device(where: str, device: str, tree: dict[str, Any]) -> Iterator[tuple[str, FloatArray]]:
    for key, allowed in (("camera_model", ("pinhole",)), ("distortion_model", _MODELS)):
        if tree.get(key) not in allowed:
            raise CaptureError(
                f"{where}: {key} is {tree.get(key)}, allowed {' or '.join(allowed)}; calibrate "
                "with pinhole-radtan"
            )
    numbers = numbers_of_tree(tree)
    if "intrinsics" not in numbers or numbers["intrinsics"].size != 4:
        raise CaptureError(f"{where}: intrinsics are no list fu, fv, pu, pv")
    fu, fv, pu, pv = numbers["intrinsics"].ravel()
    yield f"{device}/camera_matrix", np.array([[fu, 0, pu], [0, fv, pv], [0, 0, 1.0]])
    yield f"{device}/distortion", numbers.get("distortion_coeffs", np.zeros(5))
    if "resolution" in numbers:
        yield f"{device}/resolution", numbers["resolution"]
    if device == "projector" and "T_cn_cnm1" in numbers:
        yield "T_cn_cnm1", numbers["T_cn_cnm1"]


IMPORTERS.register(Kalibr())
