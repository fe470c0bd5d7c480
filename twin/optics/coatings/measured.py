"""Measured reflectance: a table of the RGL material database, at one wavelength.

Files and their parameters are those of J. Dupuy and W. Jakob, ACM Trans. Graph. 37, 274 (2018).
Mitsuba's own `measured` needs a spectral variant, but the twin uses a monochromatic variant. This
module therefore interpolates the table to one wavelength, normally that of the projector. For
indirect light (`render.bounces`) the directions of reflection are drawn in proportion to the
cosine, so that a glossy table needs more `bounce_paths`.
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
        """Return the BSDF of the table, a dictionary for `mi.load_dict`.

        Raises
        ------
        InputError : the file is missing or is no spectral table, or the wavelength is outside it
        """
        import mitsuba as mi

        file = regular_file(mesh_path(self.file))
        stamp = str(file.stat().st_mtime_ns)
        _at_wavelength(_fields(str(file), stamp), self.wavelength_nm)
        _enter_plugin(mi.variant())
        parts = {"filename": str(file), "stamp": stamp, "wavelength_nm": self.wavelength_nm}
        return {"type": _PLUGIN, **parts}

    def in_medium(self, ior: float) -> Self:
        """Raise InputError, because the table is valid in air and not in a layer.

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
        """Reason why the coat cannot be exported: `measured` needs a spectral variant."""
        return "coating.kind = 'measured' needs a spectral variant of stock Mitsuba"


@cache
def _enter_plugin(variant: str) -> None:
    """Register the BSDF of tables with the current Mitsuba variant, once for each variant."""
    dr: Any = import_module("drjit")
    mi: Any = import_module("mitsuba")

    class Table(mi.BSDF):  # type: ignore[misc]
        """A measured table as a BSDF; variables are named as by Dupuy and Jakob (2018)."""

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
            faces = (fields["ndf"], fields["sigma"])
            self._ndf, self._sigma = (
                mi.MarginalContinuous2D0(face, [], False, False) for face in faces
            )

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            theta_i, phi_i = _spherical(si.wi)
            theta_m, phi_m = _spherical(dr.normalize(si.wi + wo))
            u_m = _unit_square(theta_m, phi_m - phi_i if self._is_isotropic else phi_m)
            u_m.y -= dr.floor(u_m.y)
            angles = mi.Vector2f(phi_i, theta_i)
            value = self._spectra.eval(self._vndf.invert(u_m, angles, active)[0], angles, active)
            if self._has_jacobian:
                sigma = self._sigma.eval(_unit_square(theta_i, phi_i))
                value *= self._ndf.eval(u_m) / (4.0 * sigma)
            return mi.Color1f(dr.select(active & (si.wi.z > 0.0) & (wo.z > 0.0), value, 0.0))

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return dr.select(si.wi.z > 0.0, mi.warp.square_to_cosine_hemisphere_pdf(wo), 0.0)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def sample(self, ctx: Any, si: Any, s1: Any, s2: Any, active: Any = True) -> Any:
            drawn = dr.zeros(mi.BSDFSample3f, dr.width(s2))
            drawn.wo, drawn.eta = mi.warp.square_to_cosine_hemisphere(s2), 1.0
            drawn.pdf = self.pdf(ctx, si, drawn.wo)
            drawn.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            lit = active & (drawn.pdf > 0.0)
            value = self.eval(ctx, si, drawn.wo, lit) / drawn.pdf
            return drawn, mi.Color1f(dr.select(lit, value.x, 0.0))

        def to_string(self) -> str:
            return f"{_PLUGIN}[]"

    mi.register_bsdf(_PLUGIN, Table)


def _spherical(direction: Any) -> tuple[Any, Any]:
    """Return the polar angle (to the normal, z) and the azimuth of unit vectors, rad."""
    import drjit as dr

    chord = dr.norm(direction - type(direction)(0.0, 0.0, 1.0))
    return 2.0 * dr.safe_asin(0.5 * chord), dr.atan2(direction.y, direction.x)


def _unit_square(theta: Any, phi: Any) -> Any:
    """Return the table coordinates (0 to 1) of polar angle `theta` and azimuth `phi`, rad."""
    import drjit as dr
    import mitsuba as mi

    return mi.Point2f(dr.sqrt(theta * (2.0 / np.pi)), (phi + np.pi) / (2.0 * np.pi))


@lru_cache(maxsize=2)
def _fields(file: str, stamp: str) -> dict[str, Any]:
    """Return the arrays of a table file by the name of their field.

    Parameters
    ----------
    stamp : time of the file's last change, so that a changed file is not taken from the cache

    Raises
    ------
    InputError : the file is no table with spectra
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
    """Yield the name and the array of each uint8 or float32 field in a table file's content.

    The header of the file contains the names, types, offsets and shapes of all fields.
    """
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
    """Return the table's spectra at one wavelength, linearly interpolated, (phi, theta, row, col).

    Raises
    ------
    InputError : the wavelength is outside the range of the table
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
