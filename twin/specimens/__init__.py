"""Rigid specimens: triangle mesh and the height field that faces the elastomer."""

from twin.specimens import spheres as spheres  # fills the catalogue
from twin.specimens.catalogue import (
    Shape,
    Sphere,
    apexes_mm,
    height_above_lowest,
    kinds,
    shape_of,
    specimen_mesh,
)

__all__ = [
    "Shape",
    "Sphere",
    "apexes_mm",
    "height_above_lowest",
    "kinds",
    "shape_of",
    "specimen_mesh",
]
