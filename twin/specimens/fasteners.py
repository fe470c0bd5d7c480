"""Hex nut and hammer-head bolt, with metric screw threads as closed helical bodies.

Basic profile of ISO 68-1: flanks at 60 degrees to each other, flat crests of pitch / 8 on the
major diameter D, flat roots of pitch / 4 on the minor diameter D - (5/4) H, H = (sqrt(3)/2) pitch.
A bolt's shank is this body itself, a nut's hole is what it cuts.
"""

from functools import lru_cache
from math import sqrt

import numpy as np
import trimesh

from reconstruction.arrays import FloatArray, IntArray
from twin.config.objects import Nut, TBolt
from twin.specimens.catalogue import register, unposed
from twin.specimens.meshes import MeshShape
from twin.specimens.solids import (
    SECTIONS,
    along_axis,
    arc,
    box,
    common,
    moved,
    prism,
    turned,
    union,
    without,
)

# Axial places of the profile's kinks within one pitch, beginning with the root's flat.
_KINKS = np.array([0.0, 4.0, 9.0, 11.0]) / 16
_CHAMFER_SLOPE = np.tan(np.deg2rad(30))
_COUNTERSINK_SLOPE = np.tan(np.deg2rad(30))  # 120 degrees between the flanks
_X, _Y, _Z = np.eye(3)
# Rotations that bring the bolt's own axes (shank along -z, head's long side along y) into place.
_FACING: dict[str, tuple[FloatArray, FloatArray, FloatArray]] = {
    "side": (-_Z, _Y, _X),
    "tip": (-_X, _Y, -_Z),
    "head": (_X, _Y, _Z),
}


def minor_diameter_mm(major_mm: float, pitch_mm: float) -> float:
    """Return D1 = D - (5/4) H, ISO 68-1."""
    return major_mm - 1.25 * sqrt(3) / 2 * pitch_mm


