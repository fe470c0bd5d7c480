"""Specimens given as a triangle mesh: a closed surface from a file, or a grating made here."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import trimesh

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError
from twin.assets import mesh_path
from twin.config.models import Grating, MeshFile
from twin.specimens.catalogue import UNMOVED, Placement, Sphere, register
from twin.specimens.distance import BoxDistance, SignedDistance
from twin.specimens.raster import upper_side
from twin.specimens.sampled_distance import MeshDistance
from twin.specimens.solids import rounded_box

_FILE_TYPES = (".stl", ".ply", ".obj")
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
    InputError : the file is missing, no mesh, empty or not watertight
    """
    path = _find(key, name)
    try:
        surface = trimesh.load_mesh(path)
    except Exception as error:  # each of trimesh's readers raises its own
        raise InputError(f"{key}: {path}: cannot be read ({error})") from error
    if not isinstance(surface, trimesh.Trimesh) or surface.is_empty:
        raise InputError(f"{key}: {path}: holds no triangles")
    if not surface.is_watertight:
        edges = len(trimesh.grouping.group_rows(surface.edges_sorted, require_count=1))
        raise InputError(
            f"{key}: {path}: not watertight ({edges} open edges); close it, for example "
            "with pytetwild or the repair tool of your mesh editor"
        )
    return surface


def _find(key: str, name: str) -> Path:
    path = mesh_path(name)
    if not path.is_file():
        raise InputError(f"{key}: {name}: no such file")
    if path.suffix.lower() not in _FILE_TYPES:
        raise InputError(f"{key}: {name}: not a mesh, allowed: {', '.join(_FILE_TYPES)}")
    return path


@dataclass(frozen=True, eq=False)
class MeshShape:
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

    def spheres(self) -> tuple[Sphere, ...]:
        """No balls."""
        return ()

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
    InputError : the file is missing, no mesh, empty or not watertight
    """
    surface = read_closed_mesh("specimen.file", specimen.file)
    surface.apply_scale(specimen.scale)
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


def _prism_facets(count: int) -> np.ndarray[tuple[int, int], np.dtype[np.int64]]:
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
