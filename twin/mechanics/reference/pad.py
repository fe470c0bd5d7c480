"""An elastic pad of any shape: surface, supports, faces and tetrahedra.

World frame, mm: the specimen is below the pad and presses along +z. A selector is a function that
selects facets of the surface by their centres and outward normals. For each press the pad is meshed
with tetrahedra that are small at the contact and at the coat above it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import trimesh
from scipy.interpolate import CloughTocher2DInterpolator

from reconstruction.arrays import BoolArray, FloatArray
from twin.config.models import Elastomer
from twin.mechanics.errors import PressError
from twin.mechanics.reference.result import sample
from twin.mechanics.reference.tetrahedra import (
    Sizing,
    Tetrahedra,
    count_estimate,
    graded_towards,
    tetrahedralize,
)
from twin.shape import Shape
from twin.specimens.meshes import upper_side

#: from centres (facet, xyz), mm, and outward unit normals (facet, xyz): whether to select (facet,)
Selector = Callable[[FloatArray, FloatArray], BoolArray]
SlabSupport = Literal["simple", "clamped", "ledge", "bonded", "window"]

_ON_PLANE_MM = 1e-6
# Number of steps from the middle to the rim in the test whether a face covers a rectangle.
_COVER_STEPS = 100
# Directions in which the sides normal to x, and those normal to y, have no displacement.
_RIM: dict[SlabSupport, tuple[str, str]] = {
    "simple": ("yz", "xz"),
    "clamped": ("xyz", "xyz"),
    "ledge": ("", ""),
    "bonded": ("", ""),
    "window": ("x", "y"),
}
# Adjacent facets with a larger angle between their normals have a crease, not a curved surface.
_CREASE_DEG = 15.0
# This number gives 19 k unknowns, a run time of a dozen seconds and 0.6 GiB.
DEFAULT_COUNT = 4000
_SPACING_MM = 0.25
# A ball touches where it would penetrate the undeformed face by about half the depth.
_REACH = 0.65
_COATED_OVER_FINE = 2.0
# Far from the contact the field is as smooth as the pad is thick.
_COARSEST_OVER_THICKNESS, _COARSEST_MM = 1.5, 3.0


@dataclass(frozen=True)
class Hold:
    """Support of a pad: selected facets have zero displacement in some directions."""

    where: Selector
    #: directions without displacement: letters of "xyz"
    directions: str = "xyz"


@dataclass(frozen=True)
class Pad:
    """An elastic body with its supports and faces; lengths in mm, world frame."""

    #: closed surface; surfaces inside the body become faces of the tetrahedra
    body: trimesh.Trimesh
    poisson_ratio: float
    holds: tuple[Hold, ...]
    #: selectors of the face that the specimen touches and of the coated face
    touched: Selector
    coated: Selector
    #: whether the specimen touches the coated face and the surface of `body` is its drawing
    is_designed: bool = False


def facing(direction: tuple[float, float, float], within_deg: float = 60.0) -> Selector:
    """Return a selector of facets with a normal less than `within_deg` from `direction`."""
    axis = np.asarray(direction) / np.linalg.norm(direction)
    least = np.cos(np.deg2rad(within_deg))
    return lambda centres, normals: np.asarray(normals @ axis > least)


def on_plane(axis: Literal["x", "y", "z"], value_mm: float) -> Selector:
    """Return a selector of facets on the plane `axis` = `value_mm`."""
    column = "xyz".index(axis)
    return lambda centres, normals: np.asarray(
        (np.abs(centres[:, column] - value_mm) < _ON_PLANE_MM)
        & (np.abs(normals[:, column]) > 1 - _ON_PLANE_MM)
    )


def both(first: Selector, second: Selector) -> Selector:
    """Return a selector of the facets that both given selectors select."""
    return lambda centres, normals: first(centres, normals) & second(centres, normals)


def outside_of(length_x_mm: float, length_y_mm: float) -> Selector:
    """Return a selector of facets with a centre outside a centred rectangle in plan."""
    return lambda centres, normals: np.asarray(
        (np.abs(centres[:, 0]) > length_x_mm / 2) | (np.abs(centres[:, 1]) > length_y_mm / 2)
    )


def check_cover(body: trimesh.Trimesh, coated: Selector, elastomer: Elastomer) -> None:
    """Raise an error if a pad's coated face does not cover a rectangle of the elastomer's lengths.

    Raises
    ------
    PressError : the message states the rectangle, and the largest covered rectangle with the same
        ratio of sides
    """
    chosen = coated(body.triangles_center, body.face_normals)
    if not chosen.any():
        raise PressError(
            "mechanics.pad: no facet faces down, where a specimen touches it; turn the file, or "
            "enlarge mechanics.pad.facing_deg"
        )
    lengths = elastomer.length_x_mm, elastomer.length_y_mm
    # Slightly inside the rim: a file in single precision has lengths to 1e-7.
    share = np.linspace(-1.0, 1.0, 2 * _COVER_STEPS + 1)
    x, y = (share * (length / 2) * (1 - 1e-6) for length in lengths)
    is_covered = np.isfinite(upper_side(np.asarray(body.triangles[chosen]), x, y))
    if is_covered.all():
        return
    reach = np.maximum(*np.abs(np.meshgrid(share, share)))
    allowed = max(float(reach[~is_covered].min()) - 1 / _COVER_STEPS, 0.0)
    raise PressError(
        f"elastomer.length_x_mm, length_y_mm: found {lengths[0]:g} x {lengths[1]:g} mm, which "
        f"reaches beyond the coated face of mechanics.pad; allowed for this shape about "
        f"{allowed * lengths[0]:.3g} x {allowed * lengths[1]:.3g} mm: lower both"
    )


def rest_mm(pad: Pad, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """Return z (row, col), mm, of a pad's undeformed coated face.

    Parameters
    ----------
    x_mm, y_mm : (col,) and (row,) float, mm
    """
    inside = 1 - 1e-7  # nodes on the rim
    smooth = smooth_face(pad)
    if smooth is not None:
        return np.asarray(smooth(*np.meshgrid(inside * x_mm, inside * y_mm)))
    facets = np.asarray(pad.body.triangles[_coated_facets(pad)])
    return upper_side(facets, inside * x_mm, inside * y_mm)


def smooth_face(pad: Pad) -> CloughTocher2DInterpolator | None:
    """Return z over (x, y), mm, of a curved coated face with continuous slopes; None if creased.

    It is interpolated between the vertices of the facets, which are on the designed surface. The
    facets are inside a dome by up to edge^2 / (8 radius).
    """
    chosen = _coated_facets(pad)
    within = chosen[pad.body.face_adjacency].all(axis=1)
    if np.rad2deg(pad.body.face_adjacency_angles[within].max(initial=0.0)) > _CREASE_DEG:
        return None
    vertices = np.asarray(pad.body.vertices[np.unique(pad.body.faces[chosen])])
    return CloughTocher2DInterpolator(vertices[:, :2], vertices[:, 2])


def _coated_facets(pad: Pad) -> BoolArray:
    return pad.coated(pad.body.triangles_center, pad.body.face_normals)


def slab_pad(
    span_mm: tuple[float, float],
    thickness_mm: float,
    poisson_ratio: float,
    support: SlabSupport,
    ledge_mm: float = 0.0,
) -> Pad:
    """Return a rectangular slab as a pad; its coated face is z = 0.

    Parameters
    ----------
    span_mm : (float, float), mm; free lengths along x and y
    poisson_ratio : 0 < nu < 0.5
    support : "simple", "clamped" and "ledge" are for a specimen that touches z = -thickness.
        "simple": the rim has no deflection and no displacement along itself (as the spectral slab);
        "clamped": the rim has no displacement; "ledge": a frame of the coated face beyond the free
        span has no displacement. "bonded" and "window" are for a specimen that touches z = 0, with
        the face z = thickness fixed. "bonded": the sides are free; "window": the sides have no
        displacement normal to them (as one period of the spectral layer).
    ledge_mm : width of the frame of a ledge on each side

    Raises
    ------
    PressError : the support is a ledge with a width of 0
    """
    if support == "ledge" and ledge_mm <= 0:
        raise PressError(f"pad: a window ledge needs a width, found {ledge_mm:g} mm")
    margin = 2 * ledge_mm if support == "ledge" else 0.0
    length_x, length_y = span_mm[0] + margin, span_mm[1] + margin
    on_window = support in ("bonded", "window")
    body = _box(length_x, length_y, thickness_mm, raised=on_window)
    coated, touched = on_plane("z", 0.0), on_plane("z", 0.0 if on_window else -thickness_mm)
    across_x, across_y = _RIM[support]
    holds = tuple(Hold(on_plane("x", sign * length_x / 2), across_x) for sign in (-1, 1))
    holds += tuple(Hold(on_plane("y", sign * length_y / 2), across_y) for sign in (-1, 1))
    if on_window:
        holds += (Hold(on_plane("z", thickness_mm)),)
    if support == "ledge":
        holds = (Hold(both(coated, outside_of(*span_mm))),)
        # A second box of the free span inside the body: its edge is then a line of the mesh.
        body = trimesh.util.concatenate([body, _box(*span_mm, thickness_mm, raised=False)])
    return Pad(body, poisson_ratio, holds, touched, coated)


def _box(length_x: float, length_y: float, thickness: float, *, raised: bool) -> trimesh.Trimesh:
    box = trimesh.creation.box((length_x, length_y, thickness))
    box.apply_translation((0, 0, thickness / 2 if raised else -thickness / 2))
    return box


def mesh_pad(
    shape: Shape,
    pad: Pad,
    depth_mm: float,
    *,
    count: int = DEFAULT_COUNT,
    timeout_s: float = 60.0,
) -> Tetrahedra:
    """Return about `count` tetrahedra that fill a pad, for a press of about `depth_mm`.

    They are smallest where the specimen will probably touch.

    Raises
    ------
    PressError : the pad is not closed, or the specimen is outside it
    SolverError : pytetwild failed
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
    return tetrahedralize(pad.body, sizing(high), timeout_s=timeout_s)


