"""Rigid specimens: triangle mesh and the height field that faces the elastomer."""

# These fill the catalogue.
from twin.specimens import artefacts as artefacts
from twin.specimens import cylinders as cylinders
from twin.specimens import fasteners as fasteners
from twin.specimens import fingerprint as fingerprint
from twin.specimens import group as group
from twin.specimens import meshes as meshes
from twin.specimens import toys as toys
from twin.specimens.catalogue import (
    Shape,
    Sphere,
    apexes_mm,
    height_above_lowest,
    kinds,
    shape_of,
    specimen_mesh,
)
from twin.specimens.group import Body, bodies
from twin.specimens.spheres import SphereCluster

__all__ = [
    "Body",
    "Shape",
    "Sphere",
    "SphereCluster",
    "apexes_mm",
    "bodies",
    "height_above_lowest",
    "kinds",
    "shape_of",
    "specimen_mesh",
]
