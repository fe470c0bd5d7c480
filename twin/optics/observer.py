"""Somebody who looks at the rig from beside it: where he stands and what his picture shows.

The measurement does not use this module. World frame, mm; pixels as everywhere: (0, 0) is the
CENTRE of the first.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.rig.pinhole import Pinhole

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Observer:
    """A pinhole eye that looks at a point, the world's z axis upright in its picture."""

    eye_mm: Point
    target_mm: Point
    width_mm: float
    """How much of the plane through the target, across the view, the picture's width shows."""
    width_px: int = 640
    height_px: int = 480

    @property
    def pinhole(self) -> Pinhole:
        """Intrinsics."""
        distance_mm = float(np.linalg.norm(np.subtract(self.target_mm, self.eye_mm)))
        focal_px = self.width_px * distance_mm / self.width_mm
        centre = (self.width_px - 1) / 2, (self.height_px - 1) / 2
        return Pinhole(self.width_px, self.height_px, focal_px, focal_px, *centre)

    @property
    def world_from_eye(self) -> FloatArray:
        """Pose (4, 4) in OpenCV's frame.

        A view straight down has world y at the top.
        """
        forward = np.subtract(self.target_mm, self.eye_mm)
        forward /= np.linalg.norm(forward)
        level = np.hypot(forward[0], forward[1]) < 1e-6
        right = np.cross(forward, [0.0, 1.0, 0.0] if level else [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
        pose[:3, 3] = self.eye_mm
        return pose

    def project(self, points_world_mm: Any) -> FloatArray:
        """Return the pixels (..., 2) where world points (..., 3) appear."""
        pose = self.world_from_eye
        return self.pinhole.project((np.asarray(points_world_mm) - pose[:3, 3]) @ pose[:3, :3])
