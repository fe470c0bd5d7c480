"""The coat of the elastomer as data: its texture, and the base class of all kinds of coating.

A kind is a subclass of `Coating` that sets `kind`, adds its numbers with ranges and sources, and
overrides `bsdf`. It is defined in one file of `twin.optics.coatings`, of an installed package
(entry points of the group `fringe_twin.coatings`) or of the user (`--plugin`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import cbrt, sqrt
from typing import Annotated, Any, ClassVar, Self

from pydantic import Field, model_validator

from reconstruction.registry import Registry
from twin.config.base import Model
from twin.config.kinds import OneOf, kind_of


class Texture(Model):
    """Texture of a sprayed coat (grain, flakes): random heights over the coat's smooth face."""

    rms_um: Annotated[float, Field(gt=0, le=100)] = Field(
        description="root mean square height over all seeds"
    )
    correlation_mm: Annotated[float, Field(ge=0.03, le=2)] = Field(
        description="lag at which the autocorrelation of the heights is 1/e; ISO 25178's Sal "
        "is the lag at 0.2: 1.27 times this length for normally distributed heights"
    )
    skewness: Annotated[float, Field(ge=-3, le=3)] = Field(
        default=0.0, description="above 0: grains; below 0: pits"
    )
    excess_kurtosis: Annotated[float, Field(ge=0, le=60)] = Field(
        default=0.0,
        description="0: normal; with skewness, more than of the log-normal distribution",
    )

    @model_validator(mode="after")
    def _distribution_exists(self) -> "Texture":
        least = _least_excess_kurtosis(self.skewness)
        if self.skewness and self.excess_kurtosis < least:
            raise ValueError(
                f"excess_kurtosis: found {self.excess_kurtosis:g}, allowed at least {least:.3g} "
                f"with skewness {self.skewness:g}; raise it, or set skewness nearer to 0"
            )
        return self


def _least_excess_kurtosis(skewness: float) -> float:
    """Return the least allowed excess kurtosis for a skewness.

    It is 1.01 x that of the log-normal distribution, the limit of Johnson's unbounded system.
    """
    square = skewness**2
    root = cbrt(1 + square / 2 + sqrt(square + square**2 / 4))
    w = root + 1 / root - 1
    return 1.01 * (w**4 + 2 * w**3 + 3 * w**2 - 6)


class Glints(Model):
    """Flakes as discrete flat facets at random places of the coat, each with its own normal."""

    diameter_um: Annotated[float, Field(ge=2, le=200)] = Field(
        description="median diameter of the flakes, weighted by their area, seen along the normal; "
        "of the log-normal distribution before its cut"
    )
    diameter_spread: Annotated[float, Field(ge=0, le=0.8)] = Field(
        description="standard deviation of ln(diameter); log-normal, cut at 3 standard deviations"
    )
    facet_roughness: Annotated[float, Field(ge=0.002, le=0.2)] = Field(
        description="standard deviation of the slopes within one flake, along one axis"
    )


@dataclass(frozen=True)
class DiscreteFacets:
    """Discrete facets of a coat, which replace the smooth lobe of their normals.

    Attributes
    ----------
    glints : sizes and roughness of the facets
    share : sum of the facets' areas over the area of the coat
    alpha : GGX alpha of the facets' normals
    bsdf : BSDF of a coat with only facets, for `mi.load_dict`
    """

    glints: Glints
    share: float
    alpha: float
    bsdf: dict[str, Any]


class Coating(Model):
    """Base class of all kinds of coat: texture, and reflection, which each kind defines."""

    kind: str
    # Excluded if None, so that digests of experiments with a smooth coat do not change.
    texture: Texture | None = Field(
        default=None,
        exclude_if=lambda texture: texture is None,
        description="absent: the coat is smooth",
    )

    differentiable: ClassVar[tuple[str, ...]] = ()
    """Names of the numbers by which bounds can be differentiated; `bsdf` is smooth in them."""

    albedo_field: ClassVar[str] = ""
    """Name of the number that a reference surface determines; reflected light is affine in it."""

    determined_by: ClassVar[Mapping[str, str]] = {}
    """By name of a number, the measurement from which `twin adopt` determines that number."""

    def bsdf(self) -> dict[str, Any]:
        """Return the BSDF of the coat as a dictionary for `mi.load_dict`.

        If two coats differ only in numbers that are floats in this dictionary, these floats are
        replaced in the loaded scene, without loading or compiling it again.

        Raises
        ------
        InputError : a file that the coat names cannot be used
        """
        raise NotImplementedError(f"{type(self).__name__}.bsdf")

    def bsdf_with_ink(self, albedo: dict[str, Any]) -> dict[str, Any]:
        """Return the BSDF with a texture instead of the albedo of the ink, see `albedo_over`."""
        raise NotImplementedError(f"{type(self).__name__}.bsdf_with_ink")

    def facets(self) -> DiscreteFacets | None:
        """Return the discrete facets of the coat; None if its reflection is smooth."""
        return None

    def albedo_over(self, reflectance: float) -> float | None:
        """Return the albedo of the ink in front of an object; None if the coat is opaque.

        Parameters
        ----------
        reflectance : reflectance of the object, 0 to 1; 0: no object touches the ink
        """
        return None

    def in_medium(self, ior: float) -> Self:
        """Return the coat with refractive indices relative to `ior`, that of the medium round it.

        Raises
        ------
        InputError : the model of this kind is not valid in a medium with that index
        """
        return self

    @property
    def is_matte(self) -> bool:
        """Whether the reflected radiance is equal in all directions (Lambertian)."""
        return False

    @property
    def export_gap(self) -> str:
        """Property of the coat that stock Mitsuba lacks, as a sentence; empty if there is none."""
        return ""


COATINGS: Registry[type[Coating]] = Registry("coatings", "twin.optics.coatings", kind_of)
"""Registry of the kinds of coatings."""

AnyCoating = Annotated[Coating, OneOf(COATINGS, default="flakes")]
