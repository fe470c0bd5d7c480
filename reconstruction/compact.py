"""Store maps with at most 16 bits per pixel and expand them to arrays when they are read.

Without this, all maps of a result would need as much memory as the frames. Only the projector
coordinate, from which points are computed, is stored in single precision. The other maps have half
precision or less: the step of half precision is at most 1 / 1024 of the value, which is below the
noise of these quantities.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray, FloatImage, OrderImage

Class = TypeVar("Class")
Bits = NDArray[np.uint16]
LARGEST = 65504.0
TURN_STEPS = 65536
RAD_PER_STEP = 2.0 * np.pi / TURN_STEPS


class Compact(Protocol):
    """A compactly stored map that can be expanded to an array."""

    def expand(self) -> NDArray[Any]:
        """Return the values as a new array, (row, col) or (row, col, xyz)."""


class ExpandedOnRead:
    """Descriptor of an attribute: stores the assigned array or compact map, returns an array."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, instance: object | None, owner: type) -> Any:
        if instance is None:
            return self
        value = stored_value(instance, self._name)
        return value if isinstance(value, np.ndarray) else value.expand()

    def __set__(self, instance: object, value: Compact | NDArray[Any]) -> None:
        vars(instance)[self._name] = value


def keeps_compact(*names: str) -> Callable[[type[Class]], type[Class]]:
    """Return a class decorator: the named array fields of a dataclass also accept compact maps."""

    def install(owner: type[Class]) -> type[Class]:
        for name in names:
            setattr(owner, name, ExpandedOnRead(name))
        return owner

    return install


def stored_value(instance: object, name: str) -> Compact | NDArray[Any]:
    """Return the assigned value, unexpanded, of a field that `keeps_compact` named."""
    value: Compact | NDArray[Any] = vars(instance)[name]
    return value


@dataclass(frozen=True, eq=False)
class Half:
    """Map of non-negative values, stored as the bits (row, col) of value / `unit` in float16."""

    bits: Bits
    unit: float

    @classmethod
    def of(cls, values: NDArray[Any], unit: float) -> "Half":
        """Return values / `unit` in float16; quotients above `LARGEST` are set to `LARGEST`."""
        scaled = np.minimum(np.asarray(values, np.float32) / np.float32(unit), LARGEST)
        return cls(np.ascontiguousarray(scaled.astype(np.float16)).view(np.uint16), unit)

    def expand(self) -> FloatImage:
        """Return the values, (row, col) float32."""
        values = self.bits.view(np.float16)
        return np.multiply(values, np.float32(self.unit), dtype=np.float32)


@dataclass(frozen=True, eq=False)
class Turns:
    """Map (row, col) of wrapped phases, stored as integers in units of 2 pi / 65536 rad."""

    bits: Bits

    def expand(self) -> FloatImage:
        """Return the phases in [0, 2 pi), (row, col) float32 rad."""
        return np.multiply(self.bits, np.float32(RAD_PER_STEP), dtype=np.float32)


@dataclass(frozen=True, eq=False)
class Share:
    """Map (row, col) of numbers from 0 to 1, stored as integers in units of 1 / 255."""

    steps: NDArray[np.uint8]

    def expand(self) -> FloatImage:
        """Return the numbers from 0 to 1, (row, col) float32."""
        return np.multiply(self.steps, np.float32(1.0 / 255.0), dtype=np.float32)


@dataclass(frozen=True, eq=False)
class Orders:
    """Map of fringe orders: coordinate / period - phase in turns; 0 where there is no coordinate.

    Parameters
    ----------
    coordinate_px : (row, col) projector coordinate; 0 where there is none
    turns : wrapped phase of the measuring period
    period_px : measuring period
    """

    coordinate_px: FloatImage
    turns: Turns
    period_px: float

    def expand(self) -> OrderImage:
        """Return the fringe orders, (row, col) int16."""
        number = np.multiply(self.turns.bits, np.float32(-1.0 / TURN_STEPS), dtype=np.float32)
        number += self.coordinate_px * np.float32(1.0 / self.period_px)
        np.rint(number, out=number)
        number *= self.coordinate_px != 0.0
        return number.astype(np.int16)


@dataclass(frozen=True, eq=False)
class RaySpread:
    """Standard deviations of points along the world axes, from the standard deviation of the depth.

    The error of a point X is along its camera ray. The standard deviation along world axis i is
    therefore |X_i - C_i| sigma_d / d. C is the camera centre, d the depth of X along the optical
    axis and sigma_d the standard deviation of d.

    Parameters
    ----------
    points_world_mm : (row, col, xyz)
    sigma_depth_mm : (row, col) sigma_d; 0 where it is unknown
    T_world_from_cam : (4, 4) pose of the camera, mm
    """

    points_world_mm: FloatImage
    sigma_depth_mm: Half
    T_world_from_cam: FloatArray

    def expand(self) -> FloatImage:
        """Return sigma along world x, y, z, (row, col, xyz) float32 mm; 0 where sigma_d is 0."""
        along = self.points_world_mm - self.T_world_from_cam[:3, 3].astype(np.float32)
        per_depth = self._per_depth()[..., None]
        return np.asarray(np.abs(along, out=along) * per_depth, dtype=np.float32)

    def component(self, axis: int) -> FloatImage:
        """Return the sigma along one world axis, (row, col) float32 mm."""
        along = self.points_world_mm[..., axis] - np.float32(self.T_world_from_cam[axis, 3])
        return np.asarray(np.abs(along) * self._per_depth(), dtype=np.float32)

    def _per_depth(self) -> FloatImage:
        """Return sigma_d / d, (row, col); 0 where sigma_d is 0."""
        T = self.T_world_from_cam
        axis, origin = T[:3, 2].astype(np.float32), np.float32(T[:3, 2] @ T[:3, 3])
        depth_mm = self.points_world_mm @ axis - origin
        sigma_mm = self.sigma_depth_mm.expand()
        per_depth = np.zeros_like(sigma_mm)
        np.divide(sigma_mm, depth_mm, out=per_depth, where=sigma_mm > 0.0)
        return per_depth
