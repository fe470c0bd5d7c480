"""Matte ink: an ideal diffuse reflector (Lambert) in air and in any layer."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from twin.config.coatings import COATINGS, Coating
from twin.optics.bsdfs import level


@COATINGS.register
class Matte(Coating):
    """Matte ink that reflects equal radiance in all directions."""

    kind: Literal["matte"] = "matte"
    base_albedo: Annotated[float, Field(gt=0, lt=1)] = Field(
        description="share of light that the ink reflects"
    )

    differentiable = ("base_albedo",)
    albedo_field = "base_albedo"
    determined_by: ClassVar[Mapping[str, str]] = {
        "base_albedo": "a reference of known albedo (--reference)"
    }

    def bsdf(self) -> dict[str, Any]:
        """Return the BSDF of an ideal diffuse reflector, a dictionary for `mi.load_dict`."""
        return {"type": "diffuse", "reflectance": level(self.base_albedo)}

    @property
    def is_matte(self) -> bool:
        """Always True: the coat is an ideal diffuse reflector."""
        return True
