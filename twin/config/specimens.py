"""Specimens as data: what is pressed, in its pose on the stage.

Lengths in mm, relative to the slab's centre; the specimen presses from below.
"""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from twin.config.artefacts import Bar, Bars, Rods, Step, VGroove
from twin.config.base import Length, NonNegative, Positive
from twin.config.objects import Bear, Brick, Fingerprint, Nut, TBolt
from twin.config.specimen_base import Specimen

__all__ = [
    "AnySpecimen",
    "Ball",
    "Bar",
    "Bars",
    "Bear",
    "Brick",
    "Fingerprint",
    "Flat",
    "Grating",
    "Group",
    "MeshFile",
    "Nut",
    "Part",
    "Rod",
    "Rods",
    "Specimen",
    "Step",
    "TBolt",
    "TwoBalls",
    "VGroove",
]


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
    edge_radius_mm: NonNegative = Field(default=0.2, description="rounding of the end faces' edge")

    @model_validator(mode="after")
    def _edge_fits(self) -> "Rod":
        _check_edge(self.edge_radius_mm, min(self.diameter_mm, self.length_mm))
        return self


class Flat(Specimen):
    """A flat round punch, its face towards the elastomer."""

    kind: Literal["flat"] = "flat"
    diameter_mm: Length = 6.0
    height_mm: Length = 5.0
    edge_radius_mm: NonNegative = Field(default=0.2, description="rounding of the face's edge")

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
    scale: Positive = Field(default=1.0, description="mm per unit of the file")
    up: Literal["+x", "-x", "+y", "-y", "+z", "-z"] = Field(
        default="+z", description="axis of the file that faces the elastomer"
    )


_Single = (
    Ball | TwoBalls | Rod | Flat | Grating | MeshFile
    | Rods | Bar | Bars | Step | VGroove | Nut | TBolt | Brick | Bear | Fingerprint
)  # fmt: skip
Part = Annotated[_Single, Field(discriminator="kind")]


class Group(Specimen):
    """Several specimens on one stage, pressed together."""

    kind: Literal["group"] = "group"
    parts: dict[str, Part] = Field(
        min_length=1, description="one table per part, [specimen.parts.NAME], each with its kind"
    )


AnySpecimen = Annotated[_Single | Group, Field(discriminator="kind")]


def _check_edge(edge_radius_mm: float, smallest_mm: float) -> None:
    if edge_radius_mm > smallest_mm / 2:
        raise ValueError(
            f"edge_radius_mm: found {edge_radius_mm:g}, allowed 0 to {smallest_mm / 2:g}, "
            "half the smaller of diameter and length"
        )
