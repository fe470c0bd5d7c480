"""Specimens as data: what is pressed, in its pose on the stage.

Lengths in mm, relative to the slab's centre; the specimen presses from below.
Artefacts with a known profile (rods and bars on a plate, a step, a V groove) show it along the
specimen's x axis and are uniform along y, as the grating does.
"""

from itertools import pairwise
from math import radians, tan
from typing import Annotated, Literal

from pydantic import Field, model_validator

from twin.config.bounds import FileUnit, Length, OptionalSize, Rounding, Size
from twin.config.objects import Bear, Brick, Fingerprint, Nut, TBolt
from twin.config.specimen_base import Specimen, require_at_most


class Ball(Specimen):
    """One ball."""

    kind: Literal["ball"] = "ball"
    diameter_mm: Length = 8.0


class TwoBalls(Specimen):
    """Two joined balls side by side along the specimen's x axis (the paper's artefact)."""

    kind: Literal["two_balls"] = "two_balls"
    diameter_mm: Length = 8.0
    separation_mm: Length = Field(default=8.0, description="distance between the two centres")


class Rod(Specimen):
    """A cylinder lying along the specimen's x axis, its ends flat: a line contact."""

    kind: Literal["rod"] = "rod"
    diameter_mm: Length = 4.8
    length_mm: Length = 12.0
    edge_radius_mm: Rounding = Field(default=0.2, description="rounding of the end faces' edge")

    @model_validator(mode="after")
    def _edge_fits(self) -> "Rod":
        _check_edge(self.edge_radius_mm, min(self.diameter_mm, self.length_mm))
        return self


class Flat(Specimen):
    """A flat round punch, its face towards the elastomer."""

    kind: Literal["flat"] = "flat"
    diameter_mm: Length = 6.0
    height_mm: Length = 5.0
    edge_radius_mm: Rounding = Field(default=0.2, description="rounding of the face's edge")

    @model_validator(mode="after")
    def _edge_fits(self) -> "Flat":
        _check_edge(self.edge_radius_mm, min(self.diameter_mm, self.height_mm))
        return self


class Grating(Specimen):
    """A plate with sinusoidal grooves along its y axis: what relief the coat still shows."""

    kind: Literal["grating"] = "grating"
    pitch_mm: Length = 4.0
    groove_mm: Length = Field(default=0.2, description="depth of the grooves, crest to root")
    length_x_mm: Length = 12.0
    length_y_mm: Length = 12.0


class MeshFile(Specimen):
    """A closed triangle mesh from a file: STL, PLY or OBJ."""

    kind: Literal["mesh"] = "mesh"
    file: str = Field(description="path, or the name of a shipped mesh such as scenes/meshes/x.stl")
    scale: FileUnit = Field(
        default=1.0, description="mm per unit of the file: 1000 for metres, 25.4 for inches"
    )
    up: Literal["+x", "-x", "+y", "-y", "+z", "-z"] = Field(
        default="+z", description="axis of the file that faces the elastomer"
    )


def _check_edge(edge_radius_mm: float, smallest_mm: float) -> None:
    if edge_radius_mm > smallest_mm / 2:
        raise ValueError(
            f"edge_radius_mm: found {edge_radius_mm:g}, allowed 0 to {smallest_mm / 2:g}, "
            "half the smaller of diameter and length"
        )


class Rods(Specimen):
    """Rods lying side by side along y, cemented to a plate (the paper's acrylic rods)."""

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
    edge_radius_mm: OptionalSize = Field(
        default=0.1, description="assumed: rounding of all edges, the plate's as well"
    )
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


_Single = (
    Ball | TwoBalls | Rod | Flat | Grating | MeshFile
    | Rods | Bar | Bars | Step | VGroove | Nut | TBolt | Brick | Bear | Fingerprint
)  # fmt: skip
Part = Annotated[_Single, Field(discriminator="kind")]


class Group(Specimen):
    """Several specimens on one stage, pressed together."""

    kind: Literal["group"] = "group"
    parts: dict[str, Part] = Field(
        min_length=1,
        max_length=100,
        description="one table per part, [specimen.parts.NAME], each with its kind",
    )


AnySpecimen = Annotated[_Single | Group, Field(discriminator="kind")]