def _spread(body: trimesh.Trimesh, where: Selector) -> FloatArray:
    """Return points (n, xyz), mm, on the selected facets, at distances of up to 0.25 mm.

    If no facet is selected, the points are on the whole surface.
    """
    chosen = where(body.triangles_center, body.face_normals)
    if not chosen.any():
        chosen = np.ones(len(body.faces), dtype=bool)
    vertices, _ = trimesh.remesh.subdivide_to_size(
        body.vertices, body.faces[chosen], max_edge=_SPACING_MM, max_iter=20
    )
    return np.asarray(vertices, dtype=np.float64)


def _zone(shape: Shape, touched: FloatArray, depth_mm: float) -> FloatArray:
    """Return the points (n, xyz) of the touched face that the specimen will probably touch."""
    low, high = touched.min(axis=0), touched.max(axis=0)
    reach = 2 * np.maximum(np.abs(low), np.abs(high))
    gap = touched[:, 2] + sample(shape, *reach[:2]).value(touched[:, 0], touched[:, 1])
    # The foremost facets may be missed by the points: take at least the nearest few.
    limit = max(gap.min() + _REACH * depth_mm, np.sort(gap)[min(8, gap.size - 1)])
    return np.asarray(touched[np.isfinite(gap) & (gap <= limit)])


def _near_in_plan(points: FloatArray, zone: FloatArray) -> FloatArray:
    """Return whether each point (n,) is, in plan, within 1.5 radii of the zone from its middle."""
    middle = zone[:, :2].mean(axis=0)
    reach = 1.5 * np.linalg.norm(zone[:, :2] - middle, axis=1).max(initial=_SPACING_MM)
    return np.asarray(np.linalg.norm(points[:, :2] - middle, axis=1) <= reach)
