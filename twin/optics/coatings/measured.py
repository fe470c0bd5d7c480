"""Measured reflectance: a table of the RGL material database, at one wavelength.

Files and their parameters are those of J. Dupuy and W. Jakob, ACM Trans. Graph. 37, 274 (2018).
Mitsuba's own `measured` needs a spectral variant, and the twin is monochromatic: its table is read
here at the projector's wavelength.

Directions of reflected light between surfaces (render.bounces) are drawn by the table, as in
Mitsuba's `measured`, but with the density of this wavelength in place of the luminance. Compared
with the density of a matte surface (cosine), for tables of a GGX conductor of roughness 0.1 and
0.4: variance of the weight of one direction 1/2500 to 1/36000 and 1/230 to 1/1300, of a pixel's
light from two reflections in a corner 1/3.8 and 1/1.35 (the direction to the projector is not
drawn), run time of `add_bounces` 1.2 to 1.4 times. Tables without the factor `jacobian` keep the
density of a matte surface: their coordinates do not follow the reflected light.
"""

import struct
from collections.abc import Iterator
from functools import cache, lru_cache
from importlib import import_module
from math import prod
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field

from reconstruction.errors import InputError
from reconstruction.reading import read_bytes, regular_file
from twin.assets import mesh_path
from twin.config.coatings import COATINGS, Coating

_PLUGIN = "fringe_twin_measured"
_LEAST = 1e-3
_TYPES = {1: np.uint8, 10: np.float32}


@COATINGS.register
class Measured(Coating):
    """A coat with a reflectance that was measured by a gonioreflectometer, in air."""

    kind: Literal["measured"] = "measured"
    file: str = Field(description="table in the RGL material database's format, with spectra")
    wavelength_nm: Annotated[float, Field(ge=300, le=1100)] = Field(
        description="wavelength of the table's data: '= projector.wavelength_nm'"
    )

    def bsdf(self) -> dict[str, Any]:
        """Return the table's BSDF.

        Raises
        ------
        InputError : there is no such table, or it does not include the wavelength
        """
        import mitsuba as mi

        file = regular_file(mesh_path(self.file))
        stamp = str(file.stat().st_mtime_ns)
        _at_wavelength(_fields(str(file), stamp), self.wavelength_nm)
        _enter_plugin(mi.variant())
        parts = {"filename": str(file), "stamp": stamp, "wavelength_nm": self.wavelength_nm}
        return {"type": _PLUGIN, **parts}

    def in_medium(self, ior: float) -> Self:
        """Raise InputError: the reflectance in a layer does not follow from that in air.

        Raises
        ------
        InputError : always
        """
        raise InputError(
            "coating.kind: found 'measured', allowed 'flakes' or 'matte' within a layer: the table "
            "is valid in air; remove the layers, or use another coating"
        )

    @property
    def export_gap(self) -> str:
        """Stock Mitsuba takes its `measured` in spectral variants only."""
        return "coating.kind = 'measured' needs a spectral variant of stock Mitsuba"


