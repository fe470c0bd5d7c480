"""Frictionless contact of a rigid height field with an elastic layer.

Polonsky, I. A., Keer, L. M. (1999): A numerical method for solving rough contact problems based
on the multi-level multi-summation and conjugate gradient techniques. Wear 231(2), 206-219.

Find p >= 0 and g >= 0 with p g = 0, where the gap is g = A p + S - d: deflection plus the
specimen's height behind its foremost point minus the depth. Arrays are (row, col).

On a layer it is solved on two grids: a coarse grid locates the contact, a patch of the fine grid
gives the pressure. The coarse solution takes a few milliseconds. It bounds the patch that the fine
solution needs, also if the force is given and the depth is not, and it starts that solution close
to its contact: from a poor guess a bending slab rebounds, and the contact opens and closes in turn.
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


# Largest gap of a touching cell over the largest deflection: faint pressures have no effect on sums
_CLOSED = 3e-5
# Number of earlier passes with energies that limit the energy of the next.
_REMEMBERED = 10
COARSENING = 4
_COARSE_TOLERANCE = 1e-3
# Least number of cells per side of a coarse grid that resolves a contact.
_FEWEST_CELLS = 64
# The coarse contact may miss a cell at its edge: it is grown by one of its own cells.
_GROWN = 2 * COARSENING + 1
# Largest overlap outside the patch, over the depth.
_GAP_TOLERANCE = 1e-4
_MOST_PATCHES = 20
# Pressure of cells that are only suspected to touch, over the highest.
_FAINT = 1e-6
_ADVICE = "use a thicker slab, a shorter span or a coarser press.solver_pitch_mm"


@dataclass(frozen=True)
class Unscaled:
    """Plain conjugate gradients."""

    cell: float = 1.0

    def apply(self, gap: FloatArray) -> FloatArray:
        """Return the gap itself."""
        return gap


@dataclass(frozen=True)
class Contact:
    """A solved contact; arrays (row, col)."""

    #: pressure over Young's modulus
    pressure: FloatArray
    #: deflection of the touched face, mm, positive along the press
    deflection_mm: FloatArray
    depth_mm: float
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
    """Solve the contact by Polonsky and Keer's conjugate gradients.

    Parameters
    ----------
    deflect : pressure over modulus (row, col) to deflection of the touched face (row, col), mm
    height_mm : (row, col) float, mm; the specimen's height behind its foremost point, inf where
        absent
    tolerance : largest relative change of the pressure per pass, as its sum of absolute values
    max_iterations : passes before the solver gives up
    scaling : approximate inverse of `deflect`; the passes then hardly grow with the grid
    start : (row, col) float; first guess of the pressure over modulus

    Raises
    ------
    SolverError : the passes were used up
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
    """Result of one whole pass."""

    pressure: FloatArray
    deflection: FloatArray
    #: the same cells touch as before the pass
    unchanged: bool
    #: cells without pressure overlapped
    joined: bool


def _pass(
    search: "_Search",
    pressure: FloatArray,
    deflection: FloatArray,
    gap: FloatArray,
    present: BoolArray,
) -> _Passed:
    """Step along the next direction, add overlapping cells to the contact, apply the control."""
    touching = pressure > 0
    direction, image, step = search.step(gap, touching)
    # A single cell under a given force has no step; its neighbours join nevertheless.
    advanced, overlapping = _advance(
        pressure - step * direction, gap, present, (step or 1.0) * search.scaling.cell
    )
    factor = search.control.scale(advanced)
    advanced *= factor
    # An unchanged contact moves the deflection along the known image: no transform.
    joined = bool(overlapping.any())
    unchanged = not joined and np.array_equal(advanced > 0, touching)
    after = factor * (deflection - step * image) if unchanged else search.deflect(advanced)
    return _Passed(advanced, after, unchanged, joined)


def _advance(
    moved: FloatArray, gap: FloatArray, present: BoolArray, stiffness: float
) -> tuple[FloatArray, BoolArray]:
    """Return the next pressure and the cells that join: without pressure and overlapping."""
    advanced = np.maximum(moved, 0.0)
    overlapping = (advanced == 0) & (gap < 0) & present
    return np.where(overlapping, -stiffness * gap, advanced), overlapping


class _Brake:
    """Shorten a pass that raises the energy above that of the last passes.

    Cells that join the contact get pressure as if each were loaded separately. On a bending slab
    that opens the whole contact, and without a limit it opens and closes for hundreds of passes. A
    non-monotone line search, in which the energy may rise now and then, does not change ordinary
    passes: Grippo, Lampariello, Lucidi (1986), SIAM J. Numer. Anal. 23, 707.
    """

    def __init__(self) -> None:
        self._energies: deque[float] = deque(maxlen=_REMEMBERED)

    def share(self, energy: float, slope: float, curvature: float) -> float:
        """Return the share of a pass that is taken.

        Parameters
        ----------
        energy : before the pass
        slope, curvature : of the energy along the whole pass
        """
        self._energies.append(energy)
        first = len(self._energies) == 1
        if first or slope >= 0 or energy + slope + curvature / 2 <= max(self._energies):
            return 1.0
        return -slope / curvature


class _Search:
    """Directions and step lengths of the conjugate gradients within the contact."""

    def __init__(self, deflect: Deflect, control: Control, scaling: Scaling) -> None:
        self.deflect, self.control, self.scaling = deflect, control, scaling
        self.direction: FloatArray | None = None
        self.gap: FloatArray = np.zeros((0, 0))
        self.norm = 0.0

    def restart(self) -> None:
        """Discard the last direction."""
        self.direction = None

    def step(self, gap: FloatArray, touching: BoolArray) -> tuple[FloatArray, FloatArray, float]:
        """Return direction, its image and the step length; steepest descent if that fails."""
        inside = np.where(touching, gap, 0.0)
        scaled = self._scaled(inside, touching)
        turned = scaled
        if self.direction is not None and self.norm > 0:
            # Polak and Ribiere: resets itself when cells leave the contact.
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
    """The responses of a layer that the solver needs."""

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
    layer : best with numbers of cells that are multiples of 16
    height_mm : (row, col) float, mm; the specimen's height behind its foremost point, inf where
        absent
    tolerance : largest relative change of the pressure per pass

    Raises
    ------
    SolverError : no solution within the passes, or the contact outgrows every patch
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
    """Solve on cells four times as wide; None where such cells do not resolve the contact."""
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
    """Return the height at the middle of each coarse cell, the mean of four fine cells."""
    rows, cols = (count // COARSENING for count in height_mm.shape)
    blocks = height_mm.reshape(rows, COARSENING, cols, COARSENING)
    middle = slice(COARSENING // 2 - 1, COARSENING // 2 + 1)
    return np.asarray(blocks[:, middle, :, middle].mean(axis=(1, 3)))
