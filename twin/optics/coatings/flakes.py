"""Gray ink with aluminium flakes.

Fraction `1 - flake_fraction` of the surface is ink, the rest a rough conductor (GGX). The ink is a
diffuse pigment, bare or under a clear binder with a rough Fresnel interface. Light is reflected
repeatedly between pigment and binder interface (J. L. Saunderson, J. Opt. Soc. Am. 32, 727 (1942)),
so that a binder darkens the pigment. The blend is convex and no lobe reflects more than the
incident light, so that the model conserves energy.

Flakes below the binder's interface are not modelled: all flakes are bare. Repeated scattering at
one rough interface is not modelled either: this light is lost, as in all single-scattering
microfacet models. The lost light of a white pigment under a binder of index 1.5 depends on the
roughness: for 0.02, 0.1, 0.2, 0.3 it is 3, 9, 20, 31 % at normal view, 2, 12, 24, 36 % at 80 deg
and up to 11, 13, 25, 40 % at 89 deg.

An object behind a thin ink increases the reflectance of the ink. The ink reflects the share R of
incident light and transmits the share T. An object in contact reflects the share r of the
transmitted light. Light is reflected repeatedly between ink and object, so that
R_contact = R + T^2 r / (1 - R r) (Kubelka and Munk 1931, a layer on a ground; G. Kortuem,
Reflectance Spectroscopy, Springer 1969).
"""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from reconstruction.errors import InputError
from twin.config.base import Fraction
from twin.config.bounds import Extinction, MetalIndex
from twin.config.coatings import COATINGS, Coating, DiscreteFacets, Glints
from twin.optics.bsdfs import level, microfacets


