"""Calibration of camera and projector, and its file in OpenCV's YAML format.

A transform T_a_from_b maps coordinates in frame b to coordinates in frame a, in mm.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import CaptureError, InputError
from reconstruction.rig.layers import PlaneLayers, plane_layers
from reconstruction.rig.pinhole import Pinhole
from reconstruction.rig.storage import read_storage
from reconstruction.writing import write_text

__all__ = ["Calibration", "Pinhole", "read_calibration", "write_calibration"]

DEVICES = ("camera", "projector")
TRANSFORMS = ("T_world_from_cam", "T_world_from_proj")
LAYERS = "layers"
# Least distance between the devices: without a baseline there is no depth information.
LEAST_BASELINE_MM = 1e-3
MOST_MM = 1e6
# Accepts a rotation printed with seven digits.
ROTATION_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class Calibration:
    """Geometry of a rig: intrinsics and poses of camera and projector, and clear layers.

    Parameters
    ----------
    camera, projector : intrinsics
    T_world_from_cam, T_world_from_proj : (4, 4) float, rigid motions, translation in mm
    layers : clear media above the surface, with interfaces z = const of the world; None: air only

    Raises
    ------
    InputError : a transform is not a rigid motion, both devices are at the same position, or a
        device is not above the layers
    """

    camera: Pinhole
    projector: Pinhole
    T_world_from_cam: FloatArray
    T_world_from_proj: FloatArray
    layers: PlaneLayers | None = None

    def __post_init__(self) -> None:
        for name in TRANSFORMS:
            matrix: FloatArray = np.array(getattr(self, name), dtype=np.float64)
            _require_rigid(name, matrix)
            matrix.flags.writeable = False
            object.__setattr__(self, name, matrix)
        baseline = self.T_world_from_proj[:3, 3] - self.T_world_from_cam[:3, 3]
        if not float(np.linalg.norm(baseline)) >= LEAST_BASELINE_MM:
            raise InputError(
                f"camera and projector are {np.linalg.norm(baseline):g} mm apart; allowed "
                f"{LEAST_BASELINE_MM:g} or more: from one place there is no depth information"
            )
        if self.layers is not None:
            self.layers.require_below("camera", float(self.T_world_from_cam[2, 3]))
            self.layers.require_below("projector", float(self.T_world_from_proj[2, 3]))

    @property
    def T_proj_from_cam(self) -> FloatArray:  # noqa: N802 - the frame names of the paper's symbols
        """Transform from the camera's to the projector's frame, (4, 4), translation in mm."""
        motion = np.linalg.solve(self.T_world_from_proj, self.T_world_from_cam)
        return np.asarray(motion, dtype=np.float64)

    @property
    def triangulation_angle_deg(self) -> float:
        """Angle between the directions to camera and projector from the world's origin, degrees."""
        a, b = self.T_world_from_cam[:3, 3], self.T_world_from_proj[:3, 3]
        cosine = float(a @ b / np.linalg.norm(a) / np.linalg.norm(b))
        return float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _require_rigid(name: str, matrix: FloatArray) -> None:
    if matrix.shape != (4, 4) or not bool(np.all(np.isfinite(matrix))):
        raise InputError(f"{name} has shape {matrix.shape}; give (4, 4) finite numbers")
    if not float(np.max(np.abs(matrix[:3, 3]))) <= MOST_MM:
        raise InputError(f"{name} moves by {matrix[:3, 3].tolist()}; allowed up to {MOST_MM:g} mm")
    rotation = matrix[:3, :3]
    deviation = float(np.max(np.abs(rotation.T @ rotation - np.eye(3))))
    if deviation > ROTATION_TOLERANCE or np.linalg.det(rotation) < 0.0:
        raise InputError(
            f"{name} holds no rotation (R^T R differs from 1 by {deviation:.1e}, "
            f"det R = {np.linalg.det(rotation):.6f}; allowed {ROTATION_TOLERANCE:.0e} and +1)"
        )
    if not np.array_equal(matrix[3], (0.0, 0.0, 0.0, 1.0)):
        raise InputError(f"{name} has the last row {matrix[3].tolist()}; it must be 0 0 0 1")


def write_calibration(path: Path | str, calibration: Calibration) -> None:
    """Write a calibration as OpenCV YAML, which `read_calibration` and cv2.FileStorage can read."""
    storage = cv2.FileStorage(".yaml", cv2.FileStorage_WRITE | cv2.FileStorage_MEMORY)
    for name in DEVICES:
        _write_pinhole(storage, name, getattr(calibration, name))
    for name in TRANSFORMS:
        storage.write(name, getattr(calibration, name))
    if calibration.layers is not None:
        _write_layers(storage, calibration.layers)
    write_text(path, storage.releaseAndGetString())


