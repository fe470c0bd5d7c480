"""Specimen kind `height_map`: a relief with heights from an image, NPY or netCDF file."""

from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError, one_line
from reconstruction.reading import is_regular
from twin.assets import mesh_path
from twin.config.bounds import FileUnit, Length, Size
from twin.config.specimen_base import SPECIMENS, Specimen
from twin.specimens.meshes import MeshShape
from twin.specimens.solids import height_grid_body

_KEY = "specimen.file"
_TYPES = (".png", ".tif", ".tiff", ".bmp", ".pgm", ".exr", ".npy", ".nc")
# A pixel has two facets; with more pixels a press and the renderer would take gigabytes of memory.
_MOST_PIXELS = 4_000_000
_SIZE_MM = 0.1, 1000.0
_MOST_RELIEF_MM = 100.0


@SPECIMENS.register
class HeightMapFile(Specimen):
    """A relief with upright sides, given by a file of its heights on a grid.

    The file is a grey image (PNG, TIFF, BMP, PGM or EXR), an NPY array or a netCDF file.
    """

    kind: Literal["height_map"] = "height_map"
    file: str = Field(
        description="path of a grey image (PNG, TIFF, BMP, PGM, EXR), an NPY array or a netCDF "
        "file; first row at +y, values are heights at the pixels' middles"
    )
    pixel_mm: Length = Field(description="distance between the middles of neighbouring pixels")
    unit_mm: FileUnit | None = Field(
        default=None,
        description="height of one unit of the file: required for integers and for units other "
        "than mm; default for floating-point numbers: 1",
    )
    variable: str = Field(default="", description="netCDF: name of the map; default: the only one")
    base_mm: Size = Field(default=2.0, description="thickness below the lowest height")

    def shape(self) -> MeshShape:
        """Return the relief as a body with vertical sides and a flat base, centred on x = y = 0.

        Raises
        ------
        InputError : the file is missing or no map of finite heights, or its size is implausible
        """
        values, unit = self._read()
        z = values.astype(np.float64)[::-1] * self._scale_mm(values, unit)
        self._check(z)
        x, y = ((np.arange(n) - (n - 1) / 2) * self.pixel_mm for n in z.shape[::-1])
        return MeshShape(height_grid_body(x, y, z, float(z.min()) - self.base_mm))

    def _read(self) -> tuple[NDArray[Any], str]:
        """Return the file's values (row, col) and their unit, empty if the file states none."""
        path = mesh_path(self.file)
        suffix = path.suffix.lower()
        if not is_regular(path):
            raise InputError(f"{_KEY}: {self.file}: found no file there")
        if suffix not in _TYPES:
            raise InputError(f"{_KEY}: {self.file}: no height map, allowed: {', '.join(_TYPES)}")
        try:
            content = _read_netcdf(path, self.variable) if suffix == ".nc" else (_read(path), "")
        except (InputError, OSError) as error:
            raise InputError(f"{_KEY}: {one_line(error)}") from error
        values = content[0]
        if values.ndim != 2 or min(values.shape) < 2 or values.dtype.kind not in "iuf":
            described = f"{values.dtype} of shape {values.shape}"
            raise InputError(f"{_KEY}: {self.file}: found {described}, allowed numbers (row, col)")
        return content

    def _scale_mm(self, values: NDArray[Any], unit: str) -> float:
        """Return the height of one unit of the file, mm."""
        if self.unit_mm is not None:
            return self.unit_mm
        if values.dtype.kind != "f" or unit not in ("", "mm"):
            kind = f"the unit '{unit}'" if unit else f"integers ({values.dtype})"
            raise InputError(
                f"specimen.unit_mm: missing; {self.file} has {kind}: add the height in mm "
                "of one unit"
            )
        return 1.0

    def _check(self, z_mm: FloatArray) -> None:
        if not np.isfinite(z_mm).all():
            raise InputError(
                f"{_KEY}: {self.file}: found heights that are no numbers; fill them in"
            )
        if z_mm.size > _MOST_PIXELS:
            raise InputError(
                f"{_KEY}: {self.file}: found {z_mm.shape[1]} x {z_mm.shape[0]} px, allowed "
                f"{_MOST_PIXELS / 1e6:g} million; average neighbours, or cut out a part"
            )
        side_mm, relief_mm = (max(z_mm.shape) - 1) * self.pixel_mm, float(np.ptp(z_mm))
        if not _SIZE_MM[0] <= side_mm <= _SIZE_MM[1]:
            raise InputError(
                f"specimen.pixel_mm: found {self.pixel_mm:g}, which makes the longest side "
                f"{side_mm:.3g} mm, allowed {_SIZE_MM[0]:g} to {_SIZE_MM[1]:g} mm"
            )
        if relief_mm > _MOST_RELIEF_MM:
            raise InputError(
                f"specimen.unit_mm: {self.file} then has a relief of {relief_mm:.3g} mm, "
                f"allowed up to {_MOST_RELIEF_MM:g} mm"
            )


def _read(path: Path) -> NDArray[Any]:
    from reconstruction.capture.image_files import read_image
    from reconstruction.capture.raw_images import read_npy

    return read_npy(path) if path.suffix.lower() == ".npy" else read_image(path)


def _read_netcdf(path: Path, variable: str) -> tuple[NDArray[Any], str]:
    from reconstruction.netcdf import read_arrays

    arrays = read_arrays(path)
    maps = {name: item for name, item in arrays.variables.items() if item[1].ndim == 2}
    chosen = [variable] if variable else list(maps)
    if len(chosen) != 1 or chosen[0] not in maps:
        given = f"'{variable}'" if variable else "no name"
        names = ", ".join(maps) or "none, the file has no map"
        raise InputError(f"{path}: variable: found {given}, allowed: {names}")
    _, values, attributes = maps[chosen[0]]
    return values, str(attributes.get("units", ""))
