"""Camera rays and projector pixels as Dr.Jit expressions, with Brown-Conrady distortion.

Distortion, its inverse and its fold (the radius beyond which it has no inverse) are those of
`reconstruction.rig.pinhole`. Single precision resolves an image of 1000 pixels to 1e-4 px. Camera
rays start from a fixed square grid of sub-pixel positions on every pixel.

Pose and intrinsics are data of a kernel and not part of its code: rigs with other numbers, as in
the samples of a data set, use the same compiled kernels.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.rig.pinhole import (
    INVERSE_STEPS,
    Pinhole,
    distort,
    distortion_jacobian,
    fold_square,
    is_before_fold,
    newton_step,
)
from twin.config.models import Distortion
from twin.optics.rig import ThinLens, lens_places

# Newton squares the error: after a normalised step below this, the error is below 1e-5 px at a
# focal length of 5000 px. Near a fold, single precision does not resolve much smaller steps.
_LAST_STEP = 3e-5

# Pixel of points that the lens does not image: off every image, and finite (0 x inf is nan).
_OFF_PX = -1e6


def kernel_number(value: Any) -> Any:
    """Return a number as data of the kernel (opaque `mi.Float`); a Dr.Jit variable is unchanged."""
    return value if dr.is_array_v(value) else dr.opaque(mi.Float, float(value))


def _reciprocal(value: Any) -> Any:
    """Return 1 / value as data of the kernel, rounded as in a division by a literal of a kernel."""
    if dr.is_array_v(value):
        return 1.0 / value
    return kernel_number(np.float32(1.0) / np.float32(value))


@dataclass(frozen=True)
class Device:
    """A camera or projector at a pose, for use inside a kernel; a camera may have a thin lens."""

    pinhole: Pinhole
    T_world_from_device: FloatArray
    lens: ThinLens | None = None

    @property
    def position_mm(self) -> Any:
        """World position of the pinhole, `mi.Point3f`, mm."""
        return mi.Point3f(*self._pose_columns[3])

    def _axes(self) -> tuple[Any, Any, Any]:
        right, down, forward = (mi.Vector3f(*column) for column in self._pose_columns[:3])
        return right, down, forward

    @cached_property
    def _pose_columns(self) -> list[list[Any]]:
        """Columns of the upper three rows of the pose."""
        columns = self.T_world_from_device[:3].T.tolist()
        return [[kernel_number(value) for value in column] for column in columns]

    @cached_property
    def _focal_px(self) -> tuple[Any, Any]:
        return kernel_number(self.pinhole.fx_px), kernel_number(self.pinhole.fy_px)

    @cached_property
    def _per_focal_px(self) -> tuple[Any, Any]:
        return _reciprocal(self.pinhole.fx_px), _reciprocal(self.pinhole.fy_px)

    @cached_property
    def _centre_px(self) -> tuple[Any, Any]:
        return kernel_number(self.pinhole.cx_px), kernel_number(self.pinhole.cy_px)

    def ray(self, x_px: Any, y_px: Any) -> Any:
        """Return the world ray (`mi.Ray3f`, unit direction) through continuous pixel coordinates.

        For a device with a thin lens, this is the chief ray. The distortion polynomial cannot be
        inverted beyond some radius: for pixels there the ray has length 0 and no hit.
        """
        x, y, exists = self._slopes(x_px, y_px)
        right, down, forward = self._axes()
        ray = mi.Ray3f(self.position_mm, dr.normalize(x * right + y * down + forward))
        return _ended(ray, exists)

    def lens_ray(self, lens: ThinLens, x_px: Any, y_px: Any, place: tuple[Any, Any]) -> Any:
        """Return the world ray from a point on the lens to the point in focus on the chief ray.

        At axial distance z, the offset of the ray from the chief ray is radius (1 - z / focus)
        place. The offset in the image is fx radius (1/z - 1/focus) place, in pixels.

        Parameters
        ----------
        place : x and y of the point on the lens, in units of the lens radius
        """
        x, y, exists = self._slopes(x_px, y_px)
        right, down, forward = self._axes()
        start_mm = lens.radius_mm * (place[0] * right + place[1] * down)
        towards = lens.focus_mm * (x * right + y * down + forward) - start_mm
        return _ended(mi.Ray3f(self.position_mm + start_mm, dr.normalize(towards)), exists)

    def _slopes(self, x_px: Any, y_px: Any) -> tuple[Any, Any, Any]:
        """Return the normalised coordinates x / z, y / z of pixels, and True if a ray exists."""
        (cx, cy), (per_fx, per_fy) = self._centre_px, self._per_focal_px
        x, y, distortion = (x_px - cx) * per_fx, (y_px - cy) * per_fy, self.pinhole.distortion
        return _undistort(x, y, distortion) if any(distortion) else (x, y, mi.Bool(True))

    def project(self, point_mm: Any) -> tuple[Any, Any, Any]:
        """Return the pixel coordinates x_px, y_px and the axial distance, mm, of a world point.

        Points beyond the fold of the distortion have no pixel: their coordinates are far outside.
        """
        distortion, (fx, fy), (cx, cy) = self.pinhole.distortion, self._focal_px, self._centre_px
        right, down, forward = self._axes()
        offset = point_mm - self.position_mm
        axial_mm = dr.dot(offset, forward)
        x, y = dr.dot(offset, right) / axial_mm, dr.dot(offset, down) / axial_mm
        if not any(distortion):
            return dr.fma(x, fx, cx), dr.fma(y, fy, cy), axial_mm
        jacobian = distortion_jacobian(x, y, distortion)
        imaged = is_before_fold(x, y, jacobian, fold_square(distortion))
        x, y = distort(x, y, distortion)
        x_px, y_px = dr.fma(x, fx, cx), dr.fma(y, fy, cy)
        x_px, y_px = dr.select(imaged, x_px, _OFF_PX), dr.select(imaged, y_px, _OFF_PX)
        return x_px, y_px, axial_mm


def _ended(ray: Any, exists: Any) -> Any:
    ray.maxt = dr.select(exists, ray.maxt, 0.0)
    return ray


def _undistort(x_target: Any, y_target: Any, distortion: Distortion) -> tuple[Any, Any, Any]:
    def improve(turn: Any, x: Any, y: Any, _close: Any, _before: Any) -> tuple[Any, ...]:
        x_now, y_now = distort(x, y, distortion)
        jacobian = distortion_jacobian(x, y, distortion)
        dx, dy = newton_step(x_target - x_now, y_target - y_now, jacobian)
        close = dr.abs(dx) + dr.abs(dy) < _LAST_STEP
        before = is_before_fold(x, y, jacobian, fold_square(distortion))
        return turn + 1, x + dx, y + dy, close, before

    start = (mi.UInt32(0), mi.Float(x_target), mi.Float(y_target), mi.Bool(False), mi.Bool(False))
    _, x, y, close, before = dr.while_loop(
        start, lambda turn, _x, _y, close, _: ~close & (turn < INVERSE_STEPS), improve
    )
    exists = close & before
    return dr.select(exists, x, 0.0), dr.select(exists, y, 0.0), exists


@dataclass(frozen=True)
class SubPixels:
    """Sample positions in every pixel of an image: the centres of side x side equal cells.

    Pixels are in row-major order.
    """

    #: coordinates of the pixel centres
    x_px: Any
    y_px: Any
    side: int

    @classmethod
    def of_image(cls, width: int, height: int, samples: int) -> "SubPixels":
        """Return the grid of an image with a square number of samples per pixel."""
        index = dr.arange(mi.UInt32, width * height)
        row = index // width
        return cls(mi.Float(index - row * width), mi.Float(row), round(samples**0.5))

    @property
    def samples(self) -> int:
        """Number of samples per pixel."""
        return self.side * self.side

    def position(self, sample: Any) -> tuple[Any, Any]:
        """Return the image coordinates x_px, y_px of sample number `sample` in every pixel."""
        row = sample // self.side
        column = sample - row * self.side
        dx, dy = ((mi.Float(index) + 0.5) / self.side - 0.5 for index in (column, row))
        return self.x_px + dx, self.y_px + dy

    def ray(self, camera: Device, sample: Any) -> Any:
        """Return the camera ray (`mi.Ray3f`) of sample number `sample` in every pixel."""
        x_px, y_px = self.position(sample)
        if camera.lens is None:
            return camera.ray(x_px, y_px)
        x, y = (dr.gather(mi.Float, axis, sample) for axis in self._lens_places)
        return camera.lens_ray(camera.lens, x_px, y_px, (x, y))

    @cached_property
    def _lens_places(self) -> tuple[Any, Any]:
        x, y = lens_places(self.side).T
        return mi.Float(x), mi.Float(y)
