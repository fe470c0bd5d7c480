"""Specimens given as a triangle mesh: a closed surface from a file, or a grating made here.

The upper side of a mesh as a height map is found by vertical rays, exact at every cell.
"""

import codecs
import io
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import trimesh

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.errors import InputError, one_line
from reconstruction.reading import is_regular, read_bytes
from twin.assets import mesh_path
from twin.config.models import Grating, MeshFile
from twin.config.specimen_base import Specimen
from twin.config.specimens import Group
from twin.specimens.catalogue import UNMOVED, Placement, Shape, register
from twin.specimens.distance import BoxDistance, SignedDistance
from twin.specimens.sampled_distance import MeshDistance
from twin.specimens.solids import rounded_box

_FILE_TYPES = (".stl", ".ply", ".obj")
_MOST_BYTES = 2**30
# trimesh would take it for the last vertex: a body of another form, closed all the same.
_NUMBERED_FROM_0 = re.compile(rb"^[ \t]*+f[ \t]++(?:\S++[ \t]++)*?0(?:/|\s|$)", re.MULTILINE)
# In the file's own units, which may be metres. Beyond them distances are lost in rounding.
_EXTENT = 1e-6, 1e6
# Bodies that a sensor can press or image; less is a part that fits whose file is in metres.
_SIZE_MM = 0.1, 1000.0
# Below this a body may be one whose file is in metres or inches.
_DOUBTFUL_MM = 1.0
# Volume over that of a cube of its size, far below a needle's: less has no inside.
_LEAST_FILL = 1e-8
_STEPS_PER_PITCH = 48
_BODY_MM = 2.0
# Rows: the file's axes that become x, y and z, for each axis that may face the elastomer.
_UP = {
    "+z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "+y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "-y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "+x": ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    "-x": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
}


def read_closed_mesh(key: str, name: str) -> trimesh.Trimesh:
    """Read a closed surface.

    Parameters
    ----------
    key : key of the experiment file that names it, for messages
    name : path of an STL, PLY or OBJ file; `scenes/...` finds shipped ones too

    Raises
    ------
    InputError : the file is missing, no mesh, empty, not watertight or without an inside
    """
    path = _find(key, name)
    content = read_bytes(path, _MOST_BYTES).removeprefix(codecs.BOM_UTF8)
    kind = path.suffix[1:].lower()
    if kind == "obj" and _NUMBERED_FROM_0.search(content):
        raise InputError(
            f"{key}: {path}: a face names vertex 0, but an OBJ counts from 1; export it again"
        )
    # Numbers of any size overflow in what trimesh derives; they are told below.
    with np.errstate(all="ignore"):
        try:
            # Not by its name: a mesh may name pictures and materials, which would be opened, too.
            surface = trimesh.load_mesh(io.BytesIO(content), file_type=kind, process=False)
        except Exception as error:  # each of trimesh's readers raises its own
            reason = one_line(error) or type(error).__name__
            raise InputError(f"{key}: {path}: cannot be read ({reason})") from error
        _require_numbers(f"{key}: {path}", surface)
        surface = _welded(surface)
        _require_closed(f"{key}: {path}", surface)
        if surface.volume < 0.0:  # every triangle seen from the wrong side
            surface.invert()
    return surface


def read_body_mm(key: str, name: str, scale_key: str, mm_per_unit: float) -> trimesh.Trimesh:
    """Read a closed surface and scale it to mm.

    Parameters
    ----------
    key, name : as for `read_closed_mesh`
    scale_key, mm_per_unit : key that scales it, for messages; mm, length of one unit of the file

    Raises
    ------
    InputError : as `read_closed_mesh`, or the body is implausibly small or large
    """
    surface = read_closed_mesh(key, name)
    size_mm, (least, most) = float(surface.extents.max()) * mm_per_unit, _SIZE_MM
    if not least <= size_mm <= most:
        sizes = " x ".join(f"{side * mm_per_unit:.3g}" for side in surface.extents)
        raise InputError(
            f"{key}: {name}: {sizes} mm at {scale_key} = {mm_per_unit:g} mm per unit of the file, "
            f"allowed {least:g} to {most:g} mm for its longest side; set {scale_key} to the file's "
            "unit in mm: 1000 for metres, 25.4 for inches, 0.001 for micrometres"
        )
    surface.apply_scale(mm_per_unit)
    return surface


