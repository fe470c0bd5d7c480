"""Specimen kind `brick`: a hollow toy brick with tubes inside and rounded studs on top."""

from functools import lru_cache
from itertools import product
from math import sqrt
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from twin.config.bounds import OptionalSize, Size
from twin.config.specimen_base import SPECIMENS, Specimen, require_at_most
from twin.specimens.catalogue import raised, unposed
from twin.specimens.meshes import MeshShape
from twin.specimens.solids import arc, box, moved, turned, union, without

if TYPE_CHECKING:
    import trimesh

# Overlap of the parts, because a union does not join faces that only touch.
_INTO_MM = 0.2
# Angle of a facet of the studs' rounding; chord errors are at most 0.2 um at a radius of 0.1 mm.
_EDGE_STEP_DEG = 6.0


@SPECIMENS.register
class Brick(Specimen):
    """A toy brick, studs up, hollow below, with tubes that clamp the studs of the brick below."""

    kind: Literal["brick"] = "brick"
    studs_x: Annotated[int, Field(ge=1, le=8)] = 2
    studs_y: Annotated[int, Field(ge=1, le=8)] = 2
    pitch_mm: Size = Field(default=8.0, description="literature: distance between studs")
    height_mm: Size = Field(default=9.6, description="literature: 9.6, a plate 3.2; without studs")
    play_mm: OptionalSize = Field(default=0.2, description="literature: gap between bricks")
    stud_diameter_mm: Size = Field(default=4.8, description="literature: 4.8 to 4.9")
    stud_height_mm: Size = Field(default=1.7, description="literature: 1.7 to 1.8")
    edge_radius_mm: OptionalSize = Field(default=0.1, description="assumed: studs' upper edge")
    wall_mm: Size = Field(default=1.5, description="literature: 1.2 to 1.6")
    roof_mm: Size = Field(default=1.0, description="literature: thickness under the studs")

    @model_validator(mode="after")
    def _fits(self) -> "Brick":
        stud = self.stud_diameter_mm
        require_at_most("stud_diameter_mm", stud, 0.7 * self.pitch_mm, "0.7 pitch_mm")
        require_at_most("play_mm", self.play_mm, 0.1 * self.pitch_mm, "0.1 pitch_mm")
        edge_limit = min(stud / 4, self.stud_height_mm)
        why = "stud_height_mm, and 0.25 stud_diameter_mm"
        require_at_most("edge_radius_mm", self.edge_radius_mm, edge_limit, why)
        require_at_most("roof_mm", self.roof_mm, 0.9 * self.height_mm, "0.9 height_mm")
        room = self.pitch_mm - self.play_mm / 2 - self.tube_diameter_mm / 2
        require_at_most("wall_mm", self.wall_mm, 0.95 * room, "the space between wall and tubes")
        return self

    @property
    def tube_diameter_mm(self) -> float:
        """Outer diameter of the tubes, with which each touches the four studs round it."""
        return sqrt(2) * self.pitch_mm - self.stud_diameter_mm

    def shape(self) -> MeshShape:
        """Return the brick with its studs up and its middle at the origin."""
        body = _brick(unposed(self))
        middle_mm = (self.height_mm + self.stud_height_mm) / 2
        return MeshShape(body).placed(raised(-middle_mm))


@lru_cache(maxsize=8)
def _brick(brick: Brick) -> "trimesh.Trimesh":
    """Return the union of shell (base at z = 0), studs and tubes."""
    studs = [moved(_stud(brick), x, y) for x, y in _places(brick, brick.studs_x, brick.studs_y)]
    tubes = [
        moved(_tube(brick), x, y) for x, y in _places(brick, brick.studs_x - 1, brick.studs_y - 1)
    ]
    return union([_shell(brick), *studs, *tubes])


def _places(brick: Brick, count_x: int, count_y: int) -> list[tuple[float, float]]:
    """Return the middles (x, y), mm, of a centred grid of studs or tubes."""
    x = (np.arange(count_x) - (count_x - 1) / 2) * brick.pitch_mm
    y = (np.arange(count_y) - (count_y - 1) / 2) * brick.pitch_mm
    return [(float(a), float(b)) for a, b in product(x, y)]


def _shell(brick: Brick) -> "trimesh.Trimesh":
    half_x = (brick.studs_x * brick.pitch_mm - brick.play_mm) / 2
    half_y = (brick.studs_y * brick.pitch_mm - brick.play_mm) / 2
    inner_x, inner_y = half_x - brick.wall_mm, half_y - brick.wall_mm
    block = box((-half_x, -half_y, 0.0), (half_x, half_y, brick.height_mm))
    roof_mm = brick.height_mm - brick.roof_mm
    return without(block, box((-inner_x, -inner_y, -1.0), (inner_x, inner_y, roof_mm)))


def _stud(brick: Brick) -> "trimesh.Trimesh":
    radius, edge = brick.stud_diameter_mm / 2, brick.edge_radius_mm
    base, top = brick.height_mm - brick.roof_mm / 2, brick.height_mm + brick.stud_height_mm
    rounding = arc((radius - edge, top - edge), edge, 0, 90, _EDGE_STEP_DEG)
    return turned([(0.0, base), (radius, base), *rounding, (0.0, top)])


def _tube(brick: Brick) -> "trimesh.Trimesh":
    outer, inner = brick.tube_diameter_mm / 2, brick.stud_diameter_mm / 2
    roof_mm = brick.height_mm - brick.roof_mm
    into = min(_INTO_MM, brick.roof_mm / 2)
    wall = turned([(0.0, 0.0), (outer, 0.0), (outer, roof_mm + into), (0.0, roof_mm + into)])
    bore = turned([(0.0, -1.0), (inner, -1.0), (inner, roof_mm), (0.0, roof_mm)])
    return without(wall, bore)
