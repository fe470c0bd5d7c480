"""Clear plane layers between the devices and the surface: a gel, its window, a gap of air."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from reconstruction.errors import InputError, require_number


@dataclass(frozen=True)
class PlaneLayers:
    """Media with plane interfaces z = const of the world frame, from the top down; air above.

    Parameters
    ----------
    tops_mm : world z of the interface above each medium, descending
    iors : refractive index of each relative to air, 1 to 3; the last medium contains the surface

    Raises
    ------
    InputError : no medium, lists of different lengths, interfaces that do not descend
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
        """Raise InputError if a device at this world z is not above the layers, in air."""
        if height_mm <= self.tops_mm[0]:
            raise InputError(
                f"layers: the topmost ends at z = {self.tops_mm[0]:g} mm, above the {device} at "
                f"{height_mm:g} mm; the world's z axis must point from the surface to the devices"
            )


def plane_layers(media: Sequence[tuple[float, float]]) -> PlaneLayers | None:
    """Return the layers of (top mm, index) pairs from the top down; None without any."""
    if not media:
        return None
    tops_mm, iors = zip(*media, strict=True)
    return PlaneLayers(tuple(map(float, tops_mm)), tuple(map(float, iors)))
