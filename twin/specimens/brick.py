"""The toy brick: hollow below, tubes between its walls, rounded studs on top."""

from functools import lru_cache
from itertools import product

import numpy as np
import trimesh

from twin.config.objects import Brick
from twin.specimens.catalogue import register
from twin.specimens.meshes import MeshShape
from twin.specimens.pose import raised, unposed
from twin.specimens.solids import arc, box, moved, turned, union, without

# Parts reach this far into each other: faces that only touch do not join.
_INTO_MM = 0.2
# Facets of the studs' small rounding; a chord stays within 0.2 um of a 0.1 mm radius.
_EDGE_STEP_DEG = 6.0


@register("brick")
def build_brick(specimen: Brick) -> MeshShape:
    """Stand the brick on its walls, its middle in the origin."""
    body = _brick(unposed(specimen))
    middle_mm = (specimen.height_mm + specimen.stud_height_mm) / 2
    return MeshShape(body).placed(raised(-middle_mm))


@lru_cache(maxsize=8)
def _brick(brick: Brick) -> trimesh.Trimesh:
    """Join the shell (base at z = 0), its studs and its tubes."""
    studs = [moved(_stud(brick), x, y) for x, y in _places(brick, brick.studs_x, brick.studs_y)]
    tubes = [
        moved(_tube(brick), x, y) for x, y in _places(brick, brick.studs_x - 1, brick.studs_y - 1)
    ]
    return union([_shell(brick), *studs, *tubes])


def _places(brick: Brick, count_x: int, count_y: int) -> list[tuple[float, float]]:
    """Return the middles of a centred grid of studs or tubes."""
    x = (np.arange(count_x) - (count_x - 1) / 2) * brick.pitch_mm
    y = (np.arange(count_y) - (count_y - 1) / 2) * brick.pitch_mm
    return [(float(a), float(b)) for a, b in product(x, y)]


def _shell(brick: Brick) -> trimesh.Trimesh:
    half_x = (brick.studs_x * brick.pitch_mm - brick.play_mm) / 2
    half_y = (brick.studs_y * brick.pitch_mm - brick.play_mm) / 2
    inner_x, inner_y = half_x - brick.wall_mm, half_y - brick.wall_mm
    block = box((-half_x, -half_y, 0.0), (half_x, half_y, brick.height_mm))
    roof_mm = brick.height_mm - brick.roof_mm
    return without(block, box((-inner_x, -inner_y, -1.0), (inner_x, inner_y, roof_mm)))


def _stud(brick: Brick) -> trimesh.Trimesh:
    radius, edge = brick.stud_diameter_mm / 2, brick.edge_radius_mm
    base, top = brick.height_mm - brick.roof_mm / 2, brick.height_mm + brick.stud_height_mm
    rounding = arc((radius - edge, top - edge), edge, 0, 90, _EDGE_STEP_DEG)
    return turned([(0.0, base), (radius, base), *rounding, (0.0, top)])


def _tube(brick: Brick) -> trimesh.Trimesh:
    outer, inner = brick.tube_diameter_mm / 2, brick.stud_diameter_mm / 2
    roof_mm = brick.height_mm - brick.roof_mm
    into = min(_INTO_MM, brick.roof_mm / 2)
    wall = turned([(0.0, 0.0), (outer, 0.0), (outer, roof_mm + into), (0.0, roof_mm + into)])
    bore = turned([(0.0, -1.0), (inner, -1.0), (inner, roof_mm), (0.0, roof_mm)])
    return without(wall, bore)
