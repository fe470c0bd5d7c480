"""Specimen kind `rods`: rods on a plate (the paper's acrylic rods)."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from twin.config.bounds import OptionalSize, Size
from twin.config.nominal import NominalRod
from twin.config.specimen_base import SPECIMENS, Specimen, require_at_most
from twin.shape import Shape
from twin.specimens.catalogue import Assembly
from twin.specimens.closed_form import Cylinder
from twin.specimens.meshes import block
from twin.specimens.rows import middles_mm, plate_under, row_width_mm


@SPECIMENS.register
class Rods(Specimen):
    """Parallel rods along y, cemented to a plate (the paper's acrylic rods)."""

    kind: Literal["rods"] = "rods"
    diameters_mm: Annotated[tuple[Size, ...], Field(min_length=1, max_length=12)] = Field(
        default=(1.99, 4.81, 7.23), description="from -x to +x"
    )
    gap_mm: OptionalSize = Field(default=1.0, description="clearance between neighbours")
    length_mm: Size = 12.0
    edge_radius_mm: Size = Field(
        default=0.1, description="rounding of the end faces' edge and of the plate's edges"
    )
    plate_mm: Size = Field(default=2.0, description="thickness of the plate")
    margin_mm: OptionalSize = Field(default=1.0, description="plate beyond the outermost rods")
    bead_mm: Size = Field(default=0.5, description="width of the cement bead under each rod")

    @model_validator(mode="after")
    def _fits(self) -> "Rods":
        thinnest = min(self.diameters_mm)
        half = "0.5 x the thinnest rod's diameter"
        require_at_most("bead_mm", self.bead_mm, thinnest / 2, half)
        require_at_most("edge_radius_mm", self.edge_radius_mm, thinnest / 4, f"0.25 x {thinnest:g}")
        require_at_most("edge_radius_mm", self.edge_radius_mm, self.length_mm / 4, "of length_mm")
        return self

    @property
    def middles_mm(self) -> tuple[float, ...]:
        """Position of each rod's axis along x, from -x to +x; the row is centred.

        All rods are on one plate. The clearance between neighbours is measured between their
        outlines in plan, also if their diameters are unequal.
        """
        return middles_mm(self.diameters_mm, self.gap_mm)

    def shape(self) -> Assembly:
        """Return the rods along y on a plate; its upper face is z = 0.

        A rod touches the plate along a line. A bead of cement under each rod joins rod and plate to
        one body; neither the elastomer nor light from above reaches the bead.
        """
        rods = list(zip(self.middles_mm, self.diameters_mm, strict=True))
        cylinders = [self._lying(x, diameter) for x, diameter in rods]
        beads = [self._bead(x, diameter) for x, diameter in rods]
        outline = row_width_mm(self.diameters_mm, self.gap_mm), self.length_mm
        plate = plate_under(outline, self.plate_mm, self.margin_mm, self.edge_radius_mm)
        return Assembly((*cylinders, *beads, plate))

    def nominal_features(self) -> tuple[NominalRod, ...]:
        """Return the nominal rods from -x to +x."""
        sizes = self.length_mm, self.edge_radius_mm
        row = zip(self.middles_mm, self.diameters_mm, strict=True)
        return tuple(NominalRod(diameter / 2, *sizes, middle) for middle, diameter in row)

    def _lying(self, x_mm: float, diameter_mm: float) -> Cylinder:
        middle, along_y = np.array([x_mm, 0.0, diameter_mm / 2]), np.array([0.0, 1.0, 0.0])
        return Cylinder(middle, along_y, diameter_mm / 2, self.length_mm / 2, self.edge_radius_mm)

    def _bead(self, x_mm: float, diameter_mm: float) -> Shape:
        half, end = self.bead_mm / 2, (self.length_mm - self.edge_radius_mm) / 2
        low = (x_mm - half, -end, -self.plate_mm / 2)
        return block(low, (x_mm + half, end, diameter_mm / 2), 0.0)
