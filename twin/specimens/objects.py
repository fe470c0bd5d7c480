"""Everyday objects: a bear ornament, a toy brick, a fingertip.

The bear is the smooth union of ellipsoids, meshed on its level set.
Each ellipsoid has the signed distance estimate d = (|p / r| - 1) min(r), negative inside; their
smooth union with blending b is  -b log sum exp(-d / b). A coarse level-set mesh gives the topology;
its refined vertices are then moved onto the surface by Newton's steps along the gradient.

The brick is hollow below, with tubes between its walls and rounded studs on top.

A fingerprint has ridges that follow a loop or a whorl, with endings and forks. Its height is
depth / 2 times the real part of exp(2 pi i s / pitch) times one vortex
(u +- i v) / sqrt(u^2 + v^2 + r^2) per minutia, (u, v) the place relative to it: a ridge more on
one side of it than on the other (Larkin and Fletcher 2007, fingerprints as holograms). s is the
distance to the core, a line that ends in the middle of the print (loop) or a short piece of line
(whorl), softened by a quarter of a pitch: so neighbours are one pitch apart, but for what the
minutiae pull.
"""

from functools import lru_cache
from itertools import product

import numpy as np
import trimesh

from reconstruction.arrays import FloatArray, IntArray
from twin.config.objects import Bear, Brick, Fingerprint
from twin.specimens.catalogue import raised, register, unposed
from twin.specimens.meshes import MeshShape
from twin.specimens.solids import arc, box, grid_facets, level_set, moved, turned, union, without

# The drawing, 16 mm long, on its back, face up, ears towards +y: middle and half axes of the
# parts, mm. Pairs are mirrored in x.
_MIDDLE = [
    ((0.0, -2.1, 0.0), (3.5, 4.1, 2.7)),  # trunk
    ((0.0, -2.3, 1.5), (2.5, 2.9, 2.0)),  # belly
    ((0.0, 3.9, 0.4), (3.1, 2.9, 2.6)),  # head
    ((0.0, 3.1, 2.3), (1.45, 1.15, 1.3)),  # muzzle
    ((0.0, 3.5, 3.35), (0.65, 0.5, 0.5)),  # nose
]
_PAIRED = [
    ((2.45, 6.3, 0.5), (1.4, 1.4, 0.9)),  # ear
    ((1.35, 4.75, 2.4), (0.5, 0.5, 0.5)),  # eye
    ((3.35, 0.1, 1.3), (1.15, 1.9, 1.2)),  # arm
    ((2.5, -0.9, 2.4), (0.9, 0.9, 0.9)),  # paw
    ((2.7, -5.6, 1.1), (1.6, 1.7, 2.3)),  # leg
]
_PARTS = (*_MIDDLE, *_PAIRED, *[((-x, y, z), axes) for (x, y, z), axes in _PAIRED])
_CENTRES_MM = np.array([centre for centre, _ in _PARTS])
_HALF_AXES_MM = np.array([axes for _, axes in _PARTS])
_LEAST_MM = _HALF_AXES_MM.min(axis=-1)
# The box that holds the drawing, x, y, z low and high.
_BOX_MM = (-6.0, -9.0, -4.0, 6.0, 9.0, 5.0)
_COARSE_MM, _REFINED = 0.7, 5
_NEWTON_STEPS, _CLOSE_MM = 5, 1e-9
# Parts reach this far into each other: faces that only touch do not join.
_INTO_MM = 0.2
# Facets of the studs' small rounding; a chord stays within 0.2 um of a 0.1 mm radius.
_EDGE_STEP_DEG = 6.0


@register("bear")
def build_bear(specimen: Bear) -> MeshShape:
    """Scale the drawing to the bear's length, the middle of its bounding box in the origin."""
    body = drawn_bear(specimen.blend_mm).copy()
    body.apply_translation(-body.bounds.mean(axis=0))
    body.apply_scale(specimen.length_mm / body.extents[1])
    return MeshShape(body)


@lru_cache(maxsize=4)
def drawn_bear(blend_mm: float) -> trimesh.Trimesh:
    """Mesh the drawing itself, in its own frame and size."""
    body = level_set(
        lambda x, y, z: float(bear_level_mm(np.array((x, y, z)), blend_mm)),
        _BOX_MM,
        _COARSE_MM,
        _REFINED,
    )
    body.vertices = _on_surface(np.asarray(body.vertices), blend_mm)
    return body


def bear_level_mm(points_mm: FloatArray, blend_mm: float) -> FloatArray:
    """Return the smooth union's level (...) at points (..., xyz) of the drawing.

    0 on the surface, negative inside.
    """
    scaled = (points_mm[..., None, :] - _CENTRES_MM) / _HALF_AXES_MM
    distance = (np.sqrt((scaled**2).sum(axis=-1)) - 1) * _LEAST_MM
    nearest = distance.min(axis=-1)
    total = np.exp((nearest[..., None] - distance) / blend_mm).sum(axis=-1)
    return np.asarray(nearest - blend_mm * np.log(total))


def bear_gradient(points_mm: FloatArray, blend_mm: float) -> FloatArray:
    """Return the level's gradient (n, xyz) at points (n, xyz)."""
    scaled = (points_mm[:, None] - _CENTRES_MM) / _HALF_AXES_MM
    reach = np.maximum(np.sqrt((scaled**2).sum(axis=-1)), 1e-9)
    distance = (reach - 1) * _LEAST_MM
    weight = np.exp((distance.min(axis=-1, keepdims=True) - distance) / blend_mm)
    pull = weight / weight.sum(axis=-1, keepdims=True) * _LEAST_MM / reach
    return np.asarray((pull[..., None] * scaled / _HALF_AXES_MM).sum(axis=1))


