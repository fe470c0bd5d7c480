"""Camera rays from a rig in motion, each at its own time.

The scene is at rest, and the rig moves in the opposite direction. Its poses are data of the kernel
and not part of the kernel's code: one kernel traces all times.
"""

from dataclasses import dataclass, field, fields, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray, FloatImage
from twin.optics.connection import Connection, Rig, see
from twin.optics.devices import Device, SubPixels

Pixels = NDArray[np.uint32]


@dataclass(frozen=True)
class PosedDevice(Device):
    """A camera or projector with one of several poses in each lane.

    Attributes
    ----------
    poses : `mi.Float`, columns of the upper three rows of T_world_from_device, pose after pose
    pose_of_lane : `mi.UInt32`, number of the pose of each lane
    """

    poses: Any = field(default=None)
    pose_of_lane: Any = field(default=None)

    @classmethod
    def of(cls, device: Device, rest_from_world: FloatArray, pose_of_lane: Any) -> "PosedDevice":
        """Return a device relative to a scene that is displaced by several motions.

        Parameters
        ----------
        rest_from_world : (pose, 4, 4), mm; inverse displacement of the scene
        """
        poses = (rest_from_world @ device.T_world_from_device)[:, :3].transpose(0, 2, 1)
        return cls(
            device.pinhole,
            device.T_world_from_device,
            device.lens,
            mi.Float(poses.ravel().astype(np.float32)),
            pose_of_lane,
        )

    @property
    def position_mm(self) -> Any:
        """World position of the pinhole, `mi.Point3f`, mm."""
        return mi.Point3f(self._column(3))

    def _axes(self) -> tuple[Any, Any, Any]:
        right, down, forward = (mi.Vector3f(self._column(axis)) for axis in range(3))
        return right, down, forward

    def _column(self, number: int) -> list[Any]:
        """Return a column of the pose of each lane, three numbers."""
        first = self.pose_of_lane * 12 + 3 * number
        return [dr.gather(mi.Float, self.poses, first + axis) for axis in range(3)]


def moving_rig(rig: Rig, displacements: FloatArray, pose_of_lane: Any) -> Rig:
    """Return the rig relative to a scene in motion.

    Parameters
    ----------
    displacements : (pose, 4, 4) T_world_from_rest of the scene, mm
    pose_of_lane : `mi.UInt32`, number of the displacement of each lane
    """
    rest_from_world = np.asarray(np.linalg.inv(displacements), np.float64)
    camera, projector = (
        PosedDevice.of(device, rest_from_world, pose_of_lane)
        for device in (rig.camera, rig.projector)
    )
    return replace(rig, camera=camera, projector=projector)


@dataclass(frozen=True, eq=False)
class TimedRays:
    """Camera rays, each with its own time.

    Attributes
    ----------
    pixels : (lane,) numbers of the pixels, row by row
    sample : (lane,) number of the sample in its pixel
    times_s : (time,) times after time 0 of the sequence
    time_of : (lane,) number of the time of each ray
    """

    pixels: Pixels
    sample: Pixels
    times_s: FloatArray
    time_of: NDArray[np.integer[Any]]

    def of(self, chosen: BoolImage) -> "TimedRays":
        """Return some of the rays."""
        return TimedRays(
            self.pixels[chosen], self.sample[chosen], self.times_s, self.time_of[chosen]
        )

    def of_used_times(self) -> "TimedRays":
        """Return the same rays without the times that no ray has."""
        is_used = np.bincount(self.time_of, minlength=len(self.times_s)) > 0
        number = np.cumsum(is_used) - 1
        return replace(self, times_s=self.times_s[is_used], time_of=number[self.time_of])

    def rays(self, rig: Rig, samples: int) -> Any:
        """Return the rays, `mi.Ray3f`, of a rig with so many samples per pixel."""
        row, column = np.divmod(self.pixels, np.uint32(rig.camera.pinhole.width_px))
        x_px, y_px = (mi.Float(number.astype(np.float32)) for number in (column, row))
        grid = SubPixels(x_px, y_px, round(samples**0.5))
        return grid.ray(rig.camera, mi.UInt32(self.sample))


@dataclass(frozen=True, eq=False)
class LanePaths:
    """Camera rays connected to the projector, as arrays (lane,).

    Attributes
    ----------
    column_px, row_px, axial_mm : projector coordinate, and distance along the projector's axis
    weight : radiance under a white field, mW / (mm^2 sr); 0 where there is no light
    """

    column_px: FloatImage
    row_px: FloatImage
    axial_mm: FloatImage
    weight: FloatImage

    @classmethod
    def of(cls, scene: Any, rig: Rig, rays: TimedRays, samples: int) -> "LanePaths":
        """Trace rays and return their paths."""
        if not len(rays.pixels):
            return cls(*(np.zeros(0, np.float32) for _ in fields(cls)))
        path = see(scene, rig, rays.rays(rig, samples))[1]
        dr.eval(*(getattr(path, part.name) for part in fields(path)))
        values = (path.column_px, path.row_px, path.axial_mm, path.weight)
        return cls(*(np.array(value, np.float32) for value in values))

    @classmethod
    def merged(cls, parts: "list[LanePaths]", masks: list[BoolImage]) -> "LanePaths":
        """Return the lanes of several parts; each mask (lane,) selects the lanes of its part."""
        values = []
        for name in (part.name for part in fields(cls)):
            lanes = np.zeros(len(masks[0]) if masks else 0, np.float32)
            for path, mask in zip(parts, masks, strict=True):
                lanes[mask] = getattr(path, name)
            values.append(lanes)
        return cls(*values)

    def connection(self) -> Connection:
        """Return the lanes as input of the light tables."""
        column, row, axial_mm, weight = map(
            mi.Float, (self.column_px, self.row_px, self.axial_mm, self.weight)
        )
        return Connection(column, row, weight, weight > 0.0, axial_mm)

    def of_lanes(self, chosen: BoolImage | NDArray[np.intp]) -> "LanePaths":
        """Return some of the lanes."""
        return LanePaths(*(getattr(self, part.name)[chosen] for part in fields(self)))
