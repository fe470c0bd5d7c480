"""Specimen kind `flat`: a flat round punch."""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from twin.config.bounds import Length, Rounding
from twin.config.specimen_base import SPECIMENS, Specimen
from twin.specimens.closed_form import Cylinder, require_cylinder_edge


@SPECIMENS.register
class Flat(Specimen):
    """A flat round punch, its face towards the elastomer."""

    kind: Literal["flat"] = "flat"
    diameter_mm: Length = 6.0
    height_mm: Length = 5.0
    edge_radius_mm: Rounding = Field(default=0.2, description="rounding of the face's edge")

    slab_fit_paths: ClassVar[tuple[str, ...]] = ("diameter_mm", "x_mm", "y_mm")

    @model_validator(mode="after")
    def _edge_fits(self) -> "Flat":
        require_cylinder_edge(self.edge_radius_mm, min(self.diameter_mm, self.height_mm))
        return self

    def shape(self) -> Cylinder:
        """Return the punch as a cylinder along z, centred on the origin."""
        sizes = self.diameter_mm / 2, self.height_mm / 2, self.edge_radius_mm
        return Cylinder(np.zeros(3), np.array([0.0, 0.0, 1.0]), *sizes)