def unit_warnings(specimen: Specimen) -> tuple[str, ...]:
    """Return a warning for each mesh so small that its file may be in metres or inches."""
    if isinstance(specimen, Group):
        return tuple(line for part in specimen.parts.values() for line in unit_warnings(part))
    if not isinstance(specimen, MeshFile):
        return ()
    size_mm = float(build_mesh(specimen).body.extents.max())
    if size_mm >= _DOUBTFUL_MM:
        return ()
    return (
        f"the longest side of {specimen.file} is {size_mm:.2g} mm at specimen.scale = "
        f"{specimen.scale:g}: if the file is in metres, set specimen.scale = 1000; in inches, 25.4",
    )


def _welded(surface: trimesh.Trimesh) -> trimesh.Trimesh:
    """Join vertices at the same position, which files split by normal, texture and material."""
    joined = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    joined.merge_vertices()
    a, b, c = joined.faces.T
    joined.update_faces((a != b) & (b != c) & (c != a))  # slivers that joining made lines
    return joined


def _require_numbers(where: str, surface: object) -> None:
    """Refuse what is no surface in space."""
    if not isinstance(surface, trimesh.Trimesh) or not len(surface.faces):
        raise InputError(f"{where}: holds no triangles")
    if not np.isfinite(surface.vertices).all():
        raise InputError(f"{where}: holds vertices that are no numbers; export it again")
    if surface.faces.min() < 0 or surface.faces.max() >= len(surface.vertices):
        raise InputError(f"{where}: its triangles name vertices that it lacks; export it again")
    size, (least, most) = float(surface.extents.max()), _EXTENT
    if not least <= size <= most:
        raise InputError(
            f"{where}: found a size of {size:.3g} in the file's units, allowed {least:g} to "
            f"{most:g}"
        )


def _require_closed(where: str, surface: trimesh.Trimesh) -> None:
    """Refuse what encloses no body."""
    if not surface.is_watertight:
        open_edges = len(trimesh.grouping.group_rows(surface.edges_sorted, require_count=1))
        found = f"{open_edges} open edges" if open_edges else "edges of more than two triangles"
        raise InputError(
            f"{where}: not watertight ({found}); close it, for example "
            "with pytetwild or the repair tool of your mesh editor"
        )
    if not surface.is_winding_consistent:
        raise InputError(
            f"{where}: its triangles face both inwards and outwards; let your mesh editor make "
            "their normals agree"
        )
    if not abs(surface.volume) > _LEAST_FILL * float(surface.extents.max()) ** 3:
        raise InputError(f"{where}: encloses no volume; give a body that has an inside")


def _find(key: str, name: str) -> Path:
    path = mesh_path(name)
    if not is_regular(path):
        found = "not a file" if path.exists() else "no such file"
        raise InputError(f"{key}: {name}: {found}")
    if path.suffix.lower() not in _FILE_TYPES:
        raise InputError(f"{key}: {name}: not a mesh, allowed: {', '.join(_FILE_TYPES)}")
    return path


