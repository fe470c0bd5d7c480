"""Specimen kind `v_groove`: a plate with a V groove."""

from math import radians, tan
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from twin.config.bounds import Size
from twin.config.nominal import NominalGroove
from twin.config.specimen_base import SPECIMENS, Specimen, require_at_most
from twin.specimens.meshes import MeshShape, uniform_along_y

_BASE_MM = 2.0


@SPECIMENS.register
class VGroove(Specimen):
    """A plate with one V groove along y."""

    kind: Literal["v_groove"] = "v_groove"
    depth_mm: Size = 0.5
    angle_deg: Annotated[float, Field(ge=20, le=170)] = Field(
        default=90.0, description="between the two flanks"
    )
    length_x_mm: Size = 12.0
    length_y_mm: Size = 12.0

    slab_fit_paths: ClassVar[tuple[str, ...]] = ("depth_mm", "x_mm")

    @model_validator(mode="after")
    def _fits(self) -> "VGroove":
        limit = 0.8 * self.length_x_mm
        why = "0.8 length_x_mm; opening = 2 depth_mm tan(angle_deg / 2)"
        require_at_most("opening", self.opening_mm, limit, why)
        return self

    @property
    def opening_mm(self) -> float:
        """Width of the groove at the plate's face."""
        return 2 * self.depth_mm * tan(radians(self.angle_deg / 2))

    def shape(self) -> MeshShape:
        """Return the plate with its face at z = 0 and the root of the groove at x = 0."""
        x, half, root = self.length_x_mm / 2, self.opening_mm / 2, -self.depth_mm
        base = root - _BASE_MM
        face = [(x, base), (x, 0.0), (half, 0.0), (0.0, root), (-half, 0.0), (-x, 0.0), (-x, base)]
        return uniform_along_y(face, self.length_y_mm)

    def nominal_features(self) -> tuple[NominalGroove, ...]:
        """Return the nominal groove, the only feature of known size."""
        sides = self.length_x_mm, self.length_y_mm
        return (NominalGroove(self.depth_mm, self.opening_mm, *sides),)
