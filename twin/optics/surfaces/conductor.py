"""Metal with a rough or mirror-smooth surface."""

from typing import Any, Literal

from pydantic import Field

from twin.config.bounds import Extinction, MetalIndex
from twin.config.materials import MATERIALS, OpticalMaterial, Roughness
from twin.optics.bsdfs import fresnel_at_normal, level, microfacets

SHARP_BELOW_ROUGHNESS = 0.3
"""Below this GGX alpha, photons carry the light from the metal to the stage, because camera paths
would cause fireflies. The peak of the lobe is 1 / (pi alpha^2): 3.5 at this alpha, 127 at 0.05."""


@MATERIALS.register
class Conductor(OpticalMaterial):
    """A metal surface with GGX microfacets."""

    kind: Literal["conductor"] = "conductor"
    ior: MetalIndex = Field(description="real part n of the complex index")
    extinction: Extinction = Field(description="imaginary part k of the complex index")
    roughness: Roughness = Field(description="GGX alpha; 0 is a perfect mirror")

    def bsdf(self) -> dict[str, Any]:
        """Return the BSDF of the metal's surface, a dictionary for `mi.load_dict`."""
        eta, k = level(self.ior), level(self.extinction)
        return microfacets("conductor", self.roughness, eta=eta, k=k)

    @property
    def is_sharp(self) -> bool:
        """Whether the metal is polished: `roughness` is below `SHARP_BELOW_ROUGHNESS`."""
        return self.roughness < SHARP_BELOW_ROUGHNESS

    @property
    def normal_reflectance(self) -> float:
        """Fresnel reflectance in air at normal incidence."""
        return fresnel_at_normal(self.ior, self.extinction)