@COATINGS.register
class Flakes(Coating):
    """Gray ink with aluminium flakes: a blend of a diffuse and a rough conducting reflector.

    The ink is pigment in a clear binder. If `binder_ior` is above 1, the binder's outer interface
    has a Fresnel reflection on both sides. If it is 1, there is no optical interface and the ink is
    matte.
    """

    # Not written to files: it is the default kind.
    kind: Literal["flakes"] = Field(default="flakes", exclude_if=lambda kind: kind == "flakes")
    base_albedo: Annotated[float, Field(gt=0, lt=1)] = Field(
        description="share of light that the pigment reflects, inside the binder"
    )
    flake_fraction: Fraction
    flake_roughness: Annotated[float, Field(ge=0.05, le=1)] = Field(
        description="GGX alpha of the flakes' normals"
    )
    flake_ior: MetalIndex = Field(
        title="flake refractive index n", description="real part n of the flakes' complex index"
    )
    flake_extinction: Extinction = Field(
        title="k", description="imaginary part k of the complex index"
    )
    binder_ior: Annotated[float, Field(ge=1, le=1.6)] = Field(
        default=1.0, description="index of the clear binder over the pigment; 1 is a matte ink"
    )
    binder_roughness: Annotated[float, Field(ge=0.02, le=0.3)] = Field(
        default=0.1,
        description="GGX alpha of the binder's interface; no effect at binder_ior = 1. The model "
        "loses light scattered twice at it: 9 % at 0.1 and 31 % at 0.3 on a white pigment; at 80 "
        "deg off the normal 12 and 36 % (index 1.5)",
    )
    # Excluded if absent: the digests of opaque coats do not change.
    transmittance: Fraction = Field(
        default=0.0,
        exclude_if=lambda share: share == 0.0,
        description="share of light that the ink transmits; an object in contact reflects it, so "
        "that the contact is brighter (contact_face, photometric_stereo)",
    )

    # Excluded if absent: the digests of smooth coats do not change.
    glints: Glints | None = Field(
        default=None,
        exclude_if=lambda glints: glints is None,
        description="flakes as discrete facets (fringes only); absent: their mean, without glints",
    )

    differentiable = ("base_albedo", "flake_fraction", "flake_roughness")
    albedo_field = "base_albedo"
    determined_by: ClassVar[Mapping[str, str]] = {
        "base_albedo": "a reference of known albedo (--reference)",
        "flake_fraction": "captures under several angles",
        "flake_roughness": "captures under several angles",
    }

    @model_validator(mode="after")
    def _no_light_is_made(self) -> Self:
        if self.base_albedo + self.transmittance > 1:
            raise ValueError(
                f"transmittance: found {self.transmittance:g}, allowed at most "
                f"{1 - self.base_albedo:g}, 1 - base_albedo; lower one of them"
            )
        return self

    @model_validator(mode="after")
    def _flakes_are_smoother_than_the_coat(self) -> Self:
        if self.glints is None or self.glints.facet_roughness <= self.flake_roughness / 2:
            return self
        raise ValueError(
            f"glints.facet_roughness: found {self.glints.facet_roughness:g}, allowed at most "
            f"{self.flake_roughness / 2:g}, 0.5 x flake_roughness; lower it, or raise "
            "flake_roughness"
        )

    def bsdf(self) -> dict[str, Any]:
        """Return the BSDF, a blend of ink and flakes, as a dictionary for `mi.load_dict`."""
        return self.bsdf_with_ink(level(self.base_albedo))

    def bsdf_with_ink(self, albedo: dict[str, Any]) -> dict[str, Any]:
        """Return the BSDF as `bsdf`, but with the texture `albedo` as the pigment's albedo."""
        return {
            "type": "blendbsdf",
            "weight": self.flake_fraction,
            "bsdf_0": self._ink(albedo),
            "bsdf_1": self._flakes(),
        }

    def facets(self) -> DiscreteFacets | None:
        """Return the flakes as discrete facets; None without `glints`, or without flakes."""
        if self.glints is None or self.flake_fraction == 0.0:
            return None
        return DiscreteFacets(
            self.glints, self.flake_fraction, self.flake_roughness, self._flakes()
        )

    def _flakes(self) -> dict[str, Any]:
        return microfacets(
            "conductor",
            self.flake_roughness,
            eta=level(self.flake_ior),
            k=level(self.flake_extinction),
        )

    def _ink(self, albedo: dict[str, Any]) -> dict[str, Any]:
        if self.binder_ior == 1.0:
            return {"type": "diffuse", "reflectance": albedo}
        return microfacets(
            "plastic",
            self.binder_roughness,
            int_ior=self.binder_ior,
            ext_ior=1.0,
            nonlinear=True,  # each inter-reflection below the binder multiplies by the albedo
            diffuse_reflectance=albedo,
        )

    def albedo_over(self, reflectance: float) -> float | None:
        """Return the albedo of the ink with an object behind it; None if the ink is opaque.

        Parameters
        ----------
        reflectance : normal reflectance of the object; 0: no object touches the ink
        """
        if not self.transmittance:
            return None
        ink = self.base_albedo
        return ink + self.transmittance**2 * reflectance / (1.0 - ink * reflectance)

    def in_medium(self, ior: float) -> Self:
        """Return the coat with indices relative to `ior`, the refractive index around the coat.

        A matte ink (`binder_ior` of 1) has no binder interface and is valid for any `ior`.

        Raises
        ------
        InputError : `binder_ior` is above 1 and below `ior`
        """
        if 1.0 < self.binder_ior < ior:
            raise InputError(
                f"coating.binder_ior: found {self.binder_ior:g}, allowed 1 (matte), or at least "
                f"{ior:g}, the index of the layer around the coat; set it to 1"
            )
        relative = {
            "flake_ior": self.flake_ior / ior,
            "flake_extinction": self.flake_extinction / ior,
            "binder_ior": max(self.binder_ior / ior, 1.0),
        }
        return self.model_copy(update=relative)

    @property
    def export_gap(self) -> str:
        """Reason why a coat with glints cannot be exported; empty without glints."""
        return "" if self.facets() is None else "coating.glints has no form in stock Mitsuba"

    @property
    def is_matte(self) -> bool:
        """Whether the coat is an ideal diffuse reflector: no flakes and no binder interface."""
        return self.flake_fraction == 0.0 and self.binder_ior == 1.0
