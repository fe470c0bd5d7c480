"""Specimen kind `step`: two flat levels."""

from typing import ClassVar, Literal

from pydantic import Field, model_validator

from twin.config.bounds import OptionalSize, Size
from twin.config.nominal import NominalStep
from twin.config.specimen_base import SPECIMENS, Specimen, require_at_most
from twin.specimens.meshes import MeshShape, uniform_along_y
from twin.specimens.solids import arc

_BASE_MM = 2.0


@SPECIMENS.register
class Step(Specimen):
    """Two flat levels; the level at +x is the higher."""

    kind: Literal["step"] = "step"
    height_mm: Size = 0.5
    edge_radius_mm: OptionalSize = Field(default=0.1, description="rounding of the upper edge")
    length_x_mm: Size = 12.0
    length_y_mm: Size = 12.0

    slab_fit_paths: ClassVar[tuple[str, ...]] = ("height_mm", "x_mm")

    @model_validator(mode="after")
    def _fits(self) -> "Step":
        limit = min(self.height_mm, self.length_x_mm / 4)
        why = "height_mm, and 0.25 length_x_mm"
        require_at_most("edge_radius_mm", self.edge_radius_mm, limit, why)
        return self

    def shape(self) -> MeshShape:
        """Return the body: the lower level is z = 0, and the step up towards +x is at x = 0."""
        x, height, edge = self.length_x_mm / 2, self.height_mm, self.edge_radius_mm
        # Counter-clockwise: the arc runs from the upper level down.
        rounding = arc((edge, height - edge), edge, 90, 180)
        foot = [] if edge == height else [(0.0, 0.0)]
        outline = [(x, -_BASE_MM), (x, height), *rounding, *foot, (-x, 0.0), (-x, -_BASE_MM)]
        return uniform_along_y(outline, self.length_y_mm)

    def nominal_features(self) -> tuple[NominalStep, ...]:
        """Return the nominal step, the only feature of known size."""
        return (NominalStep(self.height_mm),)