def screw(
    major_mm: float, pitch_mm: float, low_mm: float, high_mm: float, sections: int = SECTIONS
) -> trimesh.Trimesh:
    """Return a right-handed threaded rod about z that covers z = low to high and a bit more.

    Parameters
    ----------
    low_mm, high_mm : heights between which the thread is complete; the ends beyond them are ragged,
        to be cut
    sections : facets round one turn

    Notes
    -----
    The surface is a grid over angle and kink of the profile, sheared so that its lines follow the
    helix; one turn further is the same line one pitch higher. Both ends are closed by fans to a
    point of the axis, which cannot meet the flanks: the ends lie on the root.
    """
    turns = int(np.ceil((high_mm - low_mm) / pitch_mm)) + 3
    start = low_mm - 1.5 * pitch_mm
    rows = 4 * turns + 1
    row, column = np.meshgrid(np.arange(rows), np.arange(sections), indexing="ij")
    turn = 2 * np.pi * column / sections
    z = start + pitch_mm * (row // 4 + _KINKS[row % 4] + column / sections)
    minor = minor_diameter_mm(major_mm, pitch_mm)
    radius = np.where(row % 4 < 2, minor, major_mm) / 2
    grid = np.stack((radius * np.cos(turn), radius * np.sin(turn), z), axis=-1).reshape(-1, 3)
    ends = [(0.0, 0.0, start + pitch_mm / 2), (0.0, 0.0, start + pitch_mm * (turns + 0.5))]
    faces = np.concatenate((_sides(rows, sections), _ends(rows, sections)))
    return trimesh.Trimesh(np.concatenate((grid, ends)), faces, process=False)


def _sides(rows: int, sections: int) -> IntArray:
    """Return the facets between the lines of the helix."""
    index = np.arange(rows * sections).reshape(rows, sections)
    # Beyond the last column comes the first one, one pitch (four kinks) higher.
    beyond = np.concatenate((index[4:, 0], np.full(4, -1)))
    index = np.concatenate((index, beyond[:, None]), axis=1)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    whole = (b >= 0) & (c >= 0)
    corners = np.stack((a, b, c, a, c, d), axis=-1)[whole]
    return corners.reshape(-1, 3)


def _ends(rows: int, sections: int) -> IntArray:
    """Return the fans that close the lower and the upper end."""
    index = np.arange(rows * sections).reshape(rows, sections)
    lower = np.concatenate((index[0], index[4:0:-1, 0]))
    upper = np.concatenate((index[-1], index[-2:-5:-1, -1], index[-5:-4, -1]))
    centre = rows * sections
    down = _fan(lower[::-1], centre)
    return np.concatenate((down, _fan(upper, centre + 1)))


def _fan(loop: IntArray, centre: int) -> IntArray:
    return np.stack((loop, np.roll(loop, -1), np.full_like(loop, centre)), axis=-1)


@register("nut")
def build_nut(specimen: Nut) -> MeshShape:
    """Lay the nut flat, its axis along z, two of its flats across y."""
    return MeshShape(_nut(unposed(specimen)))


@lru_cache(maxsize=8)
def _nut(nut: Nut) -> trimesh.Trimesh:
    """Chamfer a hexagon, then cut the thread and both countersinks."""
    half, corner_mm = nut.height_mm / 2, nut.across_flats_mm / np.sqrt(3)
    turn = np.arange(6) * np.pi / 3
    hexagon = corner_mm * np.stack((np.cos(turn), np.sin(turn)), axis=-1)
    body = prism(hexagon, -half, half)
    if nut.chamfer_mm > 0:
        body = common([body, _chamfered(nut.face_radius_mm, corner_mm, half)])
    holes = [screw(nut.thread_mm, nut.pitch_mm, -half, half)]
    if nut.countersink_mm > minor_diameter_mm(nut.thread_mm, nut.pitch_mm):
        holes += [_countersink(nut.countersink_mm / 2, half, side) for side in (1, -1)]
    return without(body, *holes)


def _chamfered(face_radius_mm: float, corner_mm: float, half_mm: float) -> trimesh.Trimesh:
    """Return a disc with 30 degree chamfers that begin at the face radius."""
    rim = corner_mm * 1.1
    fall = (rim - face_radius_mm) * _CHAMFER_SLOPE
    upper = [(rim, half_mm - fall), (face_radius_mm, half_mm)]
    lower = [(face_radius_mm, -half_mm), (rim, fall - half_mm)]
    disc = turned([(0.0, -half_mm), *lower, *upper, (0.0, half_mm)])
    # Half a facet on: the hexagon's corners shall not fall on the disc's edges.
    disc.apply_transform(trimesh.transformations.rotation_matrix(np.pi / SECTIONS, _Z))
    return disc


def _countersink(radius_mm: float, half_mm: float, side: int) -> trimesh.Trimesh:
    """Return a cone for the upper (+1) or lower (-1) face, reaching beyond it."""
    depth_mm = radius_mm * _COUNTERSINK_SLOPE
    rim = (2 * radius_mm, half_mm + depth_mm)
    cone = turned([(0.0, half_mm - depth_mm), rim, (0.0, half_mm + 2 * depth_mm)])
    return cone if side > 0 else along_axis(cone, _X, -_Y, -_Z)


@register("t_bolt")
def build_t_bolt(specimen: TBolt) -> MeshShape:
    """Lay or stand the bolt, the middle of its length in the origin."""
    bolt = _bolt(unposed(specimen.model_copy(update={"facing": "side"})))
    length_below = specimen.shank_mm + specimen.neck_mm
    centred = moved(bolt, 0.0, 0.0, (length_below - specimen.head_height_mm) / 2)
    return MeshShape(along_axis(centred, *_FACING[specimen.facing]))


@lru_cache(maxsize=8)
def _bolt(bolt: TBolt) -> trimesh.Trimesh:
    """Join head (above z = 0), neck and shank (below it)."""
    half, inside_mm = bolt.head_width_mm / 2, bolt.head_height_mm / 2
    head = prism(_hammer(bolt.head_length_mm / 2, half), 0.0, bolt.head_height_mm)
    # Each part reaches into the one above it: faces that only touch do not join.
    neck = box((-half, -half, -bolt.neck_mm), (half, half, inside_mm))
    tip_mm = -bolt.neck_mm - bolt.shank_mm
    thread = screw(bolt.thread_mm, bolt.pitch_mm, tip_mm, inside_mm)
    envelope = _shank(bolt.thread_mm, bolt.pitch_mm, tip_mm, -bolt.neck_mm / 2)
    return union([head, neck, common([thread, envelope])])


def _hammer(half_length_mm: float, half_width_mm: float) -> FloatArray:
    """Return the head's outline: two opposite corners are round, so that it turns in the slot."""
    radius = min(half_width_mm, half_length_mm)
    x, y = half_width_mm, half_length_mm
    first = arc((x - radius, y - radius), radius, 0, 90)
    second = arc((radius - x, radius - y), radius, 180, 270)
    return np.array([*first, (-x, y), *second, (x, -y)])


def _shank(thread_mm: float, pitch_mm: float, tip_mm: float, top_mm: float) -> trimesh.Trimesh:
    """Return the shank's envelope: a cylinder whose tip is chamfered at 45 degrees."""
    root, outer = minor_diameter_mm(thread_mm, pitch_mm) / 2 * 0.95, thread_mm
    profile = [(0.0, tip_mm), (root, tip_mm), (outer, tip_mm + outer - root), (outer, top_mm)]
    return turned([*profile, (0.0, top_mm)])