@dataclass(frozen=True, eq=False)
class MeshShape(Shape):
    """A closed surface of triangles."""

    #: the surface in the frame in which it was made
    body: trimesh.Trimesh
    #: how it was moved since
    pose: Placement = UNMOVED
    #: its distance in a pose in closed form, where there is one
    exact: Callable[[Placement], SignedDistance] | None = None

    @cached_property
    def surface(self) -> trimesh.Trimesh:
        """The surface in place."""
        moved = self.body.copy()
        moved.apply_transform(self.pose.matrix)
        return moved

    @property
    def top_mm(self) -> float:
        """Height of the foremost vertex."""
        return float(self.surface.bounds[1, 2])

    @property
    def bottom_mm(self) -> float:
        """Height of the vertex farthest back."""
        return float(self.surface.bounds[0, 2])

    def placed(self, pose: Placement) -> "MeshShape":
        """Return the surface moved."""
        return replace(self, pose=self.pose.then(pose))

    def distances(self) -> tuple[SignedDistance, ...]:
        """Return the distance to the surface."""
        return (self.exact(self.pose) if self.exact else MeshDistance(self.body, self.pose),)

    def bounds_mm(self) -> tuple[float, float, float, float]:
        """Return the outline in world xy: (x low, x high, y low, y high)."""
        (x_low, y_low, _), (x_high, y_high, _) = self.surface.bounds
        return float(x_low), float(x_high), float(y_low), float(y_high)

    def height_above_lowest(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return (row, col) float, mm, inf outside the outline."""
        return -upper_side(np.asarray(self.surface.triangles), x_mm, y_mm)

    def mesh(self, touched_z_mm: float) -> trimesh.Trimesh:
        """Return the surface itself."""
        raised = self.surface.copy()
        raised.apply_translation((0.0, 0.0, touched_z_mm))
        return raised


def block(
    low_mm: tuple[float, float, float], high_mm: tuple[float, float, float], edge_radius_mm: float
) -> MeshShape:
    """Return a block between two opposite corners, its edges rounded."""
    low, high = np.array(low_mm), np.array(high_mm)

    def exact(pose: Placement) -> SignedDistance:
        middle = pose.apply((low + high) / 2)
        return BoxDistance(middle, pose.rotation, (high - low) / 2, edge_radius_mm)

    return MeshShape(rounded_box(low_mm, high_mm, edge_radius_mm), exact=exact)


@register("mesh")
def build_mesh(specimen: MeshFile) -> MeshShape:
    """Read a mesh file, turn its `up` axis upwards and centre its bounding box.

    Raises
    ------
    InputError : the file is missing, no mesh, empty, not watertight or of implausible size
    """
    surface = read_body_mm("specimen.file", specimen.file, "specimen.scale", specimen.scale)
    turn = np.eye(4)
    turn[:3, :3] = _UP[specimen.up]
    surface.apply_transform(turn)
    surface.apply_translation(-surface.bounds.mean(axis=0))
    return MeshShape(surface)


@register("grating")
def build_grating(specimen: Grating) -> MeshShape:
    """Make a plate with grooves along y; their crests stand at whole pitches from the middle."""
    steps = max(2, round(specimen.length_x_mm / specimen.pitch_mm * _STEPS_PER_PITCH))
    x = np.linspace(-specimen.length_x_mm / 2, specimen.length_x_mm / 2, steps + 1)
    z = specimen.groove_mm / 2 * np.cos(2 * np.pi * x / specimen.pitch_mm)
    y, base = specimen.length_y_mm / 2, -specimen.groove_mm - _BODY_MM
    rows = [(x, y, z), (x, -y, z), (x, -y, np.full_like(x, base)), (x, y, np.full_like(x, base))]
    vertices = np.concatenate(
        [np.stack((along, np.full_like(along, side), up), axis=-1) for along, side, up in rows]
    )
    return MeshShape(trimesh.Trimesh(vertices, _prism_facets(x.size), process=False))


def _prism_facets(count: int) -> IntArray:
    """Return the facets of four lines of vertices joined to a closed bar."""
    step = np.arange(count - 1)
    sides = []
    for line in range(4):
        a, b = line * count + step, (line + 1) % 4 * count + step
        sides += [np.stack((a, b, b + 1), axis=-1), np.stack((a, b + 1, a + 1), axis=-1)]
    last = count - 1
    ends = [(0, 3 * count, 2 * count), (0, 2 * count, count)]
    ends += [(last + c, last + b, last + a) for a, b, c in ends]
    return np.concatenate((*sides, np.array(ends)))


# Rays per batch: bounds the memory of a mesh with few large triangles.
_BATCH = 2_000_000
# A ray through an edge belongs to both triangles, so that no gap opens between them.
_ON_EDGE_MM = 1e-9
# Triangles of less area seen from above stand upright: their neighbours carry the outline.
_EDGE_ON_MM2 = 1e-14


def upper_side(triangles_mm: FloatArray, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """Return the highest z of a mesh over each point of a grid.

    Parameters
    ----------
    triangles_mm : (n, 3, xyz) float, mm; corners
    x_mm, y_mm : (col,) and (row,) float, mm; grid lines in any order

    Returns
    -------
    (row, col) float, mm; -inf where no triangle is met
    """
    order_x, order_y = np.argsort(x_mm, kind="stable"), np.argsort(y_mm, kind="stable")
    sorted_x, sorted_y = x_mm[order_x], y_mm[order_y]
    triangles = triangles_mm[np.abs(_doubled_area(triangles_mm)) > 2 * _EDGE_ON_MM2]
    owner, row = _expanded(*_covered(sorted_y, *_limits(triangles[..., 1])))
    low, high = _crossing(triangles[owner], sorted_y[row])
    first, count = _covered(sorted_x, low, high)
    top = np.full((y_mm.size, x_mm.size), -np.inf)
    cuts = np.flatnonzero(np.diff(np.cumsum(count) // _BATCH)) + 1
    for scan in np.split(np.arange(owner.size), cuts):
        which, col = _expanded(first[scan], count[scan])
        which = scan[which]
        z = _height(triangles[owner[which]], sorted_x[col], sorted_y[row[which]])
        np.maximum.at(top, (row[which], col), z)
    found = np.zeros_like(top)
    found[np.ix_(order_y, order_x)] = top
    return found


def _doubled_area(triangles: FloatArray) -> FloatArray:
    """Return twice the signed area seen from above."""
    ab, ac = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return np.asarray(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])


def _limits(values_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    return values_mm.min(axis=1), values_mm.max(axis=1)


def _covered(
    lines_mm: FloatArray, low_mm: FloatArray, high_mm: FloatArray
) -> tuple[IntArray, IntArray]:
    """Return the first grid line within each interval, and how many there are."""
    first = np.searchsorted(lines_mm, low_mm - _ON_EDGE_MM, side="left")
    after = np.searchsorted(lines_mm, high_mm + _ON_EDGE_MM, side="right")
    return first, np.maximum(after - first, 0)


def _expanded(first: IntArray, count: IntArray) -> tuple[IntArray, IntArray]:
    """Return owner and grid line of every member of intervals first..first + count - 1."""
    owner = np.repeat(np.arange(first.size), count)
    within = np.arange(owner.size) - np.repeat(np.cumsum(count) - count, count)
    return owner, first[owner] + within


def _crossing(triangles: FloatArray, y_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where the line y = const enters and leaves each triangle, along x."""
    begin, end = triangles[..., :2], np.roll(triangles, -1, axis=1)[..., :2]
    rise = end[..., 1] - begin[..., 1]
    level = np.abs(rise) <= _ON_EDGE_MM
    share = (y_mm[:, None] - begin[..., 1]) / np.where(level, 1.0, rise)
    x = begin[..., 0] + np.clip(share, 0, 1) * (end[..., 0] - begin[..., 0])
    slack = _ON_EDGE_MM / np.maximum(np.abs(rise), _ON_EDGE_MM)
    met = ~level & (share >= -slack) & (share <= 1 + slack)
    return (
        np.where(met, x, np.inf).min(axis=1, initial=np.inf),
        np.where(met, x, -np.inf).max(axis=1, initial=-np.inf),
    )


def _height(triangles: FloatArray, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """Return z of each triangle's plane, within the triangle's own z."""
    a = triangles[:, 0]
    ab, ac = triangles[:, 1] - a, triangles[:, 2] - a
    dx, dy = x_mm - a[:, 0], y_mm - a[:, 1]
    along_ab = dx * ac[:, 1] - dy * ac[:, 0]
    along_ac = dy * ab[:, 0] - dx * ab[:, 1]
    rise = (along_ab * ab[:, 2] + along_ac * ac[:, 2]) / _doubled_area(triangles)
    return np.asarray(np.clip(a[:, 2] + rise, *_limits(triangles[..., 2])))
