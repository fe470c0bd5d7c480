"""Opaque plastic and gloss paint."""

from typing import Annotated, Any, Literal

from pydantic import Field

from twin.config.materials import MATERIALS, Albedo, Index, OpticalMaterial
from twin.optics.bsdfs import level, microfacets


@MATERIALS.register
class Plastic(OpticalMaterial):
    """Opaque pigment below a clear surface that reflects by Fresnel."""

    kind: Literal["plastic"] = "plastic"
    albedo: Albedo = Field(description="of the pigment, below the surface")
    ior: Index
    roughness: Annotated[float, Field(ge=0.02, le=1)] = Field(description="GGX alpha")

    def bsdf(self) -> dict[str, Any]:
        """Return the BSDF of a diffuse pigment under a GGX surface, for `mi.load_dict`."""
        index, pigment = {"int_ior": self.ior, "ext_ior": 1.0}, level(self.albedo)
        return microfacets("plastic", self.roughness, **index, diffuse_reflectance=pigment)

    @property
    def normal_reflectance(self) -> float:
        """Reflectance in air at normal incidence, approximated by the albedo of the pigment."""
        return self.albedo
