"""Specimen kind `rod`: a horizontal cylinder."""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from twin.config.bounds import Length, Rounding
from twin.config.nominal import NominalRod
from twin.config.specimen_base import SPECIMENS, Specimen
from twin.specimens.closed_form import Cylinder, require_cylinder_edge


@SPECIMENS.register
class Rod(Specimen):
    """A cylinder along the specimen's x axis with flat ends: a line contact."""

    kind: Literal["rod"] = "rod"
    diameter_mm: Length = 4.8
    length_mm: Length = 12.0
    edge_radius_mm: Rounding = Field(default=0.2, description="rounding of the end faces' edge")

    slab_fit_paths: ClassVar[tuple[str, ...]] = ("diameter_mm", "x_mm", "y_mm", "yaw_deg")

    @model_validator(mode="after")
    def _edge_fits(self) -> "Rod":
        require_cylinder_edge(self.edge_radius_mm, min(self.diameter_mm, self.length_mm))
        return self

    def shape(self) -> Cylinder:
        """Return the rod as a cylinder along x, centred on the origin."""
        sizes = self.diameter_mm / 2, self.length_mm / 2, self.edge_radius_mm
        return Cylinder(np.zeros(3), np.array([1.0, 0.0, 0.0]), *sizes)

    def nominal_features(self) -> tuple[NominalRod, ...]:
        """Return the nominal rod, the only feature of known size."""
        return (NominalRod(self.diameter_mm / 2, self.length_mm, self.edge_radius_mm, along="x"),)