@cache
def _enter_plugin(variant: str) -> None:
    """Register the BSDF with Mitsuba's current variant, once."""
    dr: Any = import_module("drjit")
    mi: Any = import_module("mitsuba")

    class Table(mi.BSDF):  # type: ignore[misc]
        """A table as a BSDF; names as in the paper."""

        def __init__(self, properties: Any) -> None:
            mi.BSDF.__init__(self, properties)
            self.m_components = [mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide]
            self.m_flags = self.m_components[0]
            fields = _fields(properties["filename"], properties["stamp"])
            spectra = _at_wavelength(fields, properties["wavelength_nm"])
            angles = [fields["phi_i"].tolist(), fields["theta_i"].tolist()]
            self._is_isotropic = len(angles[0]) <= 2
            self._has_jacobian = bool(fields["jacobian"][0])
            self._vndf = mi.MarginalContinuous2D2(fields["vndf"], angles)
            self._spectra = mi.MarginalContinuous2D2(spectra, angles, False, False)
            self._shares = mi.MarginalContinuous2D2(_density(spectra), angles)
            faces = (fields["ndf"], fields["sigma"])
            self._ndf, self._sigma = (
                mi.MarginalContinuous2D0(face, [], False, False) for face in faces
            )

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval_pdf(ctx, si, wo, active)[0]

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval_pdf(ctx, si, wo, active)[1]

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            angles = self._angles(si)
            half = dr.normalize(si.wi + wo)
            theta_m, phi_m = _spherical(half)
            u_m = _unit_square(theta_m, phi_m - angles.x if self._is_isotropic else phi_m)
            u_m.y -= dr.floor(u_m.y)
            place, lobe = self._vndf.invert(u_m, angles, active)
            density = mi.warp.square_to_cosine_hemisphere_pdf(wo)
            if self._has_jacobian:
                lobe *= self._shares.eval(place, angles, active)
                density = lobe / _solid_angle(u_m.x, theta_m, dr.dot(si.wi, half))
            lit = active & (si.wi.z > 0.0) & (wo.z > 0.0)
            value = dr.select(lit, self._value(place, u_m, angles, active), 0.0)
            return mi.Color1f(value), dr.select(lit, density, 0.0)

        def sample(self, ctx: Any, si: Any, s1: Any, s2: Any, active: Any = True) -> Any:
            drawn = dr.zeros(mi.BSDFSample3f, dr.width(s2))
            drawn.eta = 1.0
            drawn.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            if self._has_jacobian:
                drawn.wo, value, density = self._reflected(si, s2, active)
                lit = active & (si.wi.z > 0.0) & (drawn.wo.z > 0.0)
                drawn.pdf = dr.select(lit, density, 0.0)
            else:
                drawn.wo = mi.warp.square_to_cosine_hemisphere(s2)
                value, drawn.pdf = self.eval_pdf(ctx, si, drawn.wo, active)
                value = value.x
            return drawn, mi.Color1f(dr.select(drawn.pdf > 0.0, value / drawn.pdf, 0.0))

        def _angles(self, si: Any) -> Any:
            theta_i, phi_i = _spherical(si.wi)
            return mi.Vector2f(phi_i, theta_i)

        def _value(self, place: Any, u_m: Any, angles: Any, active: Any) -> Any:
            """Return the BSDF times cosine at a place of the spectra, with its half vector."""
            value = self._spectra.eval(place, angles, active)
            if self._has_jacobian:
                sigma = self._sigma.eval(_unit_square(angles.y, angles.x))
                value *= self._ndf.eval(u_m) / (4.0 * sigma)
            return value

        def _reflected(self, si: Any, s2: Any, active: Any) -> tuple[Any, Any, Any]:
            """Draw a half vector; return the reflected direction, its value and its density."""
            angles = self._angles(si)
            place, share = self._shares.sample(s2, angles, active)
            u_m, lobe = self._vndf.sample(place, angles, active)
            theta_m, phi_m = u_m.x**2 * (np.pi / 2.0), (2.0 * u_m.y - 1.0) * np.pi
            phi_m += angles.x if self._is_isotropic else 0.0
            radius, height = dr.sincos(theta_m)
            y, x = dr.sincos(phi_m)
            half = mi.Vector3f(radius * x, radius * y, height)
            cosine = dr.dot(si.wi, half)
            density = share * lobe / _solid_angle(u_m.x, theta_m, cosine)
            return 2.0 * cosine * half - si.wi, self._value(place, u_m, angles, active), density

        def to_string(self) -> str:
            return f"{_PLUGIN}[]"

    mi.register_bsdf(_PLUGIN, Table)


def _density(spectra: Any) -> Any:
    """Return the spectra with a least value, as a density: also rows of zeros can be normalised."""
    largest = spectra.max(axis=(-2, -1), keepdims=True)
    return np.maximum(spectra, np.where(largest > 0.0, _LEAST * largest, 1.0)).astype(np.float32)


