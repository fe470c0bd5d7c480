"""An elastic pad of any shape: its surface, what holds it, what is touched and what is coated.

World frame, mm: the specimen comes from below and presses along +z. Facets are chosen by
selectors, which see the facets' centres and outward normals.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import trimesh

from reconstruction.arrays import FloatArray
from twin.mechanics.control import BoolArray
from twin.mechanics.errors import PressError

#: centres (facet, xyz) mm and outward unit normals (facet, xyz) to a choice (facet,)
Selector = Callable[[FloatArray, FloatArray], BoolArray]
SlabSupport = Literal["simple", "clamped", "ledge", "bonded", "window"]

_ON_PLANE_MM = 1e-6
# Directions that the sides across x and across y are held in.
_RIM: dict[SlabSupport, tuple[str, str]] = {
    "simple": ("yz", "xz"),
    "clamped": ("xyz", "xyz"),
    "ledge": ("", ""),
    "bonded": ("", ""),
    "window": ("x", "y"),
}


@dataclass(frozen=True)
class Hold:
    """Facets whose displacement is held to zero in some directions."""

    where: Selector
    #: of "xyz"
    directions: str = "xyz"


@dataclass(frozen=True)
class Pad:
    """An elastic body; lengths in mm, world frame."""

    #: closed surface; internal surfaces are kept as mesh faces
    body: trimesh.Trimesh
    poisson_ratio: float
    holds: tuple[Hold, ...]
    touched: Selector
    coated: Selector


def facing(direction: tuple[float, float, float], within_deg: float = 60.0) -> Selector:
    """Choose facets whose normal leans from `direction` by less than `within_deg`."""
    axis = np.asarray(direction) / np.linalg.norm(direction)
    least = np.cos(np.deg2rad(within_deg))
    return lambda centres, normals: np.asarray(normals @ axis > least)


def on_plane(axis: Literal["x", "y", "z"], value_mm: float) -> Selector:
    """Choose facets on a plane across a coordinate axis."""
    column = "xyz".index(axis)
    return lambda centres, normals: np.asarray(
        (np.abs(centres[:, column] - value_mm) < _ON_PLANE_MM)
        & (np.abs(normals[:, column]) > 1 - _ON_PLANE_MM)
    )


def both(first: Selector, second: Selector) -> Selector:
    """Choose the facets that two selectors agree on."""
    return lambda centres, normals: first(centres, normals) & second(centres, normals)


def outside_of(length_x_mm: float, length_y_mm: float) -> Selector:
    """Choose facets beyond a centred rectangle in plan."""
    return lambda centres, normals: np.asarray(
        (np.abs(centres[:, 0]) > length_x_mm / 2) | (np.abs(centres[:, 1]) > length_y_mm / 2)
    )


def slab_pad(
    span_mm: tuple[float, float],
    thickness_mm: float,
    poisson_ratio: float,
    support: SlabSupport,
    ledge_mm: float = 0.0,
) -> Pad:
    """Describe a rectangular slab; the coated face is z = 0.

    Parameters
    ----------
    span_mm : (float, float), mm
        Free lengths along x and y.
    thickness_mm : float, mm
        Thickness.
    poisson_ratio : float
        0 < nu < 0.5.
    support : {"simple", "clamped", "ledge", "bonded", "window"}
        Touched at z = -thickness: rim without deflection, tangential displacement along it and
        normal stress (as the spectral slab); rim held; a frame of the coated face beyond the free
        span held, as by a window's edge. Touched at z = 0 and held at z = thickness: sides free;
        sides on rollers (as one period of the spectral layer).
    ledge_mm : float, mm
        Width of that frame on each side.

    Raises
    ------
    PressError
        A ledge without width.
    """
    if support == "ledge" and ledge_mm <= 0:
        raise PressError(f"pad: a window ledge needs a width, found {ledge_mm:g} mm")
    margin = 2 * ledge_mm if support == "ledge" else 0.0
    length_x, length_y = span_mm[0] + margin, span_mm[1] + margin
    on_window = support in ("bonded", "window")
    body = _box(length_x, length_y, thickness_mm, raised=on_window)
    coated, touched = on_plane("z", 0.0), on_plane("z", 0.0 if on_window else -thickness_mm)
    sides_x, sides_y = (
        tuple(Hold(on_plane(axis, sign * length / 2), held) for sign in (-1, 1))
        for axis, length, held in _sides(support, length_x, length_y)
    )
    holds = sides_x + sides_y
    if on_window:
        holds += (Hold(on_plane("z", thickness_mm)),)
    if support == "ledge":
        holds = (Hold(both(coated, outside_of(*span_mm))),)
        # The free span as a body of its own within: the mesh then has its edge as a line.
        body = trimesh.util.concatenate([body, _box(*span_mm, thickness_mm, raised=False)])
    return Pad(body, poisson_ratio, holds, touched, coated)


def _sides(
    support: SlabSupport, length_x: float, length_y: float
) -> tuple[tuple[Literal["x", "y"], float, str], ...]:
    across_x, across_y = _RIM[support]
    return ("x", length_x, across_x), ("y", length_y, across_y)


def _box(length_x: float, length_y: float, thickness: float, *, raised: bool) -> trimesh.Trimesh:
    box = trimesh.creation.box((length_x, length_y, thickness))
    box.apply_translation((0, 0, thickness / 2 if raised else -thickness / 2))
    return box
