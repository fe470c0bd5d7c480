"""Fill a closed surface with tetrahedra of graded sizes, by pytetwild in a child process.

pytetwild can crash (always at epsilon 1e-2) or run for minutes (1e-5). It therefore has its own
process, a limit of its processor time, which a busy machine does not change, and an epsilon between
these. The surface of its mesh deviates by about
epsilon, so that vertices near planar faces are moved back on these faces. Its meshes differ from
run to run, even with one thread.
"""

import itertools
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from reconstruction.arrays import FloatArray, IntArray
from twin.mechanics.errors import PressError, SolverError

#: function from points (n, xyz), mm, to target edge lengths (n,), mm
Sizing = Callable[[FloatArray], FloatArray]

_CHILD = Path(__file__).with_name("tetwild_child.py")
# A planar face is kept exactly plane if it has at least this share of the whole surface.
_PLANE_SHARE = 0.02
_BACKGROUND_CELLS = 24
_POOREST_QUALITY = 1e-3
# Increase of the edges' length per distance from the zone of the finest edges.
_GROWTH = 0.35
# Wall-clock limit of a child that waits, over the limit of its processor time.
_WALL_OVER_PROCESSOR = 10.0


@dataclass(frozen=True)
class Tetrahedra:
    """A tetrahedral mesh, positively oriented; mm."""

    #: (point, xyz)
    points_mm: FloatArray
    #: (cell, 4)
    cells: IntArray

    @property
    def volumes_mm3(self) -> FloatArray:
        """(cell,) volumes, positive."""
        return _volumes(self.points_mm, self.cells)

    @property
    def qualities(self) -> FloatArray:
        """(cell,) volume over that of a regular tetrahedron with the same RMS edge, 0 to 1."""
        corner = self.points_mm[self.cells]
        pairs = np.array(list(itertools.combinations(range(4), 2)))
        squares = np.sum((corner[:, pairs[:, 0]] - corner[:, pairs[:, 1]]) ** 2, axis=-1)
        return np.asarray(6 * np.sqrt(2) * self.volumes_mm3 / squares.mean(axis=1) ** 1.5)


def tetrahedralize(
    body: trimesh.Trimesh, sizing: Sizing, *, epsilon: float = 1e-3, timeout_s: float = 60.0
) -> Tetrahedra:
    """Fill a closed surface with tetrahedra of target sizes.

    Parameters
    ----------
    body : surface, mm; surfaces inside the body become faces of the tetrahedra
    sizing : function that returns the target edge length at points
    epsilon : largest deviation of the surface, over the diagonal of the bounding box
    timeout_s : processor time after which the child process ends; it is killed after ten times
        this wall-clock time

    Raises
    ------
    PressError : the surface is not closed
    SolverError : pytetwild crashed, ran out of time, or its mesh is unusable
    """
    if not body.is_watertight:
        raise PressError(
            f"pad: its surface of {len(body.faces)} facets is not closed; repair the mesh"
        )
    box = _background(body, sizing)
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "surface.npz", Path(folder) / "cells.npz"
        np.savez(source, points=body.vertices, facets=body.faces, epsilon=epsilon, **box)
        # fTetWild writes a file into its working folder: the temporary one.
        command = [sys.executable, "-P", str(_CHILD), str(source), str(target), str(timeout_s)]
        _run_child(command, timeout_s, folder)
        with np.load(target) as mesh:
            points, cells = mesh["points"], mesh["cells"].astype(np.int64)
    snapped = _snap(points, body, 2 * epsilon * body.scale)
    return _checked(*_collapse(snapped, cells, 1e-9 * body.scale))


def graded_towards(zone_mm: FloatArray, fine_mm: float, coarse_mm: float) -> Sizing:
    """Return a sizing: edges of `fine_mm` at the points `zone_mm` (n, xyz), longer elsewhere.

    The target length increases with the distance from these points, up to `coarse_mm`.
    """
    tree = cKDTree(zone_mm)

    def sizing(points_mm: FloatArray) -> FloatArray:
        distance, _ = tree.query(points_mm)
        return np.clip(fine_mm + _GROWTH * np.asarray(distance), fine_mm, coarse_mm)

    return sizing


