"""A material as a plug-in: lacquered wood, a brown pigment under a slightly rough clear face."""

from typing import Any, Literal

from pydantic import Field

from twin.config.materials import MATERIALS, Albedo, OpticalMaterial
from twin.optics.bsdfs import level, microfacets


@MATERIALS.register
class Lacquer(OpticalMaterial):
    """Pigment under a clear lacquer of index 1.5."""

    kind: Literal["lacquer"] = "lacquer"
    albedo: Albedo = Field(default=0.2, description="of the wood; assumed")

    def bsdf(self) -> dict[str, Any]:
        """Return a diffuse pigment under GGX microfacets of roughness 0.1."""
        pigment = level(self.albedo)
        return microfacets("plastic", 0.1, int_ior=1.5, ext_ior=1.0, diffuse_reflectance=pigment)
