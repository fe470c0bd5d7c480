"""A coating as a plug-in: enamel, a pigment under a clear glossy face."""

from typing import Annotated, Any, Literal

from pydantic import Field

from twin.config.coatings import COATINGS, Coating
from twin.optics.bsdfs import level, microfacets


@COATINGS.register
class Enamel(Coating):
    """Enamel: pigment in a clear glossy binder."""

    kind: Literal["enamel"] = "enamel"
    albedo: Annotated[float, Field(gt=0, lt=1)] = Field(description="of the pigment")
    gloss_roughness: Annotated[float, Field(ge=0.02, le=0.3)] = Field(
        default=0.1, description="GGX alpha of the face; assumed: brushed on"
    )

    differentiable = ("albedo",)

    def bsdf(self) -> dict[str, Any]:
        """Return a diffuse pigment under GGX microfacets of index 1.5."""
        return microfacets(
            "plastic",
            self.gloss_roughness,
            int_ior=1.5,
            ext_ior=1.0,
            nonlinear=True,
            diffuse_reflectance=level(self.albedo),
        )
