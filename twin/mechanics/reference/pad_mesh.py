"""Tetrahedra for one press of a pad: small under the specimen and at the coat above it."""

import numpy as np
import trimesh

from reconstruction.arrays import FloatArray
from twin.mechanics.reference.height_field import sample
from twin.mechanics.reference.pad import Pad, Selector
from twin.mechanics.reference.tetrahedra import (
    Sizing,
    Tetrahedra,
    count_estimate,
    graded_towards,
    tetrahedralize,
)
from twin.specimens import Shape

# 19 k unknowns, a dozen seconds and 0.6 GiB.
DEFAULT_COUNT = 4000
_SPACING_MM = 0.25
# A ball touches where it would reach into the undeformed face by about half the depth.
_REACH = 0.65
_COATED_OVER_FINE = 2.0
# Far away the field is as smooth as the pad is thick.
_COARSEST_OVER_THICKNESS, _COARSEST_MM = 1.5, 3.0


def mesh_pad(
    shape: Shape,
    pad: Pad,
    depth_mm: float,
    *,
    count: int = DEFAULT_COUNT,
    epsilon: float = 1e-3,
    timeout_s: float = 60.0,
) -> Tetrahedra:
    """Fill a pad with about `count` tetrahedra for a press of about `depth_mm`.

    Raises
    ------
    PressError
        The pad is not closed, or the specimen lies beside it.
    SolverError
        pytetwild failed.
    """
    touched, coated = _spread(pad.body, pad.touched), _spread(pad.body, pad.coated)
    zone = _zone(shape, touched, depth_mm)
    above = coated[_near_in_plan(coated, zone)]

    coarsest = min(_COARSEST_OVER_THICKNESS * float(pad.body.extents.min()), _COARSEST_MM)

    def sizing(fine_mm: float) -> Sizing:
        coarse = max(coarsest, fine_mm)
        below = graded_towards(zone, fine_mm, coarse)
        finest = _COATED_OVER_FINE * fine_mm
        over = graded_towards(above, finest, max(coarse, finest))
        return lambda points: np.minimum(below(points), over(points))

    low, high = 0.02, 4.0
    for _ in range(16):
        fine = float(np.sqrt(low * high))
        low, high = (fine, high) if count_estimate(pad.body, sizing(fine)) > count else (low, fine)
    return tetrahedralize(pad.body, sizing(high), epsilon=epsilon, timeout_s=timeout_s)


def _spread(body: trimesh.Trimesh, where: Selector) -> FloatArray:
    """Return points (n, xyz) all over the chosen facets."""
    chosen = where(body.triangles_center, body.face_normals)
    if not chosen.any():
        chosen = np.ones(len(body.faces), dtype=bool)
    vertices, _ = trimesh.remesh.subdivide_to_size(
        body.vertices, body.faces[chosen], max_edge=_SPACING_MM, max_iter=20
    )
    return np.asarray(vertices, dtype=np.float64)


def _zone(shape: Shape, touched: FloatArray, depth_mm: float) -> FloatArray:
    """Return the points of the touched face that the specimen will probably touch."""
    low, high = touched.min(axis=0), touched.max(axis=0)
    reach = 2 * np.maximum(np.abs(low), np.abs(high))
    gap = touched[:, 2] + sample(shape, *reach[:2]).value(touched[:, 0], touched[:, 1])
    # The foremost facets may be missed by the points: take at least the nearest few.
    limit = max(gap.min() + _REACH * depth_mm, np.sort(gap)[min(8, gap.size - 1)])
    zone: FloatArray = touched[np.isfinite(gap) & (gap <= limit)]
    return zone


def _near_in_plan(points: FloatArray, zone: FloatArray) -> FloatArray:
    """Return which points lie within half as far again from the zone's middle as the zone."""
    middle = zone[:, :2].mean(axis=0)
    reach = 1.5 * np.linalg.norm(zone[:, :2] - middle, axis=1).max(initial=_SPACING_MM)
    return np.asarray(np.linalg.norm(points[:, :2] - middle, axis=1) <= reach)
