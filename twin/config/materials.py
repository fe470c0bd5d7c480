"""Optical materials as data: what a specimen and the stage are made of.

Every model conserves energy by construction. Complex indices hold at the projector's wavelength.
"""

from typing import Annotated, Literal

from pydantic import Field

from twin.config.base import Length, Model, NonNegative, Positive

Roughness = Annotated[float, Field(ge=0, le=1)]
Index = Annotated[float, Field(ge=1, le=4)]
Albedo = Annotated[float, Field(ge=0, lt=1)]


class Conductor(Model):
    """A metal surface with GGX microfacets."""

    kind: Literal["conductor"] = "conductor"
    ior: Positive = Field(description="real part n of the complex index")
    extinction: NonNegative = Field(description="imaginary part k of the complex index")
    roughness: Roughness = Field(description="GGX alpha; 0 is a perfect mirror")


class Dielectric(Model):
    """A clear body: refracts, reflects after Fresnel, absorbs along the way (Beer-Lambert)."""

    kind: Literal["dielectric"] = "dielectric"
    ior: Index = Field(description="index of refraction against air")
    roughness: Annotated[float, Field(ge=0, le=0.5)] = Field(
        default=0.0, description="GGX alpha; 0 is perfectly smooth"
    )
    absorption_per_mm: NonNegative = Field(
        default=0.0, description="Napierian coefficient of the bulk"
    )


class Diffuse(Model):
    """A matte (Lambertian) surface."""

    kind: Literal["diffuse"] = "diffuse"
    albedo: Albedo


class Plastic(Model):
    """Opaque pigment below a clear surface that reflects after Fresnel."""

    kind: Literal["plastic"] = "plastic"
    albedo: Albedo = Field(description="of the pigment, below the surface")
    ior: Index
    roughness: Annotated[float, Field(ge=0.02, le=1)] = Field(description="GGX alpha")


Material = Annotated[Conductor | Dielectric | Diffuse | Plastic, Field(discriminator="kind")]


class Stage(Model):
    """The matte table under a specimen that is seen directly."""

    albedo: Albedo = 0.35
    size_mm: Length = Field(default=80.0, description="edge of the square, round the world origin")
