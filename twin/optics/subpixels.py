"""Sub-pixel positions of the camera rays: a fixed square grid on every pixel."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi

from twin.optics.devices import Device
from twin.optics.lens import lens_places


@dataclass(frozen=True)
class SubPixels:
    """Centres of side x side cells on every pixel of an image; pixels in row-major order."""

    #: pixel centres
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
        """Samples per pixel."""
        return self.side * self.side

    def position(self, sample: Any) -> tuple[Any, Any]:
        """Return x_px, y_px of one sample on every pixel."""
        row = sample // self.side
        column = sample - row * self.side
        dx, dy = ((mi.Float(index) + 0.5) / self.side - 0.5 for index in (column, row))
        return self.x_px + dx, self.y_px + dy

    def ray(self, camera: Device, sample: Any) -> Any:
        """Return the camera ray (`mi.Ray3f`) of one sample on every pixel."""
        x_px, y_px = self.position(sample)
        if camera.lens is None:
            return camera.ray(x_px, y_px)
        x, y = (dr.gather(mi.Float, axis, sample) for axis in self._lens_places)
        return camera.lens_ray(camera.lens, x_px, y_px, (x, y))

    @cached_property
    def _lens_places(self) -> tuple[Any, Any]:
        x, y = lens_places(self.side).T
        return mi.Float(x), mi.Float(y)
