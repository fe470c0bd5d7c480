"""Frictionless contact of a rigid height field with an elastic layer.

Polonsky, I. A., Keer, L. M. (1999): A numerical method for solving rough contact problems based
on the multi-level multi-summation and conjugate gradient techniques. Wear 231(2), 206-219.

Find p >= 0 and g >= 0 with p g = 0, where the gap is g = A p + S - d. Here p is the pressure over
Young's modulus, A p the deflection of the touched face, S the height of the specimen behind its
foremost point and d the depth (lengths in mm). Arrays are (row, col).

For a layer the problem is solved on two grids: a coarse grid locates the contact, then a patch of
the fine grid gives the pressure. The coarse solution takes a few milliseconds. It bounds the patch,
also if the force is given and the depth is not known. It also gives the fine solution a first guess
close to its contact: from a poor guess the contact on a bending slab opens and closes alternately.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from scipy.ndimage import maximum_filter

from reconstruction.arrays import BoolArray, FloatArray
from twin.mechanics.control import Control, Scaling, inner
from twin.mechanics.errors import SolverError
from twin.mechanics.patch import Patch, Span

Deflect = Callable[[FloatArray], FloatArray]


# Largest allowed gap of a touching cell over the largest deflection. The criterion on the sum of
# pressures does not detect errors of cells with a small pressure.
_CLOSED = 3e-5
# Number of previous passes; their largest energy limits the energy of the next pass.
_REMEMBERED = 10
COARSENING = 4
_COARSE_TOLERANCE = 1e-3
# Least number of cells per side of a coarse grid that resolves a contact.
_FEWEST_CELLS = 64
# Fine cells of the filter that enlarges the coarse contact by one coarse cell on each side: the
# coarse solution may miss a cell at the contact's edge.
_GROWN = 2 * COARSENING + 1
# Largest allowed overlap of specimen and layer outside the patch, over the depth.
_GAP_TOLERANCE = 1e-4
_MOST_PATCHES = 20
# First guess of the pressure of cells that may touch, over the highest pressure.
_FAINT = 1e-6
_ADVICE = "use a thicker slab, a shorter span or a coarser press.solver_pitch_mm"


@dataclass(frozen=True)
class Unscaled:
    """Preconditioner that changes nothing: plain conjugate gradients."""

    cell: float = 1.0

    def apply(self, gap: FloatArray) -> FloatArray:
        """Return `gap` unchanged."""
        return gap


@dataclass(frozen=True)
class Contact:
    """Solution of a contact problem; arrays are (row, col) on the solver's cells."""

    #: pressure over Young's modulus, 0 outside the contact
    pressure: FloatArray
    #: deflection of the touched face, mm, positive along the press
    deflection_mm: FloatArray
    #: travel of the specimen after first touch
    depth_mm: float
    #: number of passes of the solver
    iterations: int


def solve_contact(
    deflect: Deflect,
    height_mm: FloatArray,
    control: Control,
    tolerance: float = 1e-5,
    max_iterations: int = 1000,
    *,
    scaling: Scaling | None = None,
    start: FloatArray | None = None,
) -> Contact:
    """Return the contact of a rigid height field, by Polonsky and Keer's conjugate gradients.

    Parameters
    ----------
    deflect : pressure over modulus (row, col) to deflection of the touched face (row, col), mm
    height_mm : (row, col) float, mm; the specimen's height behind its foremost point, inf where
        absent
    tolerance : largest sum of absolute changes of the pressure in the last pass, over its sum
    max_iterations : largest number of passes
    scaling : approximate inverse of `deflect`, by which the number of passes hardly increases with
        the number of cells; None: no preconditioner
    start : (row, col) float; first guess of pressure over modulus; None: that of `control`

    Raises
    ------
    SolverError : no solution within `max_iterations` passes
    """
    present = np.isfinite(height_mm)
    height = np.where(present, height_mm, 0.0)
    pressure = control.start(height, present) if start is None else start * control.scale(start)
    search, brake = _Search(deflect, control, scaling or Unscaled()), _Brake()
    deflection = deflect(pressure)
    for iteration in range(1, max_iterations + 1):
        touching = pressure > 0
        gap = control.gap(deflection + height, touching)
        closed = float(np.abs(gap[touching]).max(initial=0.0)) <= _CLOSED * float(deflection.max())
        passed = _pass(search, pressure, deflection, gap, present)
        advanced, after, share = passed.pressure, passed.deflection, 1.0
        if not passed.unchanged:
            energy = control.energy(pressure, deflection + height, height)
            moved = advanced - pressure
            share = brake.share(energy, inner(gap, moved), inner(after - deflection, moved))
        if share < 1.0:
            advanced = pressure + share * (advanced - pressure)
            after = deflection + share * (after - deflection)
        change = float(np.abs(advanced - pressure).sum())
        pressure, deflection = advanced, after
        if passed.joined or share < 1.0:
            search.restart()  # a grown contact ends the conjugacy of the directions
        elif closed and change < tolerance * float(pressure.sum()) and iteration >= 4:
            return _finish(deflect, height, pressure, control, iteration)
    raise SolverError(f"press: no contact solution within {max_iterations} passes; {_ADVICE}")


