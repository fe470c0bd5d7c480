"""Rows of parts side by side along x, on a plate."""

from itertools import pairwise

from twin.config.specimen_base import require_at_most
from twin.specimens.meshes import MeshShape, block


def row_width_mm(widths_mm: tuple[float, ...], gap_mm: float) -> float:
    """Return the width of a row of parts with a clearance between neighbours."""
    return sum(widths_mm) + gap_mm * (len(widths_mm) - 1)


def middles_mm(widths_mm: tuple[float, ...], gap_mm: float) -> tuple[float, ...]:
    """Return the x positions of the parts of a centred row."""
    places = [widths_mm[0] / 2]
    for left, right in pairwise(widths_mm):
        places.append(places[-1] + left / 2 + gap_mm + right / 2)
    half_width = (places[-1] + widths_mm[-1] / 2) / 2
    return tuple(place - half_width for place in places)


def plate_under(
    outline_mm: tuple[float, float], thickness_mm: float, margin_mm: float, edge_radius_mm: float
) -> MeshShape:
    """Return the plate under a row, its upper face z = 0, its edges rounded as those of the row.

    No cut edge is perfectly sharp; on a sharp edge the contact of a thin sheet would be pointwise.

    Parameters
    ----------
    outline_mm : width (x) and length (y) of the row
    margin_mm : plate beyond the row
    """
    x, y = (side / 2 + margin_mm for side in outline_mm)
    return block((-x, -y, -thickness_mm), (x, y, 0.0), min(edge_radius_mm, thickness_mm / 4))


def require_edge(edge_radius_mm: float, sides_mm: tuple[float, ...]) -> None:
    """Raise ValueError if an edge's radius exceeds 0.25 x the thinnest side."""
    thinnest = min(sides_mm)
    require_at_most("edge_radius_mm", edge_radius_mm, thinnest / 4, f"0.25 x {thinnest:g}")
