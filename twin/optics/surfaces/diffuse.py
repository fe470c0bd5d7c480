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
        """Return the BSDF of an ideal diffuse reflector, a dictionary for `mi.load_dict`."""
        return {"type": "diffuse", "reflectance": level(self.albedo)}

    @property
    def normal_reflectance(self) -> float:
        """Reflectance in air, which equals the albedo."""
        return self.albedo
