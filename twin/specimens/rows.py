"""Rows of parts next to each other along x, on a plate; lengths in mm."""

from itertools import pairwise

from twin.config.specimen_base import require_at_most
from twin.specimens.meshes import MeshShape, block


def row_width_mm(widths_mm: tuple[float, ...], gap_mm: float) -> float:
    """Return the width of a row of parts with a clearance between neighbours."""
    return sum(widths_mm) + gap_mm * (len(widths_mm) - 1)


def middles_mm(widths_mm: tuple[float, ...], gap_mm: float) -> tuple[float, ...]:
    """Return the x positions of the middles of the parts of a centred row."""
    places = [widths_mm[0] / 2]
    for left, right in pairwise(widths_mm):
        places.append(places[-1] + left / 2 + gap_mm + right / 2)
    half_width = (places[-1] + widths_mm[-1] / 2) / 2
    return tuple(place - half_width for place in places)


def plate_under(
    outline_mm: tuple[float, float], thickness_mm: float, margin_mm: float, edge_radius_mm: float
) -> MeshShape:
    """Return the plate under a row; its upper face is z = 0.

    Its edges are rounded, because no cut edge is perfectly sharp, and a thin sheet would touch a
    sharp edge only at points.

    Parameters
    ----------
    outline_mm : width (x) and length (y) of the row
    margin_mm : width of the plate beyond the row on each side
    edge_radius_mm : radius of the row's edges; the plate's radius is at most thickness / 4
    """
    x, y = (side / 2 + margin_mm for side in outline_mm)
    return block((-x, -y, -thickness_mm), (x, y, 0.0), min(edge_radius_mm, thickness_mm / 4))


def require_edge(edge_radius_mm: float, sides_mm: tuple[float, ...]) -> None:
    """Raise ValueError if an edge's radius exceeds 0.25 x the thinnest side."""
    thinnest = min(sides_mm)
    require_at_most("edge_radius_mm", edge_radius_mm, thinnest / 4, f"0.25 x {thinnest:g}")
