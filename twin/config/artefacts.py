"""Artefacts with a known profile as data: rods and bars on a plate, a step, a V groove.

All show their profile along the specimen's x axis and are uniform along y, as the grating does.
"""

from itertools import pairwise
from math import radians, tan
from typing import Annotated, Literal

from pydantic import Field, model_validator

from twin.config.specimen_base import OptionalSize, Size, Specimen, require_at_most


class Rods(Specimen):
    """Rods lying side by side along y, cemented to a plate (the paper's acrylic rods)."""

    kind: Literal["rods"] = "rods"
    diameters_mm: Annotated[tuple[Size, ...], Field(min_length=1, max_length=12)] = Field(
        default=(1.99, 4.81, 7.23), description="from -x to +x"
    )
    gap_mm: OptionalSize = Field(default=1.0, description="clearance between neighbours")
    length_mm: Size = 12.0
    edge_radius_mm: Size = Field(default=0.1, description="rounding of the end faces' edge")
    plate_mm: Size = Field(default=2.0, description="thickness of the plate")
    margin_mm: OptionalSize = Field(default=1.0, description="plate beyond the outermost rods")
    bead_mm: Size = Field(default=0.5, description="width of the cement bead under each rod")

    @model_validator(mode="after")
    def _fits(self) -> "Rods":
        thinnest = min(self.diameters_mm)
        half = "half the thinnest rod's diameter"
        require_at_most("bead_mm", self.bead_mm, thinnest / 2, half)
        require_at_most(
            "edge_radius_mm", self.edge_radius_mm, thinnest / 4, f"a quarter of {thinnest:g}"
        )
        require_at_most("edge_radius_mm", self.edge_radius_mm, self.length_mm / 4, "of length_mm")
        return self

    @property
    def middles_mm(self) -> tuple[float, ...]:
        """Place of each rod's axis along x; the row is centred.

        Neighbours of unlike diameter stand on the same plate, so their clearance is measured
        between their outlines seen from above.
        """
        return _middles_mm(self.diameters_mm, self.gap_mm)


class Bar(Specimen):
    """A rectangular bar lying along y, cut from sheet, its edges rounded: one known width."""

    kind: Literal["bar"] = "bar"
    width_mm: Size = 4.81
    height_mm: Size = Field(default=1.5, description="assumed: thickness of the sheet it is cut of")
    length_mm: Size = 15.0
    edge_radius_mm: OptionalSize = Field(default=0.1, description="assumed: rounding of all edges")

    @model_validator(mode="after")
    def _fits(self) -> "Bar":
        _require_edge(self.edge_radius_mm, (self.width_mm, self.height_mm, self.length_mm))
        return self


class Bars(Specimen):
    """Rectangular bars of one height side by side along y, on a plate: several known widths."""

    kind: Literal["bars"] = "bars"
    widths_mm: Annotated[tuple[Size, ...], Field(min_length=1, max_length=12)] = Field(
        default=(1.99, 4.81, 7.23), description="from -x to +x"
    )
    gap_mm: OptionalSize = Field(default=1.0, description="clearance between neighbours")
    height_mm: Size = Field(default=1.5, description="assumed: above the plate")
    length_mm: Size = 15.0
    edge_radius_mm: OptionalSize = Field(default=0.1, description="assumed: rounding of all edges")
    plate_mm: Size = Field(default=2.0, description="thickness of the plate")
    margin_mm: OptionalSize = Field(default=1.0, description="plate beyond the row")

    @model_validator(mode="after")
    def _fits(self) -> "Bars":
        _require_edge(self.edge_radius_mm, (*self.widths_mm, self.height_mm, self.length_mm))
        require_at_most("edge_radius_mm", self.edge_radius_mm, self.plate_mm / 4, "of plate_mm")
        return self

    @property
    def middles_mm(self) -> tuple[float, ...]:
        """Place of each bar's middle along x; the row is centred."""
        return _middles_mm(self.widths_mm, self.gap_mm)


def row_width_mm(widths_mm: tuple[float, ...], gap_mm: float) -> float:
    """Return the width of a row of parts with a clearance between neighbours."""
    return sum(widths_mm) + gap_mm * (len(widths_mm) - 1)


def _middles_mm(widths_mm: tuple[float, ...], gap_mm: float) -> tuple[float, ...]:
    """Return the places of the parts of a centred row."""
    places = [widths_mm[0] / 2]
    for left, right in pairwise(widths_mm):
        places.append(places[-1] + left / 2 + gap_mm + right / 2)
    half_width = (places[-1] + widths_mm[-1] / 2) / 2
    return tuple(place - half_width for place in places)


def _require_edge(edge_radius_mm: float, sides_mm: tuple[float, ...]) -> None:
    thinnest = min(sides_mm)
    require_at_most("edge_radius_mm", edge_radius_mm, thinnest / 4, f"a quarter of {thinnest:g}")


class Step(Specimen):
    """Two flat levels; the one at +x is the higher."""

    kind: Literal["step"] = "step"
    height_mm: Size = 0.5
    edge_radius_mm: OptionalSize = Field(default=0.1, description="rounding of the upper edge")
    length_x_mm: Size = 12.0
    length_y_mm: Size = 12.0

    @model_validator(mode="after")
    def _fits(self) -> "Step":
        limit = min(self.height_mm, self.length_x_mm / 4)
        why = "height_mm, and a quarter of length_x_mm"
        require_at_most("edge_radius_mm", self.edge_radius_mm, limit, why)
        return self


class VGroove(Specimen):
    """A plate with one V groove along y."""

    kind: Literal["v_groove"] = "v_groove"
    depth_mm: Size = 0.5
    angle_deg: Annotated[float, Field(ge=20, le=170)] = Field(
        default=90.0, description="between the two flanks"
    )
    length_x_mm: Size = 12.0
    length_y_mm: Size = 12.0

    @model_validator(mode="after")
    def _fits(self) -> "VGroove":
        limit = 0.8 * self.length_x_mm
        why = "0.8 length_x_mm; opening = 2 depth_mm tan(angle_deg / 2)"
        require_at_most("opening", self.opening_mm, limit, why)
        return self

    @property
    def opening_mm(self) -> float:
        """Width of the groove at the plate's face."""
        return 2 * self.depth_mm * tan(radians(self.angle_deg / 2))
