"""Specimen kind `bars`: bars of known widths on a plate."""

from math import inf
from typing import Annotated, Literal

from pydantic import Field, model_validator

from twin.config.bounds import OptionalSize, Size
from twin.config.nominal import NominalBar, NominalStep
from twin.config.specimen_base import SPECIMENS, Specimen, require_at_most
from twin.specimens.catalogue import Assembly
from twin.specimens.meshes import block
from twin.specimens.rows import middles_mm, plate_under, require_edge, row_width_mm


@SPECIMENS.register
class Bars(Specimen):
    """Parallel rectangular bars of equal height along y, on a plate: several known widths."""

    kind: Literal["bars"] = "bars"
    widths_mm: Annotated[tuple[Size, ...], Field(min_length=1, max_length=12)] = Field(
        default=(1.99, 4.81, 7.23), description="from -x to +x"
    )
    gap_mm: OptionalSize = Field(default=1.0, description="clearance between neighbours")
    height_mm: Size = Field(default=1.5, description="assumed: above the plate")
    length_mm: Size = 15.0
    edge_radius_mm: OptionalSize = Field(
        default=0.1, description="assumed: rounding of all edges, the plate's as well"
    )
    plate_mm: Size = Field(default=2.0, description="thickness of the plate")
    margin_mm: OptionalSize = Field(default=1.0, description="plate beyond the row")

    @model_validator(mode="after")
    def _fits(self) -> "Bars":
        require_edge(self.edge_radius_mm, (*self.widths_mm, self.height_mm, self.length_mm))
        require_at_most("edge_radius_mm", self.edge_radius_mm, self.plate_mm / 4, "of plate_mm")
        return self

    @property
    def middles_mm(self) -> tuple[float, ...]:
        """Position of each bar's middle along x, from -x to +x; the row is centred."""
        return middles_mm(self.widths_mm, self.gap_mm)

    def shape(self) -> Assembly:
        """Return the bars along y on a plate; its upper face is z = 0.

        The bars extend into the plate by half its thickness.
        """
        low, high, y = -self.plate_mm / 2, self.height_mm, self.length_mm / 2
        bars = [
            block((x - w / 2, -y, low), (x + w / 2, y, high), self.edge_radius_mm)
            for x, w in zip(self.middles_mm, self.widths_mm, strict=True)
        ]
        outline = row_width_mm(self.widths_mm, self.gap_mm), self.length_mm
        plate = plate_under(outline, self.plate_mm, self.margin_mm, self.edge_radius_mm)
        return Assembly((*bars, plate))

    def nominal_features(self) -> tuple[NominalBar | NominalStep, ...]:
        """Return the nominal bars from -x to +x, and a step with their height above the plate."""
        gap_mm = self.gap_mm if len(self.widths_mm) > 1 else inf
        sizes = self.length_mm, self.edge_radius_mm
        row = zip(self.middles_mm, self.widths_mm, strict=True)
        bars = [NominalBar(width, *sizes, middle, gap_mm) for middle, width in row]
        return (*bars, NominalStep(self.height_mm))