def _on_surface(points_mm: FloatArray, blend_mm: float) -> FloatArray:
    """Move points along the gradient until the level is zero; most are there after two steps."""
    moved_mm, off = points_mm.copy(), np.arange(len(points_mm))
    for _ in range(_NEWTON_STEPS):
        level = bear_level_mm(moved_mm[off], blend_mm)
        far = np.abs(level) > _CLOSE_MM
        off = off[far]
        gradient = bear_gradient(moved_mm[off], blend_mm)
        moved_mm[off] -= gradient * (level[far] / (gradient**2).sum(axis=-1))[:, None]
    return moved_mm


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


# Chords stay within depth pi^2 / 4 / 12^2 of a ridge, 1.2 um at 0.07 mm.
_STEPS_PER_PITCH = 12
# Radius of a minutia's core and least distance of two, in pitches.
_VORTEX, _APART = 0.5, 2.5
# Half length of a whorl's core over the pitch; a loop's core leaves the print.
_WHORL_CORE = 4.0
_TRIES = 100


@register("fingerprint")
def build_fingerprint(specimen: Fingerprint) -> MeshShape:
    """Lay the plate with its ridges up."""
    return MeshShape(_plate(unposed(specimen)))


def ridges_mm(print_: Fingerprint, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """Return the ridges' height over the mean surface, same shape as x and y, without the dome."""
    rng = np.random.default_rng(print_.pattern_seed)
    half = np.array([print_.length_x_mm, print_.length_y_mm]) / 2
    core, turn = rng.uniform(-0.15, 0.15, 2) * half, np.deg2rad(90 + rng.uniform(-20, 20))
    along = (x_mm - core[0]) * np.cos(turn) + (y_mm - core[1]) * np.sin(turn)
    across = (y_mm - core[1]) * np.cos(turn) - (x_mm - core[0]) * np.sin(turn)
    ahead = _WHORL_CORE * print_.pitch_mm
    behind = ahead if print_.pattern == "whorl" else np.inf
    beyond = np.maximum(along - ahead, 0) + np.maximum(-behind - along, 0)
    softened = np.sqrt(beyond**2 + across**2 + (print_.pitch_mm / 4) ** 2)
    wave = np.exp(2j * np.pi * softened / print_.pitch_mm)
    for place, sense in _minutiae(print_, half, rng):
        off = (x_mm - place[0]) + 1j * sense * (y_mm - place[1])
        wave *= off / np.sqrt(np.abs(off) ** 2 + (_VORTEX * print_.pitch_mm) ** 2)
    return np.asarray(print_.depth_mm / 2 * wave.real)


def _minutiae(
    print_: Fingerprint, half_mm: FloatArray, rng: np.random.Generator
) -> list[tuple[FloatArray, int]]:
    """Draw places and senses, as many as there is room for; senses alternate."""
    places: list[FloatArray] = []
    for _ in range(_TRIES * print_.minutiae):
        place = rng.uniform(-half_mm, half_mm)
        apart = _APART * print_.pitch_mm
        if len(places) < print_.minutiae and all(np.hypot(*(place - p)) > apart for p in places):
            places.append(place)
    return [(place, 1 - 2 * (number % 2)) for number, place in enumerate(places)]


@lru_cache(maxsize=4)
def _plate(print_: Fingerprint) -> trimesh.Trimesh:
    """Close the ridged surface by walls and a flat base."""
    x, y = (_lines(length, print_.pitch_mm) for length in (print_.length_x_mm, print_.length_y_mm))
    grid_x, grid_y = np.meshgrid(x, y)
    z = ridges_mm(print_, grid_x, grid_y)
    if print_.dome_radius_mm > 0:
        radius2 = print_.dome_radius_mm**2
        z += np.sqrt(radius2 - grid_x**2 - grid_y**2) - print_.dome_radius_mm
    top = np.stack((grid_x, grid_y, z), axis=-1).reshape(-1, 3)
    index = np.arange(z.size).reshape(z.shape)
    rim = np.concatenate((index[0], index[1:, -1], index[-1, -2::-1], index[-2:0:-1, 0]))
    base = top[rim] * [1, 1, 0] + [0, 0, z.min() - print_.thickness_mm]
    below, middle = z.size + np.arange(rim.size), base.mean(axis=0)
    # The base's facets look down.
    fan = (np.roll(below, -1), below, np.full_like(below, z.size + rim.size))
    faces = (grid_facets(*z.shape), _wall(rim, below), np.stack(fan, axis=-1))
    return trimesh.Trimesh(
        np.concatenate((top, base, middle[None])), np.concatenate(faces), process=False
    )


def _lines(length_mm: float, pitch_mm: float) -> FloatArray:
    count = int(np.ceil(length_mm / pitch_mm * _STEPS_PER_PITCH)) + 1
    return np.linspace(-length_mm / 2, length_mm / 2, count)


def _wall(rim: IntArray, below: IntArray) -> IntArray:
    """Return the facets between the rim, counter-clockwise seen from above, and the base."""
    after, below_after = np.roll(rim, -1), np.roll(below, -1)
    return np.stack((rim, below, below_after, rim, below_after, after), axis=-1).reshape(-1, 3)
