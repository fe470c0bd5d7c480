"""Clear plane layers between the devices and the measured surface: gel, window, air gap."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from reconstruction.errors import InputError, require_number


@dataclass(frozen=True)
class PlaneLayers:
    """Clear media with plane interfaces z = const of the world frame. Above them is air.

    The media are listed from the top (the devices) down. The last one contains the surface.

    Parameters
    ----------
    tops_mm : world z of the upper interface of each medium, descending
    iors : refractive index of each medium relative to air, 1 to 3

    Raises
    ------
    InputError : there is no medium, the lengths differ, or the interfaces do not descend
    """

    tops_mm: tuple[float, ...]
    iors: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.tops_mm or len(self.tops_mm) != len(self.iors):
            raise InputError(
                f"layers: found {len(self.tops_mm)} interfaces and {len(self.iors)} indices; give "
                "one of each per medium, at least one"
            )
        for number, (top_mm, ior) in enumerate(zip(self.tops_mm, self.iors, strict=True)):
            require_number(f"layers {number} top_mm", top_mm, -1e4, 1e4)
            require_number(f"layers {number} ior", ior, 1.0, 3.0)
        for upper, lower in pairwise(self.tops_mm):
            if lower >= upper:
                raise InputError(
                    f"layers: an interface at {lower:g} mm follows one at {upper:g} mm; list them "
                    "from the top (the devices) down"
                )

    def require_below(self, device: str, height_mm: float) -> None:
        """Raise InputError unless a device at world z = `height_mm` is above all layers."""
        if height_mm <= self.tops_mm[0]:
            raise InputError(
                f"layers: the topmost ends at z = {self.tops_mm[0]:g} mm, above the {device} at "
                f"{height_mm:g} mm; the world's z axis must point from the surface to the devices"
            )


def plane_layers(media: Sequence[tuple[float, float]]) -> PlaneLayers | None:
    """Return the layers of pairs (top_mm, ior), from the top down; None if there are no pairs."""
    if not media:
        return None
    tops_mm, iors = zip(*media, strict=True)
    return PlaneLayers(tuple(map(float, tops_mm)), tuple(map(float, iors)))