def count_estimate(body: trimesh.Trimesh, sizing: Sizing) -> float:
    """Return the approximate number of tetrahedra for a sizing."""
    low, high = body.bounds
    axes = [np.linspace(a, b, 24) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    # A regular tetrahedron of edge e has a volume of e^3 / (6 sqrt 2).
    share = body.volume / np.prod(high - low)
    return float(np.mean(6 * np.sqrt(2) / sizing(points) ** 3) * np.prod(high - low) * share)


def _run_child(command: list[str], timeout_s: float, folder: str) -> None:
    wall_s = _WALL_OVER_PROCESSOR * timeout_s
    try:
        ended = subprocess.run(
            command, capture_output=True, text=True, timeout=wall_s, check=False, cwd=folder
        )
    except subprocess.TimeoutExpired:
        raise SolverError(
            f"pytetwild: no mesh within {wall_s:g} s; request fewer tetrahedra"
        ) from None
    if ended.returncode < 0:
        name = signal.Signals(-ended.returncode).name
        message = f"its process ended by {name}; repair the surface or change epsilon"
        if name == "SIGXCPU":
            message = f"no mesh within {timeout_s:g} s of processor time; request fewer tetrahedra"
        raise SolverError(f"pytetwild: {message}")
    if ended.returncode:
        message = (ended.stderr.strip().splitlines() or ["no message"])[-1]
        raise SolverError(f"pytetwild: failed ({message})")


def _background(body: trimesh.Trimesh, sizing: Sizing) -> dict[str, Any]:
    """Return a box of tetrahedra round the body with target edge lengths at its points.

    Keys: `background_points` (n, xyz), `background_cells` (m, 4) and `size` (n,), mm.
    """
    low, high = body.bounds
    margin = 0.05 * (high - low).max()
    step = (high - low).max() / _BACKGROUND_CELLS
    axes = [
        np.linspace(a - margin, b + margin, int(np.ceil((b - a) / step)) + 4)
        for a, b in zip(low, high, strict=True)
    ]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(points.shape[0]).reshape([axis.size for axis in axes])
    cells = []
    # Kuhn's split: one tetrahedron per permutation of the axes.
    for order in itertools.permutations(range(3)):
        corner, corners = [0, 0, 0], []
        for axis in (*order, None):
            window = tuple(slice(c, n - 1 + c) for c, n in zip(corner, number.shape, strict=True))
            corners.append(number[window].ravel())
            if axis is not None:
                corner[axis] = 1
        cells.append(np.stack(corners, axis=1))
    return {
        "background_points": points,
        "background_cells": np.concatenate(cells),
        "size": sizing(points),
    }


def _snap(points: FloatArray, body: trimesh.Trimesh, reach_mm: float) -> FloatArray:
    """Move vertices within `reach_mm` of a large planar face of the body onto that face."""
    moved = points.copy()
    for faces, area in zip(body.facets, body.facets_area, strict=True):
        if area < _PLANE_SHARE * body.area:
            continue
        corner, normal = body.vertices[body.faces[faces[0]][0]], body.face_normals[faces[0]]
        outline = body.vertices[np.unique(body.faces[faces])]
        height = (moved - corner) @ normal
        low, high = outline.min(axis=0) - reach_mm, outline.max(axis=0) + reach_mm
        near = (np.abs(height) < reach_mm) & ((moved >= low) & (moved <= high)).all(axis=1)
        moved[near] -= height[near, None] * normal
    return moved


def _collapse(points: FloatArray, cells: IntArray, reach_mm: float) -> tuple[FloatArray, IntArray]:
    """Join vertices that `_snap` moved to the same point, and remove the cells that collapse."""
    tree = cKDTree(points)
    first = np.arange(len(points))
    pairs = tree.query_pairs(reach_mm, output_type="ndarray")
    np.minimum.at(first, pairs.max(axis=1), pairs.min(axis=1))
    joined = np.sort(first[cells], axis=1)
    solid = (np.diff(joined, axis=1) > 0).all(axis=1)
    used, renumbered = np.unique(first[cells[solid]], return_inverse=True)
    return points[used], renumbered.reshape(-1, 4).astype(np.int64)


def _volumes(points: FloatArray, cells: IntArray) -> FloatArray:
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    return np.asarray(np.linalg.det(edges) / 6)


def _checked(points: FloatArray, cells: IntArray) -> Tetrahedra:
    turned = _volumes(points, cells) < 0
    cells[turned] = cells[turned][:, [1, 0, 2, 3]]
    mesh = Tetrahedra(points, cells)
    if not len(cells) or mesh.qualities.min() < _POOREST_QUALITY:
        poorest = mesh.qualities.min() if len(cells) else 0.0
        raise SolverError(
            f"pytetwild: {len(cells)} tetrahedra, the poorest of quality {poorest:.1g}; "
            "run again or change the sizes"
        )
    return mesh
