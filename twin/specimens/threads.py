"""Metric screw threads as closed helical bodies.

Basic profile of ISO 68-1: flanks at 60 degrees to each other, flat crests of pitch / 8 on the
major diameter D, flat roots of pitch / 4 on the minor diameter D - (5/4) H, H = (sqrt(3)/2) pitch.
The body is a bolt's shank, or is cut out as a nut's hole.
"""

from math import sqrt
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from reconstruction.arrays import IntArray
from twin.specimens.solids import SECTIONS, closed_mesh

if TYPE_CHECKING:
    import trimesh

Thread = Annotated[float, Field(ge=1, le=30)]
Pitch = Annotated[float, Field(ge=0.2, le=4)]
MOST_TURNS = 60
"""Largest number of turns: the facets of more turns are smaller than any camera resolves."""

# Axial positions of the profile's four corners over the pitch, starting with the root's flat.
_KINKS = np.array([0.0, 4.0, 9.0, 11.0]) / 16


def minor_diameter_mm(major_mm: float, pitch_mm: float) -> float:
    """Return the minor diameter of a thread, D - (5/4) H (ISO 68-1), mm."""
    return major_mm - 1.25 * sqrt(3) / 2 * pitch_mm


def screw(
    major_mm: float, pitch_mm: float, low_mm: float, high_mm: float, sections: int = SECTIONS
) -> "trimesh.Trimesh":
    """Return a right-handed threaded rod about z that extends beyond `low_mm` and `high_mm`.

    Parameters
    ----------
    low_mm, high_mm : z between which the thread is complete; the caller cuts off the ends beyond
    sections : number of facets round one turn

    Notes
    -----
    The surface is a grid over the angle and the corners of the profile. The grid is sheared, so
    that its lines follow the helix: after one turn a line is one pitch higher. Both ends are closed
    by triangles to a point on the axis. They cannot intersect the flanks, because the grid ends on
    the root.
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
    return closed_mesh(np.concatenate((grid, ends)), faces)


def _sides(rows: int, sections: int) -> IntArray:
    """Return the facets (n, 3) between neighbouring lines of the helix."""
    index = np.arange(rows * sections).reshape(rows, sections)
    # The last column is followed by the first, one pitch (four corners of the profile) higher.
    beyond = np.concatenate((index[4:, 0], np.full(4, -1)))
    index = np.concatenate((index, beyond[:, None]), axis=1)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    whole = (b >= 0) & (c >= 0)
    corners = np.stack((a, b, c, a, c, d), axis=-1)[whole]
    return corners.reshape(-1, 3)


def _ends(rows: int, sections: int) -> IntArray:
    """Return the facets (n, 3) that close the lower and the upper end."""
    index = np.arange(rows * sections).reshape(rows, sections)
    lower = np.concatenate((index[0], index[4:0:-1, 0]))
    upper = np.concatenate((index[-1], index[-2:-5:-1, -1], index[-5:-4, -1]))
    centre = rows * sections
    down = _fan(lower[::-1], centre)
    return np.concatenate((down, _fan(upper, centre + 1)))


def _fan(loop: IntArray, centre: int) -> IntArray:
    return np.stack((loop, np.roll(loop, -1), np.full_like(loop, centre)), axis=-1)
