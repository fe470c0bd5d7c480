"""Rigid specimens: triangle mesh and the height field that faces the elastomer."""

# These fill the catalogue.
from twin.specimens import artefacts as artefacts
from twin.specimens import fasteners as fasteners
from twin.specimens import meshes as meshes
from twin.specimens import objects as objects
from twin.specimens.catalogue import (
    Body,
    Shape,
    Sphere,
    bodies,
    height_above_lowest,
    kinds,
    shape_of,
)
from twin.specimens.closed_form import SphereCluster

__all__ = [
    "Body",
    "Shape",
    "Sphere",
    "SphereCluster",
    "bodies",
    "height_above_lowest",
    "kinds",
    "shape_of",
]
