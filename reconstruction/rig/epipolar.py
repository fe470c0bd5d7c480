"""Distances of corresponding points from epipolar lines, which check a rig without its scale."""

from typing import Protocol

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.rig.pinhole import Pinhole


class PairOfDevices(Protocol):
    """Camera, projector, and the transform between their frames, (4, 4)."""

    @property
    def camera(self) -> Pinhole:
        """Intrinsics of the camera."""

    @property
    def projector(self) -> Pinhole:
        """Intrinsics of the projector."""

    @property
    def T_proj_from_cam(self) -> FloatArray:  # noqa: N802 - the frame names of the symbols
        """Transform from the camera's to the projector's frame, (4, 4), translation in mm."""


def epipolar_residuals_px(rig: PairOfDevices, measured_px: FloatArray) -> FloatArray:
    """Return the signed distances (n,) of projector points from epipolar lines, px.

    The epipolar line of a projector point is that of the corresponding camera point.

    Parameters
    ----------
    rig : geometry of both devices
    measured_px : (n, 4) float, camera x, y, projector column, row

    Notes
    -----
    The distance is that in the undistorted projector image, in pixels by the focal lengths.
    """
    T = rig.T_proj_from_cam
    camera_rays = _rays(rig.camera.unproject(measured_px[:, :2]))
    projector_rays = _rays(rig.projector.unproject(measured_px[:, 2:]))
    lines = np.cross(T[:3, 3], camera_rays @ T[:3, :3].T)
    per_px = lines[:, :2] / (rig.projector.fx_px, rig.projector.fy_px)
    return np.asarray(np.sum(lines * projector_rays, axis=1) / np.linalg.norm(per_px, axis=1))


def _rays(normalised: FloatArray) -> FloatArray:
    return np.column_stack([normalised, np.ones(len(normalised))])
