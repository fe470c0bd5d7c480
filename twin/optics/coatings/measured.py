"""Measured reflectance: a table of the RGL material database, at one wavelength.

Files and their parameters are those of J. Dupuy and W. Jakob, ACM Trans. Graph. 37, 274 (2018).
Mitsuba's own `measured` needs a spectral variant, but the twin uses a monochromatic variant. This
module therefore interpolates the table to one wavelength, normally that of the projector.
`reflectance_table` evaluates the table and draws directions by it.
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
    from twin.optics.reflectance_table import ReflectanceTable

    class Table(mi.BSDF):  # type: ignore[misc]
        """A table as a BSDF."""

        def __init__(self, properties: Any) -> None:
            mi.BSDF.__init__(self, properties)
            self.m_components = [mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide]
            self.m_flags = self.m_components[0]
            fields = _fields(properties["filename"], properties["stamp"])
            self._table = ReflectanceTable(
                fields, _at_wavelength(fields, properties["wavelength_nm"])
            )

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval_pdf(ctx, si, wo, active)[0]

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval_pdf(ctx, si, wo, active)[1]

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            value, density = self._table.value_and_density(si.wi, wo, active)
            return mi.Color1f(value), density

        def sample(self, ctx: Any, si: Any, s1: Any, s2: Any, active: Any = True) -> Any:
            drawn = dr.zeros(mi.BSDFSample3f, dr.width(s2))
            drawn.wo, value, drawn.pdf = self._table.draw(si.wi, s2, active)
            drawn.eta = 1.0
            drawn.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            return drawn, mi.Color1f(dr.select(drawn.pdf > 0.0, value / drawn.pdf, 0.0))

        def to_string(self) -> str:
            return f"{_PLUGIN}[]"

    mi.register_bsdf(_PLUGIN, Table)


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
