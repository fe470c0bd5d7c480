"""Specimen kind `height_map`: a relief with heights from an image, NPY or netCDF file."""

from typing import Literal

import numpy as np
from pydantic import Field

from reconstruction.errors import InputError
from twin.config.bounds import FileUnit, Length, Size
from twin.config.specimen_base import SPECIMENS, Specimen
from twin.specimens.height_files import MapFile
from twin.specimens.meshes import MeshShape
from twin.specimens.solids import height_grid_body

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
        source = MapFile("specimen", self.file, self.pixel_mm, self.unit_mm, self.variable)
        z = source.read_mm()
        relief_mm = float(np.ptp(z))
        if relief_mm > _MOST_RELIEF_MM:
            raise InputError(
                f"specimen.unit_mm: {self.file} then has a relief of {relief_mm:.3g} mm, "
                f"allowed up to {_MOST_RELIEF_MM:g} mm"
            )
        return MeshShape(height_grid_body(*source.axes_mm(z), z, float(z.min()) - self.base_mm))
