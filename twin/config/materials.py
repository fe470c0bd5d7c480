"""Optical materials of specimens: the base class and registry of their kinds.

A kind is a subclass of `OpticalMaterial` that sets `kind`, adds its numbers with ranges and
sources, and overrides `bsdf`. It is defined in one file of `twin.optics.surfaces`, of an installed
package (entry points of the group `fringe_twin.materials`) or of the user (`--plugin`). Every
material conserves energy by construction. Complex indices are those at the projector's wavelength.
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
    """Base class of optical materials: a surface, and the bulk if the surface transmits light."""

    kind: str

    def bsdf(self) -> dict[str, Any]:
        """Return the BSDF of the surface as a dictionary for `mi.load_dict`."""
        raise NotImplementedError(f"{type(self).__name__}.bsdf")

    @property
    def is_sharp(self) -> bool:
        """Whether light that this surface sends to other surfaces is traced from the projector.

        This is necessary if the surface reflects or refracts sharply: a point that it illuminates
        cannot be connected to the pinhole of the projector.
        """
        return False

    @property
    def bulk_absorption_per_mm(self) -> float:
        """Napierian absorption coefficient of the bulk, 1/mm; 0 if the surface is opaque."""
        return 0.0

    @property
    def normal_reflectance(self) -> float:
        """Reflectance of the surface in air at normal incidence, 0 to 1."""
        return 0.0


MATERIALS: Registry[type[OpticalMaterial]] = Registry("materials", "twin.optics.surfaces", kind_of)
"""Registry of the kinds of materials."""

Material = Annotated[OpticalMaterial, OneOf(MATERIALS)]
