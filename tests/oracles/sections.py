"""Sections of rigid specimens as signed distances in a half plane (x or r >= 0, z).

z counts from the specimen's highest point, material is below. A section is a tuple of parts:
their contact potentials add, so that no distance has a kink where two parts meet.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray


@dataclass(frozen=True)
class Nearest:
    """Position of points (point,) relative to a part."""

    #: positive outside
    distance_mm: FloatArray
    #: (point,) components of the unit normal towards the point
    normal_x: FloatArray
    normal_z: FloatArray
    #: (point,) curvature of the offset surface through the point
    curvature_per_mm: FloatArray


Part = Callable[[FloatArray, FloatArray], Nearest]
Section = tuple[Part, ...]

# No rim is as wide, no press as deep.
_FAR_MM = 1e3


def rod_section(radius_mm: float, plate_mm: float | None = None) -> Section:
    """Return a circle (a rod, or a ball about the axis), on a plate `plate_mm` below its top."""

    def circle(x_mm: FloatArray, z_mm: FloatArray) -> Nearest:
        distance = np.hypot(x_mm, z_mm + radius_mm)
        return Nearest(
            distance - radius_mm, x_mm / distance, (z_mm + radius_mm) / distance, 1 / distance
        )

    return (circle, *_plate(plate_mm, 15.0))


def bar_section(
    width_mm: float, edge_mm: float, height_mm: float | None = None, plate_mm: float = 15.0
) -> Section:
    """Return a bar (about the axis: a disc) with rounded edges, on a plate if it has a height.

    The plate has the width `plate_mm`.
    """
    return (_rounded(width_mm, edge_mm, 0.0), *_plate(height_mm, plate_mm))


def flat_section() -> Section:
    """Return a plane."""
    return (_rounded(2 * _FAR_MM, 0.1, 0.0),)


def _plate(below_mm: float | None, width_mm: float, edge_mm: float = 0.2) -> Section:
    """Return the plate under the object: narrower than the rim, which it may pass."""
    return () if below_mm is None else (_rounded(width_mm, edge_mm, below_mm),)


def _rounded(width_mm: float, edge_mm: float, below_mm: float) -> Part:
    def rectangle(x_mm: FloatArray, z_mm: FloatArray) -> Nearest:
        # From the centre of the rounded edge.
        x, z = x_mm - (width_mm / 2 - edge_mm), z_mm + below_mm + edge_mm
        corner = (x > 0) & (z > 0)
        at_side = ~corner & (x > z)
        away = np.where(corner, np.hypot(x, z), np.maximum(x, z))
        safe = np.where(corner, away, 1.0)
        return Nearest(
            away - edge_mm,
            np.where(corner, x / safe, at_side),
            np.where(corner, z / safe, ~at_side),
            np.where(corner, 1 / safe, 0.0),
        )

    return rectangle