class _Passed(NamedTuple):
    """Result of one whole pass; arrays are (row, col)."""

    #: pressure over modulus, and deflection of the touched face, mm
    pressure: FloatArray
    deflection: FloatArray
    #: True if the same cells touch as before the pass
    unchanged: bool
    #: True if cells without pressure overlapped the specimen and were added to the contact
    joined: bool


def _pass(
    search: "_Search",
    pressure: FloatArray,
    deflection: FloatArray,
    gap: FloatArray,
    present: BoolArray,
) -> _Passed:
    """Make one pass of the solver.

    It steps along the next search direction, adds overlapping cells to the contact and scales the
    pressure to a prescribed force.
    """
    touching = pressure > 0
    direction, image, step = search.step(gap, touching)
    # The step of a single cell under a given force is 0; its neighbours are added nevertheless.
    advanced, overlapping = _advance(
        pressure - step * direction, gap, present, (step or 1.0) * search.scaling.cell
    )
    factor = search.control.scale(advanced)
    advanced *= factor
    # If the contact is unchanged, the deflection follows from the known image without a transform.
    joined = bool(overlapping.any())
    unchanged = not joined and np.array_equal(advanced > 0, touching)
    after = factor * (deflection - step * image) if unchanged else search.deflect(advanced)
    return _Passed(advanced, after, unchanged, joined)


def _advance(
    moved: FloatArray, gap: FloatArray, present: BoolArray, stiffness: float
) -> tuple[FloatArray, BoolArray]:
    """Return the next pressure over modulus, and the cells to add to the contact, (row, col).

    Added cells have no pressure and overlap the specimen (`gap` < 0).
    """
    advanced = np.maximum(moved, 0.0)
    overlapping = (advanced == 0) & (gap < 0) & present
    return np.where(overlapping, -stiffness * gap, advanced), overlapping


class _Brake:
    """Line search: shorten a pass that would increase the energy above that of the last passes.

    Cells that are added to the contact get a pressure as if each were loaded separately. On a
    bending slab this opens the whole contact; without a limit the contact then opens and closes for
    hundreds of passes. The line search is non-monotone: the energy may increase in some passes, so
    that ordinary passes are not changed (Grippo, Lampariello, Lucidi (1986), SIAM J. Numer. Anal.
    23, 707).
    """

    def __init__(self) -> None:
        self._energies: deque[float] = deque(maxlen=_REMEMBERED)

    def share(self, energy: float, slope: float, curvature: float) -> float:
        """Return the fraction of the pass to apply, 0 to 1.

        Parameters
        ----------
        energy : energy before the pass
        slope, curvature : first and second derivative of the energy by that fraction
        """
        self._energies.append(energy)
        first = len(self._energies) == 1
        if first or slope >= 0 or energy + slope + curvature / 2 <= max(self._energies):
            return 1.0
        return -slope / curvature


