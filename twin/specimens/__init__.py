"""Rigid specimens: triangle meshes, and heights of the side that faces the elastomer."""

from twin.specimens.catalogue import Body, bodies, height_above_lowest, shape_of

__all__ = ["Body", "bodies", "height_above_lowest", "shape_of"]
