"""Nominal features of specimens: dimensions as on a drawing, to which fits are compared.

Lengths are in mm. In the frame of the specimen, x is across a feature and y along it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal


@dataclass(frozen=True)
class NominalFeature:
    """Base class of the features of a specimen that have known dimensions."""

    is_counted: ClassVar[bool] = False
    """Whether the names of measurands of the feature have numbers: radius_1, radius_2."""

    @property
    def lengths_mm(self) -> Mapping[str, float]:
        """Nominal lengths, mm, that are measured by default, by the name of the quantity."""
        return {}


@dataclass(frozen=True)
class NominalBall(NominalFeature):
    """Ball of known radius; the n-th element of `Shape.spheres` is the n-th ball's position."""

    is_counted: ClassVar[bool] = True
    radius_mm: float

    @property
    def lengths_mm(self) -> Mapping[str, float]:
        """Nominal radius, mm, as quantity "radius"."""
        return {"radius": self.radius_mm}


@dataclass(frozen=True)
class NominalRod(NominalFeature):
    """Cylinder along the x or y axis of the specimen.

    Attributes
    ----------
    middle_mm : position of the cylinder's axis across its length
    edge_radius_mm : rounding of the edges of the end faces
    """

    is_counted: ClassVar[bool] = True
    radius_mm: float
    length_mm: float
    edge_radius_mm: float
    middle_mm: float = 0.0
    along: Literal["x", "y"] = "y"

    @property
    def lengths_mm(self) -> Mapping[str, float]:
        """Nominal radius, mm, as quantity "radius"."""
        return {"radius": self.radius_mm}

    @property
    def width_mm(self) -> float:
        """Width of the cylinder in top view, mm."""
        return 2 * self.radius_mm


@dataclass(frozen=True)
class NominalBar(NominalFeature):
    """Bar along y with a flat top and upright walls.

    Attributes
    ----------
    middle_mm : position of the middle of the bar along x
    edge_radius_mm : rounding of the upper edges
    gap_mm : clearance to the neighbouring bars; inf without neighbours
    """

    is_counted: ClassVar[bool] = True
    width_mm: float
    length_mm: float
    edge_radius_mm: float
    middle_mm: float = 0.0
    gap_mm: float = float("inf")

    @property
    def lengths_mm(self) -> Mapping[str, float]:
        """Nominal width, mm, as quantity "width"."""
        return {"width": self.width_mm}


@dataclass(frozen=True)
class NominalStep(NominalFeature):
    """Step between two flat levels."""

    height_mm: float

    @property
    def lengths_mm(self) -> Mapping[str, float]:
        """Nominal height, mm, as quantity "step_height"."""
        return {"step_height": self.height_mm}


@dataclass(frozen=True)
class NominalGroove(NominalFeature):
    """V groove along y in a plate; the root of the groove is at x = 0."""

    depth_mm: float
    opening_mm: float
    length_x_mm: float
    length_y_mm: float

    @property
    def lengths_mm(self) -> Mapping[str, float]:
        """Nominal depth, mm, as quantity "depth", and nominal opening, mm, as quantity "width"."""
        return {"depth": self.depth_mm, "width": self.opening_mm}


@dataclass(frozen=True)
class NominalGrating(NominalFeature):
    """Plate with sinusoidal grooves along y."""

    pitch_mm: float
    depth_mm: float
    length_x_mm: float
    length_y_mm: float

    @property
    def lengths_mm(self) -> Mapping[str, float]:
        """Nominal depth of the grooves from crest to root, mm, as quantity "depth"."""
        return {"depth": self.depth_mm}


@dataclass(frozen=True)
class NominalHexNut(NominalFeature):
    """Hexagonal nut with a flat ring round its hole; two of its flats are normal to y.

    Attributes
    ----------
    ring_radius_mm : radius of the middle of the ring between hole and chamfer
    chamfer_fall_mm : height of the ring above the chamfered corners
    """

    across_flats_mm: float
    ring_radius_mm: float
    chamfer_fall_mm: float
