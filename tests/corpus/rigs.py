"""Rigs of the calibration files of a program, and their comparison with imported calibrations."""

from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np

from reconstruction.rig.importing import Importing
from reconstruction.rig.pinhole import Pinhole


@dataclass(frozen=True, eq=False)
class Rig:
    """Camera and projector, and x_projector = rotation x_camera + translation_mm."""

    camera: Pinhole
    projector: Pinhole
    rotation: np.ndarray
    translation_mm: np.ndarray

    @property
    def devices(self) -> tuple[tuple[str, Pinhole], ...]:
        return ("camera", self.camera), ("projector", self.projector)

    @property
    def motion(self) -> np.ndarray:
        motion = np.eye(4)
        motion[:3, :3], motion[:3, 3] = self.rotation, self.translation_mm
        return motion


RIG = Rig(
    Pinhole(640, 480, 1800.0, 1795.0, 321.5, 238.25, (-0.11, 0.07, 4e-4, -3e-4, 0.02)),
    Pinhole(912, 1140, 1400.0, 2790.0, 455.0, 1139.5, (0.01, -0.02, 1e-4, 2e-4, 0.0)),
    np.asarray(cv2.Rodrigues(np.array([0.05, -0.42, 0.02]))[0]),
    np.array([98.0, 6.0, 21.0]),
)
"""Rig of the tests; the projector's pixels are twice as wide as high."""


def random_rig(rng: np.random.Generator) -> Rig:
    """Return a rig whose central rays meet, with random lenses, sizes and directions."""
    devices = []
    for _ in range(2):
        width, height = (int(value) for value in rng.integers((600, 400), (2000, 1200)))
        focal, ratio = float(rng.uniform(1.2, 6.0)) * width, float(rng.uniform(0.99, 1.01))
        cx, cy = (rng.uniform(0.45, 0.55, 2) * (width, height)).tolist()
        bent = rng.uniform(-1.0, 1.0, 5) * (0.1, 0.1, 1e-3, 1e-3, 0.1)
        distortion = tuple(bent.tolist())
        devices.append(Pinhole(width, height, focal, ratio * focal, cx, cy, distortion))
    distance_mm, angle = rng.uniform(150, 900), rng.uniform(0.15, 0.6)
    about = rng.uniform(0, 2 * np.pi)
    turn = np.asarray(cv2.Rodrigues(angle * np.array([np.cos(about), np.sin(about), 0.05]))[0])
    meeting = np.array([0.0, 0.0, distance_mm])
    return Rig(*devices, turn, meeting * rng.uniform(0.9, 1.1) - turn @ meeting)


def matrix(device: Pinhole, skew: float = 0.0) -> np.ndarray:
    return np.array(
        [[device.fx_px, skew, device.cx_px], [0, device.fy_px, device.cy_px], [0, 0, 1.0]]
    )


@dataclass(frozen=True)
class Content:
    """Content of the calibration files of a program.

    Attributes
    ----------
    lacks : what the files do not contain: "camera", "projector" (their sizes), "scale"
    coefficients : number of distortion coefficients that the files have
    tolerance : relative error by the number format
    """

    lacks: frozenset[str] = field(default_factory=frozenset)
    coefficients: int = 5
    tolerance: float = 1e-9

    def options(self, rig: Rig) -> Importing:
        """Return the options that a user gives for what the files lack."""
        sizes = {
            f"{name}_size": (device.width_px, device.height_px)
            for name, device in rig.devices
            if name in self.lacks
        }
        baseline = {"baseline_mm": float(np.linalg.norm(rig.translation_mm))}
        return Importing(**sizes, **baseline if "scale" in self.lacks else {})

    def expected(self, rig: Rig) -> Rig:
        """Return the rig that the files can express."""
        kept = [
            replace(
                device,
                distortion=(*device.distortion[: self.coefficients], 0.0)[:5],
            )
            for _, device in rig.devices
        ]
        return Rig(*kept, rig.rotation, rig.translation_mm)


def misread(result: Any, content: Content, rig: Rig) -> list[str]:
    """Return the quantities of an imported calibration that differ from the rig in its files."""
    expected, calibration = content.expected(rig), result.calibration
    wrong = []
    for name, device in expected.devices:
        imported = getattr(calibration, name)
        if (imported.width_px, imported.height_px) != (device.width_px, device.height_px):
            wrong.append(f"{name} size")
        if not np.allclose(matrix(imported), matrix(device), rtol=content.tolerance, atol=1e-7):
            wrong.append(f"{name} matrix")
        if not np.allclose(imported.distortion, device.distortion, atol=content.tolerance):
            wrong.append(f"{name} distortion")
    motion = calibration.T_proj_from_cam
    if not np.allclose(motion[:3, :3], rig.rotation, atol=2 * content.tolerance):
        wrong.append("rotation")
    length = float(np.linalg.norm(rig.translation_mm))
    if not np.allclose(motion[:3, 3], rig.translation_mm, atol=2 * content.tolerance * length):
        wrong.append("translation")
    return wrong
