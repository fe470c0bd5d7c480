"""What the tracer must know of a scene's surfaces beyond their BSDFs."""

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi


@dataclass(frozen=True)
class Sharp:
    """A clear or polished body: light goes on from it along sharp directions."""

    shape: Any
    #: Napierian absorption coefficient inside, 1/mm
    absorption_per_mm: float = 0.0


@dataclass(frozen=True)
class Surfaces:
    """Which surfaces are sharp, and which one receives the light that they pass on.

    Attributes
    ----------
    sharp : tuple of Sharp
    stage : mi.Shape, optional
        Horizontal matte plane; None when there is none.
    """

    sharp: tuple[Sharp, ...] = ()
    stage: Any = None

    def is_sharp(self, hit: Any) -> Any:
        """Tell which hits are on a sharp body, `mi.Bool`."""
        found = dr.zeros(mi.Bool, dr.width(hit.t))
        for body in self.sharp:
            found |= hit.shape == mi.ShapePtr(body.shape)
        return found

    def is_stage(self, hit: Any) -> Any:
        """Tell which hits are on the stage, `mi.Bool`."""
        if self.stage is None:
            return dr.zeros(mi.Bool, dr.width(hit.t))
        return hit.shape == mi.ShapePtr(self.stage)

    def on_stage(self, hit: Any) -> Any:
        """Tell which hits are on the stage's upper side, `mi.Bool`."""
        return self.is_stage(hit) & (hit.wi.z > 0.0)

    def transmittance(self, hit: Any, inside: Any) -> Any:
        """Part of the light left after the way inside a clear body to `hit` (Beer-Lambert).

        The body is that of the surface at the way's end: bodies do not overlap.
        """
        absorption = mi.Float(0.0)
        for body in self.sharp:
            if body.absorption_per_mm:
                here = hit.shape == mi.ShapePtr(body.shape)
                absorption = dr.select(here, body.absorption_per_mm, absorption)
        return dr.select(inside, dr.exp(-absorption * hit.t), 1.0)
