"""Nominal features of specimens: their dimensions on a drawing, and the targets of fits.

Frame of the specimen: x across a feature, y along it. mm.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal


@dataclass(frozen=True)
class NominalFeature:
    """A feature of known size."""

    is_counted: ClassVar[bool] = False
    """Whether its measurands are numbered: radius_1, radius_2."""

    @property
    def lengths_mm(self) -> Mapping[str, float]:
        """Lengths that are measured by default, by the name of their quantity."""
        return {}


@dataclass(frozen=True)
class NominalBall(NominalFeature):
    """A ball; its position is that of the shape's sphere of the same number."""

    is_counted: ClassVar[bool] = True
    radius_mm: float

    @property
    def lengths_mm(self) -> Mapping[str, float]:
        """Its radius."""
        return {"radius": self.radius_mm}


@dataclass(frozen=True)
class NominalRod(NominalFeature):
    """A cylinder along an axis of the specimen.

    Attributes
    ----------
    middle_mm : place of its axis across it
    edge_radius_mm : rounding of the end faces' edges
    """

    is_counted: ClassVar[bool] = True
    radius_mm: float
    length_mm: float
    edge_radius_mm: float
    middle_mm: float = 0.0
    along: Literal["x", "y"] = "y"

    @property
    def lengths_mm(self) -> Mapping[str, float]:
        """Its radius."""
        return {"radius": self.radius_mm}

    @property
    def width_mm(self) -> float:
        """Width in top view."""
        return 2 * self.radius_mm


@dataclass(frozen=True)
class NominalBar(NominalFeature):
    """A bar with a flat top and upright walls, along y.

    Attributes
    ----------
    middle_mm : place of its middle along x
    edge_radius_mm : rounding of its upper edges
    gap_mm : clearance to its neighbours, inf without neighbours
    """

    is_counted: ClassVar[bool] = True
    width_mm: float
    length_mm: float
    edge_radius_mm: float
    middle_mm: float = 0.0
    gap_mm: float = float("inf")

    @property
    def lengths_mm(self) -> Mapping[str, float]:
        """Its width."""
        return {"width": self.width_mm}


@dataclass(frozen=True)
class NominalStep(NominalFeature):
    """Two flat levels."""

    height_mm: float

    @property
    def lengths_mm(self) -> Mapping[str, float]:
        """Its height."""
        return {"step_height": self.height_mm}


@dataclass(frozen=True)
class NominalGroove(NominalFeature):
    """A V groove along y, its root in x = 0, in a plate."""

    depth_mm: float
    opening_mm: float
    length_x_mm: float
    length_y_mm: float

    @property
    def lengths_mm(self) -> Mapping[str, float]:
        """Its depth, and its opening as width."""
        return {"depth": self.depth_mm, "width": self.opening_mm}


@dataclass(frozen=True)
class NominalGrating(NominalFeature):
    """A plate with sinusoidal grooves along y."""

    pitch_mm: float
    depth_mm: float
    length_x_mm: float
    length_y_mm: float

    @property
    def lengths_mm(self) -> Mapping[str, float]:
        """Depth of its grooves."""
        return {"depth": self.depth_mm}


@dataclass(frozen=True)
class NominalHexNut(NominalFeature):
    """A hexagonal prism with a flat ring round its hole; two of its flats are normal to y.

    Attributes
    ----------
    ring_radius_mm : middle of the ring between hole and chamfer
    chamfer_fall_mm : height of the ring above the chamfered corners
    """

    across_flats_mm: float
    ring_radius_mm: float
    chamfer_fall_mm: float
