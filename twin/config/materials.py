"""What a specimen is made of, optically: what every kind of material states.

A kind is one file of `twin.optics.surfaces`, of an installed package (entry points of the group
`fringe_twin.materials`) or of the user (`--plugin`): a subclass of `OpticalMaterial` that sets
`kind`, adds its numbers with ranges and sources, and overrides `bsdf`. Every material conserves
energy by construction; complex indices hold at the projector's wavelength.
"""

from typing import Annotated, Any

from pydantic import Field

from reconstruction.registry import Registry
from twin.config.base import Model
from twin.config.kinds import OneOf, kind_of

Roughness = Annotated[float, Field(ge=0, le=1)]
Index = Annotated[float, Field(ge=1, le=4)]
Albedo = Annotated[float, Field(ge=0, lt=1)]


class OpticalMaterial(Model):
    """A surface, and the bulk below it where light gets in."""

    kind: str

    def bsdf(self) -> dict[str, Any]:
        """Return the BSDF for `mi.load_dict`."""
        raise NotImplementedError(f"{type(self).__name__}.bsdf")

    @property
    def is_sharp(self) -> bool:
        """Whether light that this surface throws on others is traced from the projector.

        A surface that reflects or refracts sharply cannot be connected to a pinhole projector from
        a surface behind it.
        """
        return False

    @property
    def bulk_absorption_per_mm(self) -> float:
        """Napierian absorption coefficient of the bulk; 0 where no light gets in."""
        return 0.0

    @property
    def normal_reflectance(self) -> float:
        """Share of light at normal incidence that an object throws back, against air."""
        return 0.0


MATERIALS: Registry[type[OpticalMaterial]] = Registry("materials", "twin.optics.surfaces", kind_of)
"""The kinds of materials."""

Material = Annotated[OpticalMaterial, OneOf(MATERIALS)]
