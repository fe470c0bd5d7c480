"""Read maps of lengths from files: grey images, NPY arrays and netCDF files."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError, one_line
from reconstruction.reading import is_regular
from twin.assets import mesh_path

_TYPES = (".png", ".tif", ".tiff", ".bmp", ".pgm", ".exr", ".npy", ".nc")
# A pixel has two facets; with more pixels a press and the renderer would take gigabytes of memory.
_MOST_PIXELS = 4_000_000
_SIZE_MM = 0.1, 1000.0


@dataclass(frozen=True)
class MapFile:
    """File with a map, as a table of an experiment describes it; first row at +y.

    Attributes
    ----------
    table : name of the table, for messages
    pixel_mm : distance between the middles of neighbouring pixels
    unit_mm : length of one unit of the file; None: 1 for floating-point numbers in mm
    variable : netCDF: name of the map; empty: the only one
    quantity : quantity that the map contains, in the singular, for messages
    """

    table: str
    file: str
    pixel_mm: float
    unit_mm: float | None
    variable: str
    quantity: str = "height"

    def read_mm(self) -> FloatArray:
        """Return the map (row, col), mm, with rows along +y and columns along +x.

        Raises
        ------
        InputError : the file is missing or no map of finite numbers, or its size is implausible
        """
        values, unit = self._read()
        lengths_mm = values.astype(np.float64)[::-1] * self._scale_mm(values, unit)
        self._check(lengths_mm)
        return lengths_mm

    def axes_mm(self, map_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return x (col,) and y (row,) of the pixels' middles; the map's middle is at 0."""
        x, y = ((np.arange(n) - (n - 1) / 2) * self.pixel_mm for n in map_mm.shape[::-1])
        return x, y

    @property
    def _key(self) -> str:
        return f"{self.table}.file"

    def _read(self) -> tuple[NDArray[Any], str]:
        """Return the file's values (row, col) and their unit, empty if the file states none."""
        path = mesh_path(self.file)
        suffix = path.suffix.lower()
        if not is_regular(path):
            raise InputError(f"{self._key}: {self.file}: found no file there")
        if suffix not in _TYPES:
            raise InputError(
                f"{self._key}: {self.file}: no {self.quantity} map, allowed: {', '.join(_TYPES)}"
            )
        try:
            content = _read_netcdf(path, self.variable) if suffix == ".nc" else (_read(path), "")
        except (InputError, OSError) as error:
            raise InputError(f"{self._key}: {one_line(error)}") from error
        values = content[0]
        if values.ndim != 2 or min(values.shape) < 2 or values.dtype.kind not in "iuf":
            described = f"{values.dtype} of shape {values.shape}"
            raise InputError(
                f"{self._key}: {self.file}: found {described}, allowed numbers (row, col)"
            )
        return content

    def _scale_mm(self, values: NDArray[Any], unit: str) -> float:
        """Return the length of one unit of the file, mm."""
        if self.unit_mm is not None:
            return self.unit_mm
        if values.dtype.kind != "f" or unit not in ("", "mm"):
            kind = f"the unit '{unit}'" if unit else f"integers ({values.dtype})"
            raise InputError(
                f"{self.table}.unit_mm: missing; {self.file} has {kind}: add the {self.quantity} "
                "in mm of one unit"
            )
        return 1.0

    def _check(self, map_mm: FloatArray) -> None:
        if not np.isfinite(map_mm).all():
            raise InputError(
                f"{self._key}: {self.file}: found {self.quantity}s that are no numbers; fill them "
                "in"
            )
        if map_mm.size > _MOST_PIXELS:
            raise InputError(
                f"{self._key}: {self.file}: found {map_mm.shape[1]} x {map_mm.shape[0]} px, "
                f"allowed {_MOST_PIXELS / 1e6:g} million; average neighbours, or cut out a part"
            )
        side_mm = (max(map_mm.shape) - 1) * self.pixel_mm
        if not _SIZE_MM[0] <= side_mm <= _SIZE_MM[1]:
            raise InputError(
                f"{self.table}.pixel_mm: found {self.pixel_mm:g}, which makes the longest side "
                f"{side_mm:.3g} mm, allowed {_SIZE_MM[0]:g} to {_SIZE_MM[1]:g} mm"
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