def _solid_angle(u: Any, theta: Any, cosine: Any) -> Any:
    """Return the solid angle of reflected directions per area of the unit square, sr.

    Parameters
    ----------
    u, theta : half vector's first coordinate in the unit square, and its angle to the normal, rad
    cosine : of the angle between half vector and either direction
    """
    import drjit as dr

    return 4.0 * dr.maximum(cosine, _LEAST) * dr.maximum(2.0 * np.pi**2 * u * dr.sin(theta), 1e-6)


def _spherical(direction: Any) -> tuple[Any, Any]:
    """Return the angle to the normal, and the azimuth, of unit vectors; rad."""
    import drjit as dr

    chord = dr.norm(direction - type(direction)(0.0, 0.0, 1.0))
    return 2.0 * dr.safe_asin(0.5 * chord), dr.atan2(direction.y, direction.x)


def _unit_square(theta: Any, phi: Any) -> Any:
    """Return the coordinates of these angles in a table, 0 to 1."""
    import drjit as dr
    import mitsuba as mi

    return mi.Point2f(dr.sqrt(theta * (2.0 / np.pi)), (phi + np.pi) / (2.0 * np.pi))


@lru_cache(maxsize=2)
def _fields(file: str, stamp: str) -> dict[str, Any]:
    """Return the arrays of a table by name; `stamp` changes with the file, for the cache.

    Raises
    ------
    InputError : the file is no such table
    """
    try:
        fields = dict(_arrays(read_bytes(file)))
        phi, theta, wave = (len(fields[n]) for n in ("phi_i", "theta_i", "wavelengths"))
        rows = fields["spectra"].shape[3]
        if fields["spectra"].shape != (phi, theta, wave, rows, rows):
            raise ValueError(f"spectra: found the shape {fields['spectra'].shape}")
        if fields["vndf"].shape[:2] != (phi, theta) or wave < 2:
            raise ValueError(f"vndf: found the shape {fields['vndf'].shape}")
        _ = fields["ndf"].shape[1], fields["sigma"].shape[1], fields["jacobian"][0]
    except (struct.error, ValueError, KeyError, IndexError, TypeError) as error:
        raise InputError(f"coating.file: {file}: found no spectral table ({error!r})") from None
    return fields


def _arrays(content: bytes) -> Iterator[tuple[str, Any]]:
    """Yield name and array of each field; the header has names, types, offsets and shapes."""
    if not content.startswith(b"tensor_file\0"):
        raise ValueError("no tensor file")
    (count,) = struct.unpack_from("<I", content, 14)
    at = 18
    for _ in range(count):
        (length,) = struct.unpack_from("<H", content, at)
        name = content[at + 2 : at + 2 + length].decode()
        axes, kind, offset = struct.unpack_from("<HBQ", content, at + 2 + length)
        shape = struct.unpack_from(f"<{axes}Q", content, at + 13 + length)
        at += 13 + length + 8 * axes
        if kind in _TYPES:
            values = np.frombuffer(content, _TYPES[kind], prod(shape), offset)
            yield name, values.reshape(shape).copy()


def _at_wavelength(fields: dict[str, Any], wavelength_nm: float) -> Any:
    """Return the spectra interpolated to a wavelength, (phi, theta, row, col).

    Raises
    ------
    InputError : the table has no such wavelength
    """
    known = fields["wavelengths"]
    if not known[0] <= wavelength_nm <= known[-1]:
        raise InputError(
            f"coating.wavelength_nm: found {wavelength_nm:g}, allowed {known[0]:g} to "
            f"{known[-1]:g}, the wavelengths of the table"
        )
    above = min(max(int(np.searchsorted(known, wavelength_nm)), 1), len(known) - 1)
    share = (wavelength_nm - known[above - 1]) / (known[above] - known[above - 1])
    low, high = fields["spectra"][:, :, above - 1], fields["spectra"][:, :, above]
    return np.ascontiguousarray((1.0 - share) * low + share * high, np.float32)
