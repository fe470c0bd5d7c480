"""Matte surfaces: prints, paint, paper."""

from typing import Any, Literal

from twin.config.materials import MATERIALS, Albedo, OpticalMaterial
from twin.optics.bsdfs import level


@MATERIALS.register
class Diffuse(OpticalMaterial):
    """A matte (Lambertian) surface."""

    kind: Literal["diffuse"] = "diffuse"
    albedo: Albedo

    def bsdf(self) -> dict[str, Any]:
        """Return Lambert's reflector."""
        return {"type": "diffuse", "reflectance": level(self.albedo)}

    @property
    def normal_reflectance(self) -> float:
        """The albedo."""
        return self.albedo