def _write_pinhole(storage: Any, name: str, device: Pinhole) -> None:
    matrix = [[device.fx_px, 0.0, device.cx_px], [0.0, device.fy_px, device.cy_px], [0.0, 0.0, 1.0]]
    storage.startWriteStruct(name, cv2.FileNode_MAP)
    storage.write("image_width", int(device.width_px))
    storage.write("image_height", int(device.height_px))
    storage.write("camera_matrix", np.array(matrix))
    storage.write("distortion_coefficients", np.array(device.distortion).reshape(1, 5))
    storage.endWriteStruct()


def _write_layers(storage: Any, layers: PlaneLayers) -> None:
    storage.startWriteStruct(LAYERS, cv2.FileNode_SEQ)
    for top_mm, ior in zip(layers.tops_mm, layers.iors, strict=True):
        storage.startWriteStruct("", cv2.FileNode_MAP | cv2.FileNode_FLOW)
        storage.write("top_mm", top_mm)
        storage.write("ior", ior)
        storage.endWriteStruct()
    storage.endWriteStruct()


def read_calibration(path: Path | str) -> Calibration:
    """Read a calibration that `write_calibration` or cv2.FileStorage wrote as YAML.

    Raises
    ------
    CaptureError : the file is missing or not YAML, a key is missing, a value has the wrong shape,
        or `Calibration` rejects the values
    """
    tree = read_storage(path)
    try:
        devices = [_read_pinhole(tree, name) for name in DEVICES]
        transforms = [_read_matrix(tree.get(name), name, (4, 4)) for name in TRANSFORMS]
        layers = _read_layers(tree.get(LAYERS))
        return Calibration(devices[0], devices[1], transforms[0], transforms[1], layers)
    except InputError as error:
        raise CaptureError(f"{path}: {error}") from error


def _read_pinhole(tree: Mapping[str, Any], name: str) -> Pinhole:
    node = tree.get(name)
    if not isinstance(node, dict):
        raise InputError(f"key {name} is missing")
    matrix = _read_matrix(node.get("camera_matrix"), f"{name}/camera_matrix", (3, 3))
    _require_camera_matrix(name, matrix)
    coefficients = _read_matrix(
        node.get("distortion_coefficients"), f"{name}/distortion_coefficients", (1, 5)
    )
    k1, k2, p1, p2, k3 = (float(value) for value in coefficients[0])
    ideal = Pinhole(
        width_px=_read_integer(node.get("image_width"), f"{name}/image_width"),
        height_px=_read_integer(node.get("image_height"), f"{name}/image_height"),
        fx_px=float(matrix[0, 0]),
        fy_px=float(matrix[1, 1]),
        cx_px=float(matrix[0, 2]),
        cy_px=float(matrix[1, 2]),
    )
    return replace(ideal, distortion=(k1, k2, p1, p2, k3))


def _require_camera_matrix(name: str, matrix: FloatArray) -> None:
    fixed = (matrix[0, 1], matrix[1, 0], *matrix[2])
    if fixed != (0.0, 0.0, 0.0, 0.0, 1.0):
        raise InputError(
            f"{name}/camera_matrix is {matrix.tolist()}; only fx, fy, cx, cy may differ from "
            "the identity (no skew)"
        )


def _read_layers(entries: Any) -> PlaneLayers | None:
    if entries is None:
        return None
    if not isinstance(entries, list):
        raise InputError(f"key {LAYERS} is no list; give one {{ top_mm, ior }} per medium")
    names = ("top_mm", "ior")
    for number, layer in enumerate(entries):
        if not isinstance(layer, dict) or sorted(layer) != sorted(names):
            raise InputError(f"{LAYERS} {number}: give exactly the keys top_mm and ior")
    return plane_layers(
        [(_read_number(layer, "top_mm"), _read_number(layer, "ior")) for layer in entries]
    )


def _read_number(layer: Mapping[str, Any], name: str) -> float:
    if not isinstance(layer[name], (int, float)):
        raise InputError(f"{LAYERS}: {name} is no number")
    return float(layer[name])


def _read_integer(value: Any, name: str) -> int:
    if not isinstance(value, int):
        raise InputError(f"key {name} is missing or no whole number")
    return value


def _read_matrix(value: Any, name: str, shape: tuple[int, int]) -> FloatArray:
    if not isinstance(value, np.ndarray):
        raise InputError(f"key {name} is missing or no matrix")
    if shape == (1, 5) and value.shape == (5, 1):  # calibrateCamera returns either
        value = value.reshape(1, 5)
    if value.shape != shape:
        raise InputError(f"{name} has shape {value.shape}; it must be {shape}")
    return np.asarray(value, dtype=np.float64)
