"""Contact on a layer in two steps: a coarse grid finds where, a patch of the fine grid how much.

The coarse solution costs a few milliseconds. It bounds the patch that the fine solution needs,
also when the force is given and the depth is not, and it starts that solution close to its
contact: from a far guess a bending slab rebounds and the contact is lost and regained in turn.
"""

from typing import Protocol

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter

from reconstruction.arrays import FloatArray
from twin.mechanics.contact import Contact, solve_contact
from twin.mechanics.control import BoolArray, Control
from twin.mechanics.errors import SolverError
from twin.mechanics.patch import Patch, Span

COARSENING = 4
_COARSE_TOLERANCE = 1e-3
# Coarser grids than this tell nothing about a contact.
_FEWEST_CELLS = 64
# The coarse contact may miss a cell at its edge: it is grown by one of its own cells.
_GROWN = 2 * COARSENING + 1
_MARGIN = 2
# Nothing outside the patch may overlap by more than this share of the depth.
_GAP_TOLERANCE = 1e-4
_MOST_PATCHES = 20
# Pressure of cells that are only suspected to touch, over the highest.
_FAINT = 1e-6


class Pressable(Protocol):
    """What the solver needs of a layer."""

    def deflect(self, pressure: FloatArray) -> FloatArray:
        """Return the touched face's deflection on the whole grid."""
        ...

    def patch(self, rows: Span, cols: Span) -> Patch:
        """Return the response within a patch."""
        ...

    def coarsened(self, factor: int) -> "Pressable":
        """Return the same layer on cells `factor` times as wide."""
        ...


def solve_on_layer(
    layer: Pressable, height_mm: FloatArray, control: Control, tolerance: float = 1e-5
) -> Contact:
    """Solve the contact of a rigid height field with a layer.

    Parameters
    ----------
    layer : FreeSlab or BondedLayer
        Best with numbers of cells that are multiples of 16.
    height_mm : (row, col) float, mm
        The specimen's height behind its foremost point, inf where absent.
    control : DepthControl or ForceControl
        What is prescribed.
    tolerance : float
        Largest relative change of the pressure per pass.

    Raises
    ------
    SolverError
        No solution was found.
    """
    guess, passes = _guess(layer, height_mm, control), 0
    for _ in range(_MOST_PATCHES):
        patch = layer.patch(*_spans(guess > 0))
        within, start = height_mm[patch.cells], guess[patch.cells]
        solved = solve_contact(
            patch.deflect, within, control, tolerance, scaling=patch, start=start
        )
        passes += solved.iterations
        pressure = np.zeros_like(height_mm)
        pressure[patch.cells] = solved.pressure
        deflection = layer.deflect(pressure)
        missed = deflection + height_mm - solved.depth_mm < -_GAP_TOLERANCE * solved.depth_mm
        missed[patch.cells] = False
        if not missed.any():
            return Contact(pressure, deflection, solved.depth_mm, passes)
        guess = np.where(missed, _FAINT * pressure.max(), pressure)
    raise SolverError("press: the contact keeps growing; use a coarser press.solver_pitch_mm")


def _guess(layer: Pressable, height_mm: FloatArray, control: Control) -> FloatArray:
    """Return a first pressure: the coarse contact, grown, or the control's own start."""
    present = np.isfinite(height_mm)
    first = control.start(np.where(present, height_mm, 0.0), present)
    coarse = _coarse_pressure(layer, height_mm, control)
    if coarse is None:
        return first
    fine = np.repeat(np.repeat(coarse, COARSENING, axis=0), COARSENING, axis=1)
    grown = maximum_filter(fine, _GROWN) > 0
    guess = np.where(present, np.maximum(fine, grown * _FAINT * fine.max()), 0.0)
    return guess if guess.any() else first


def _coarse_pressure(
    layer: Pressable, height_mm: FloatArray, control: Control
) -> FloatArray | None:
    """Solve on cells four times as wide; None where that tells nothing."""
    rows, cols = height_mm.shape
    if min(rows, cols) < _FEWEST_CELLS or rows % COARSENING or cols % COARSENING:
        return None
    height = _between_cells(height_mm)
    present = np.isfinite(height)
    wider = control.coarsened(COARSENING)
    if not present.any() or not wider.start(np.where(present, height, 0.0), present).any():
        return None
    try:
        return solve_on_layer(
            layer.coarsened(COARSENING), height, wider, _COARSE_TOLERANCE
        ).pressure
    except SolverError:
        return None


def _between_cells(height_mm: FloatArray) -> FloatArray:
    """Return the height at the middle of each coarse cell, which lies between four fine ones."""
    rows, cols = (count // COARSENING for count in height_mm.shape)
    blocks = height_mm.reshape(rows, COARSENING, cols, COARSENING)
    middle = slice(COARSENING // 2 - 1, COARSENING // 2 + 1)
    between: FloatArray = blocks[:, middle, :, middle].mean(axis=(1, 3))
    return between


def _spans(touching: BoolArray) -> tuple[Span, Span]:
    """Return the rows and columns that hold a contact, with a margin."""
    rows, cols = np.nonzero(touching)
    return _span(rows, touching.shape[0]), _span(cols, touching.shape[1])


def _span(cells: npt.NDArray[np.intp], count: int) -> Span:
    first = max(int(cells.min()) - _MARGIN, 0)
    return Span(first, min(int(cells.max()) + _MARGIN + 1, count) - first)
