"""The touched face between the solver's cells.

Smooth where it is free, the specimen's own shape where it touches, and no ripples at the contact's
edge, where its curvature or slope jumps.
"""

import numpy as np
from scipy.interpolate import Akima1DInterpolator

from reconstruction.arrays import FloatArray

# Cells beyond the nodes that an interpolant of two neighbours on either side needs.
_BEYOND = 4


def touched_at_nodes(
    deflection_mm: FloatArray,
    cells_mm: tuple[FloatArray, FloatArray],
    nodes_mm: tuple[FloatArray, FloatArray],
    indented_mm: FloatArray,
) -> FloatArray:
    """Refine the touched face's deflection to nodes.

    Parameters
    ----------
    deflection_mm : (row, col) float, mm; at the cell centres, along the press
    cells_mm : ((row,), (col,)) float, mm; world y and x of the cell centres
    nodes_mm : ((node row,), (node col,)) float, mm; world y and x of the nodes, within the cells
    indented_mm : (node row, node col) float, mm; depth minus the specimen's height at the nodes,
        -inf where there is no specimen: no face lies lower

    Returns
    -------
    (node row, node col) float, mm; deflection at the nodes

    Notes
    -----
    Modified Akima interpolation, axis by axis: local, so that an edge disturbs two cells at most,
    where a cubic spline rings across the face.
    """
    refined = deflection_mm
    for axis, (cells, nodes) in enumerate(zip(cells_mm, nodes_mm, strict=True)):
        near = _around(cells, nodes)
        part = refined.take(np.arange(near.start, near.stop), axis=axis)
        refined = Akima1DInterpolator(cells[near], part, axis=axis, method="makima")(nodes)
    lifted: FloatArray = np.maximum(refined, indented_mm)
    return lifted


def wrapped(
    deflection_mm: FloatArray, cells_mm: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """Continue a periodic field beyond its window, so that nodes on the edge lie within cells."""
    wide = np.pad(deflection_mm, _BEYOND, mode="wrap")
    return wide, (widened(cells_mm[0]), widened(cells_mm[1]))


def widened(cells_mm: FloatArray) -> FloatArray:
    """Continue cell centres at both ends."""
    step = cells_mm[1] - cells_mm[0]
    centres: FloatArray = cells_mm[0] + step * np.arange(-_BEYOND, cells_mm.size + _BEYOND)
    return centres


def mirrored(deflection_mm: FloatArray) -> FloatArray:
    """Continue a field that is odd about the rim, half a cell beyond the outermost centres."""
    wide = np.pad(deflection_mm, _BEYOND, mode="symmetric")
    wide[:_BEYOND] *= -1
    wide[-_BEYOND:] *= -1
    wide[:, :_BEYOND] *= -1
    wide[:, -_BEYOND:] *= -1
    return wide


def _around(cells_mm: FloatArray, nodes_mm: FloatArray) -> slice:
    first, last = np.searchsorted(cells_mm, (nodes_mm[0], nodes_mm[-1]))
    return slice(max(int(first) - _BEYOND, 0), min(int(last) + _BEYOND, cells_mm.size))
