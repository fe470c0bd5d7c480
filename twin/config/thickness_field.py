"""Thickness of a thin sheet as cast: table `[elastomer.thickness_field]`."""

from typing import Annotated

from pydantic import Field, model_validator

from twin.config.base import Angle, Model
from twin.config.bounds import Because, FileUnit, Length


class ThicknessField(Model):
    """Deviation of the undeformed thickness from its mean over the sheet, `thickness_mm`.

    It is the sum of random waves, a wedge and a measured map. x and y are coordinates on the
    undeformed sheet, parallel to world x and y, from the centre of the frame.
    """

    rms_um: Annotated[
        float, Field(ge=0, le=500), Because("500 um is half of the thickest sheet's thickness")
    ] = Field(default=0.0, description="root mean square of the waves over the sheet")
    correlation_mm: Annotated[
        float, Field(ge=0.3, le=100), Because("shorter waves are texture of a face")
    ] = Field(default=5.0, description="lag at which the autocorrelation of the waves is 1/e")
    seed: Annotated[int, Field(ge=0, le=2**31 - 1)] = Field(
        default=1, description="of the waves: one number per piece of sheet"
    )
    slope_um_per_mm: Annotated[
        float, Field(ge=0, le=500), Because("0.5 mm per mm is the slope of no cast sheet")
    ] = Field(default=0.0, description="of the wedge")
    slope_deg: Angle = Field(
        default=0.0, description="direction in which the wedge gets thicker, from x towards y"
    )
    file: str | None = Field(
        default=None,
        description="map of the measured thickness: path of a grey image (PNG, TIFF, BMP, PGM, "
        "EXR), an NPY array or a netCDF file; first row at +y, centred on the sheet, which it "
        "must cover; its mean over the sheet is replaced by thickness_mm",
    )
    pixel_mm: Length | None = Field(
        default=None, description="of the map: distance between the middles of neighbouring pixels"
    )
    unit_mm: FileUnit | None = Field(
        default=None,
        description="of the map: thickness of one unit of the file; required for integers and "
        "for units other than mm; default for floating-point numbers: 1",
    )
    variable: str = Field(default="", description="netCDF: name of the map; default: the only one")

    @model_validator(mode="after")
    def _map_has_its_pixel(self) -> "ThicknessField":
        if self.file is not None and self.pixel_mm is None:
            raise ValueError("pixel_mm: missing; a map in `file` needs its pixel's width in mm")
        if self.file is None and (self.pixel_mm, self.unit_mm, self.variable) != (None, None, ""):
            raise ValueError("pixel_mm, unit_mm, variable: of a map; add `file`, or remove them")
        return self