class _Search:
    """Search directions and step lengths of the conjugate gradients, on cells in contact."""

    def __init__(self, deflect: Deflect, control: Control, scaling: Scaling) -> None:
        self.deflect, self.control, self.scaling = deflect, control, scaling
        self.direction: FloatArray | None = None
        self.gap: FloatArray = np.zeros((0, 0))
        self.norm = 0.0

    def restart(self) -> None:
        """Discard the last direction: the next direction is that of steepest descent."""
        self.direction = None

    def step(self, gap: FloatArray, touching: BoolArray) -> tuple[FloatArray, FloatArray, float]:
        """Return the search direction (row, col), its deflection, mm, and the step length.

        The direction is the conjugate one, or that of steepest descent if the conjugate direction
        has no positive curvature.
        """
        inside = np.where(touching, gap, 0.0)
        scaled = self._scaled(inside, touching)
        turned = scaled
        if self.direction is not None and self.norm > 0:
            # Formula of Polak and Ribiere: it restarts the search when cells leave the contact.
            turn = inner(scaled, inside - self.gap) / self.norm
            turned = np.where(touching, scaled + max(turn, 0.0) * self.direction, 0.0)
        self.gap, self.norm = inside, inner(scaled, inside)
        for direction in (turned, scaled):
            image = self.deflect(direction)
            curvature = inner(image, direction)
            if curvature > 0:
                break
        self.direction = direction
        descent = inner(inside, direction)
        return direction, image, descent / curvature if curvature > 0 else 0.0

    def _scaled(self, inside: FloatArray, touching: BoolArray) -> FloatArray:
        scaled = np.where(touching, self.scaling.apply(inside), 0.0)
        return self.control.balanced(scaled, touching, self.scaling)


def _finish(
    deflect: Deflect, height: FloatArray, pressure: FloatArray, control: Control, iterations: int
) -> Contact:
    deflection = deflect(pressure)
    depth = control.depth_mm(deflection + height, pressure > 0)
    return Contact(pressure, deflection, depth, iterations)


class Pressable(Protocol):
    """An elastic layer that `solve_on_layer` can press."""

    def deflect(self, pressure: FloatArray) -> FloatArray:
        """Return the touched face's deflection (row, col), mm, for pressure over modulus."""
        ...

    def patch(self, rows: Span, cols: Span) -> Patch:
        """Return the response of a rectangle of cells to pressure on these cells."""
        ...

    def coarsened(self, factor: int) -> "Pressable":
        """Return the same layer on cells `factor` times as wide."""
        ...


def solve_on_layer(
    layer: Pressable, height_mm: FloatArray, control: Control, tolerance: float = 1e-5
) -> Contact:
    """Return the contact of a rigid height field with an elastic layer.

    Parameters
    ----------
    layer : the layer; rows and columns in multiples of 16 are solved fastest
    height_mm : (row, col) float, mm; the specimen's height behind its foremost point, inf where
        absent
    tolerance : largest relative change of the pressure in the last pass, see `solve_contact`

    Raises
    ------
    SolverError : no solution within the passes, or the contact is larger than each patch
    """
    guess, passes = _guess(layer, height_mm, control), 0
    for _ in range(_MOST_PATCHES):
        patch = layer.patch(*map(Span.around, np.nonzero(guess > 0), guess.shape))
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
    """Return a first guess of pressure over modulus (row, col).

    It is the enlarged contact of the coarse grid, or without one the guess of `control`.
    """
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
    """Return pressure over modulus on cells four times as wide.

    Returns
    -------
    (coarse row, coarse col) float; None if such cells do not resolve the contact
    """
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
    """Return the height, mm, at the middle of each coarse cell: the mean of the four fine cells."""
    rows, cols = (count // COARSENING for count in height_mm.shape)
    blocks = height_mm.reshape(rows, COARSENING, cols, COARSENING)
    middle = slice(COARSENING // 2 - 1, COARSENING // 2 + 1)
    return np.asarray(blocks[:, middle, :, middle].mean(axis=(1, 3)))
