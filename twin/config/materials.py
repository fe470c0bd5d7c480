"""Optical materials of specimens: the base class and registry of their kinds.

A kind is one file of `twin.optics.surfaces`, of an installed package (entry points of the group
`fringe_twin.materials`) or of the user (`--plugin`): a subclass of `OpticalMaterial` that sets
`kind`, adds its numbers with ranges and sources, and overrides `bsdf`. Every material conserves
energy by construction; complex indices are those at the projector's wavelength.
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
    """A surface, and the bulk below it if the surface transmits light."""

    kind: str

    def bsdf(self) -> dict[str, Any]:
        """Return the BSDF for `mi.load_dict`."""
        raise NotImplementedError(f"{type(self).__name__}.bsdf")

    @property
    def is_sharp(self) -> bool:
        """Whether light from this surface to other surfaces is traced from the projector.

        A surface that reflects or refracts sharply cannot be connected to a pinhole projector from
        a surface behind it.
        """
        return False

    @property
    def bulk_absorption_per_mm(self) -> float:
        """Napierian absorption coefficient of the bulk; 0 if the surface is opaque."""
        return 0.0

    @property
    def normal_reflectance(self) -> float:
        """Reflectance in air at normal incidence."""
        return 0.0


MATERIALS: Registry[type[OpticalMaterial]] = Registry("materials", "twin.optics.surfaces", kind_of)
"""The kinds of materials."""

Material = Annotated[OpticalMaterial, OneOf(MATERIALS)]
