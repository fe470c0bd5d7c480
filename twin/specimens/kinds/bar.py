"""Specimen kind `bar`: one bar of known width."""

from typing import ClassVar, Literal

from pydantic import Field, model_validator

from twin.config.bounds import OptionalSize, Size
from twin.config.nominal import NominalBar
from twin.config.specimen_base import SPECIMENS, Specimen
from twin.specimens.meshes import MeshShape, block
from twin.specimens.rows import require_edge


@SPECIMENS.register
class Bar(Specimen):
    """A rectangular bar along y, cut from sheet, with rounded edges: one known width."""

    kind: Literal["bar"] = "bar"
    width_mm: Size = 4.81
    height_mm: Size = Field(default=1.5, description="assumed: thickness of the sheet")
    length_mm: Size = 15.0
    edge_radius_mm: OptionalSize = Field(default=0.1, description="assumed: rounding of all edges")

    slab_fit_paths: ClassVar[tuple[str, ...]] = ("width_mm", "x_mm", "y_mm", "yaw_deg")

    @model_validator(mode="after")
    def _fits(self) -> "Bar":
        require_edge(self.edge_radius_mm, (self.width_mm, self.height_mm, self.length_mm))
        return self

    def shape(self) -> MeshShape:
        """Return the bar along y, with its upper face at z = 0."""
        x, y, z = self.width_mm / 2, self.length_mm / 2, self.height_mm
        return block((-x, -y, -z), (x, y, 0.0), self.edge_radius_mm)

    def nominal_features(self) -> tuple[NominalBar, ...]:
        """Return the nominal bar, the only feature of known size."""
        return (NominalBar(self.width_mm, self.length_mm, self.edge_radius_mm),)
