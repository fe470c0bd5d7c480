"""Rigid specimens: triangle mesh and the height field that faces the elastomer."""

# These fill the catalogue.
from twin.specimens import cylinders as cylinders
from twin.specimens import group as group
from twin.specimens import meshes as meshes
from twin.specimens.catalogue import (
    Shape,
    Sphere,
    apexes_mm,
    height_above_lowest,
    kinds,
    shape_of,
    specimen_mesh,
)
from twin.specimens.spheres import SphereCluster

__all__ = [
    "Shape",
    "Sphere",
    "SphereCluster",
    "apexes_mm",
    "height_above_lowest",
    "kinds",
    "shape_of",
    "specimen_mesh",
]
