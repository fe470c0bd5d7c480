"""Camera rays of selected pixels from a rig in motion.

The scene is at rest, and the rig moves in the opposite direction. Its poses are data of the kernel
and not part of the kernel's code: one kernel traces all instants.
"""

from dataclasses import dataclass, fields, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray, FloatImage
from twin.optics.connection import Connection, Rig, see
from twin.optics.devices import Device, SubPixels

Pixels = NDArray[np.uint32]


class MovedDevice(Device):
    """A camera or projector whose pose is data of a kernel, so that a pose compiles no kernel."""

    @property
    def position_mm(self) -> Any:
        """World position of the pinhole, `mi.Point3f`, mm."""
        return mi.Point3f(*_opaque(self.T_world_from_device[:3, 3]))

    def _axes(self) -> tuple[Any, Any, Any]:
        right, down, forward = (
            mi.Vector3f(*_opaque(axis)) for axis in self.T_world_from_device[:3, :3].T
        )
        return right, down, forward


def _opaque(values: FloatArray) -> list[Any]:
    return [dr.opaque(mi.Float, float(value)) for value in values]


def moved_rig(rig: Rig, T_world_from_rest: FloatArray) -> Rig:
    """Return the rig relative to a scene that is displaced by a rigid motion, mm."""
    rest_from_world = np.linalg.inv(T_world_from_rest)

    def moved(device: Device) -> Device:
        return MovedDevice(
            device.pinhole, rest_from_world @ device.T_world_from_device, lens=device.lens
        )

    return replace(rig, camera=moved(rig.camera), projector=moved(rig.projector))


@dataclass(frozen=True, eq=False)
class LanePaths:
    """Camera rays connected to the projector, as arrays: one value per lane.

    Attributes
    ----------
    column_px, row_px, axial_mm : projector coordinate, and distance along the projector's axis
    weight : radiance under a white field, mW / (mm^2 sr); 0 where there is no light
    """

    column_px: FloatImage
    row_px: FloatImage
    axial_mm: FloatImage
    weight: FloatImage


@dataclass(frozen=True, eq=False)
class Lanes:
    """All samples of selected pixels: sample 0 of every pixel, then sample 1, and so on.

    Attributes
    ----------
    pixels : (pixel,) numbers of the pixels, row by row
    width_px : width of the image
    samples : rays per pixel, a square number
    """

    pixels: Pixels
    width_px: int
    samples: int

    @property
    def rows(self) -> NDArray[np.intp]:
        """Row of the image of every pixel, (pixel,)."""
        return np.asarray(self.pixels // np.uint32(self.width_px), np.intp)

    def of(self, chosen: NDArray[np.bool_]) -> "Lanes":
        """Return the lanes of some of the pixels, chosen by a mask (pixel,)."""
        return replace(self, pixels=self.pixels[chosen])

    def connections(self, scene: Any, rig: Rig) -> Connection:
        """Return the traced lanes, recorded but not run."""
        number = np.tile(self.pixels, self.samples)
        place = mi.UInt32(number)
        row = place // dr.opaque(mi.UInt32, self.width_px)
        column = place - row * dr.opaque(mi.UInt32, self.width_px)
        sample = mi.UInt32(np.repeat(np.arange(self.samples, dtype=np.uint32), len(self.pixels)))
        grid = SubPixels(mi.Float(column), mi.Float(row), round(self.samples**0.5))
        return see(scene, rig, grid.ray(rig.camera, sample))[1]

    def traced(self, scene: Any, rig: Rig) -> LanePaths:
        """Return the traced lanes as arrays."""
        path = self.connections(scene, rig)
        dr.eval(*(getattr(path, field.name) for field in fields(path)))
        return LanePaths(*map(_array, (path.column_px, path.row_px, path.axial_mm, path.weight)))

    def means(self, values: FloatImage) -> FloatImage:
        """Return the mean over the samples of every pixel of values of all lanes, (pixel,)."""
        return np.asarray(values.reshape(self.samples, -1).mean(axis=0, dtype=np.float64))


def _array(values: Any) -> FloatImage:
    return np.array(values, np.float32)
