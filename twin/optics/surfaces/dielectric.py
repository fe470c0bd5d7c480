"""Glass, clear plastic, silicone."""

from typing import Annotated, Any, Literal

from pydantic import Field

from twin.config.bounds import Absorption
from twin.config.materials import MATERIALS, Index, OpticalMaterial
from twin.optics.bsdfs import fresnel_at_normal, microfacets


@MATERIALS.register
class Dielectric(OpticalMaterial):
    """A clear body, which refracts and reflects (Fresnel) and absorbs light (Beer-Lambert).

    Light through the middle of a ball may have an error of 20 to 25 % (docs/specimens.md).
    """

    kind: Literal["dielectric"] = "dielectric"
    ior: Index = Field(description="index of refraction against air")
    roughness: Annotated[float, Field(ge=0, le=0.5)] = Field(
        default=0.0, description="GGX alpha; 0 is perfectly smooth"
    )
    absorption_per_mm: Absorption = Field(
        default=0.0, description="Napierian coefficient of the bulk"
    )

    def bsdf(self) -> dict[str, Any]:
        """Return the BSDF of the interface to air, a dictionary for `mi.load_dict`."""
        return microfacets("dielectric", self.roughness, int_ior=self.ior, ext_ior=1.0)

    @property
    def is_sharp(self) -> bool:
        """Always True: a clear body refracts light into sharp directions."""
        return True

    @property
    def bulk_absorption_per_mm(self) -> float:
        """Napierian absorption coefficient of the bulk, 1/mm."""
        return self.absorption_per_mm

    @property
    def normal_reflectance(self) -> float:
        """Reflectance of a plate in air at normal incidence: both faces, without absorption."""
        once = fresnel_at_normal(self.ior)
        return 2.0 * once / (1.0 + once)
