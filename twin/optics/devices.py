"""Camera rays and projector pixels as Dr.Jit expressions, with Brown-Conrady distortion.

A test holds them together with `reconstruction.pinhole`, whose distortion they share.
"""

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from reconstruction.pinhole import Pinhole, distort
from twin.config.models import Distortion
from twin.optics.lens import ThinLens

# The fixed point converges by a factor of about the distortion itself (< 0.1) per turn.
_UNDISTORT_TURNS = 10


@dataclass(frozen=True)
class Device:
    """A pinhole at a pose, ready for use inside a kernel; a camera may have a thin lens."""

    pinhole: Pinhole
    T_world_from_device: NDArray[np.float64]
    lens: ThinLens | None = None

    @property
    def position_mm(self) -> Any:
        """Pinhole in the world, `mi.Point3f`."""
        return mi.Point3f(*self.T_world_from_device[:3, 3].tolist())

    def _axes(self) -> tuple[Any, Any, Any]:
        right, down, forward = self.T_world_from_device[:3, :3].T.tolist()
        return mi.Vector3f(*right), mi.Vector3f(*down), mi.Vector3f(*forward)

    def ray(self, x_px: Any, y_px: Any) -> Any:
        """World ray (`mi.Ray3f`, unit direction) through continuous pixel coordinates.

        With a lens this is its chief ray.
        """
        x, y = self._slopes(x_px, y_px)
        right, down, forward = self._axes()
        return mi.Ray3f(self.position_mm, dr.normalize(x * right + y * down + forward))

    def lens_ray(self, lens: ThinLens, x_px: Any, y_px: Any, place: tuple[Any, Any]) -> Any:
        """World ray from a place on the unit disc of the lens to where the chief ray is in focus.

        A point on the chief ray at axial distance z is then missed by
        radius (1 - z / focus) place, its image by fx radius (1/z - 1/focus) place pixels.
        """
        x, y = self._slopes(x_px, y_px)
        right, down, forward = self._axes()
        start_mm = lens.radius_mm * (place[0] * right + place[1] * down)
        towards = lens.focus_mm * (x * right + y * down + forward) - start_mm
        return mi.Ray3f(self.position_mm + start_mm, dr.normalize(towards))

    def _slopes(self, x_px: Any, y_px: Any) -> tuple[Any, Any]:
        """Normalised coordinates seen at pixels."""
        p = self.pinhole
        x, y = (x_px - p.cx_px) / p.fx_px, (y_px - p.cy_px) / p.fy_px
        return _undistort(x, y, p.distortion)

    def project(self, point_mm: Any) -> tuple[Any, Any, Any]:
        """Pixel coordinates x_px, y_px and axial distance mm of a world point."""
        p = self.pinhole
        right, down, forward = self._axes()
        offset = point_mm - self.position_mm
        axial_mm = dr.dot(offset, forward)
        x, y = dr.dot(offset, right) / axial_mm, dr.dot(offset, down) / axial_mm
        if any(p.distortion):
            x, y = distort(x, y, p.distortion)
        return dr.fma(x, p.fx_px, p.cx_px), dr.fma(y, p.fy_px, p.cy_px), axial_mm


def _undistort(x: Any, y: Any, distortion: Distortion) -> tuple[Any, Any]:
    if not any(distortion):
        return x, y
    x_ideal, y_ideal = x, y
    for _ in range(_UNDISTORT_TURNS):
        x_found, y_found = distort(x_ideal, y_ideal, distortion)
        x_ideal, y_ideal = x_ideal + (x - x_found), y_ideal + (y - y_found)
    return x_ideal, y_ideal
