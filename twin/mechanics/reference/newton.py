"""Load steps of a press: action of the contact on a body, and Newton's method for equilibrium.

Newton's method with contact is the inner iteration of an augmented Lagrangian. With large steps it
converges to wrong solutions that have pockets without contact near the axis (18 to 60 um deep for a
ball of 4 mm radius at a depth of 1 mm). Load steps are therefore short, and the displacement of a
node in a Newton step is limited.
"""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from twin.mechanics.errors import SolverError
from twin.mechanics.reference.grid import Surface
from twin.mechanics.reference.mixed import MixedBody, symmetric_lu

_LINEAR_RESIDUAL = 1e-6


@dataclass(frozen=True)
class Pushed:
    """Force, stiffness and pressure of a contact, each divided by Young's modulus."""

    #: (displacement unknown,) force on the body
    force: FloatArray
    #: (displacement unknown, displacement unknown) negative derivative of the force
    stiffness: sparse.csr_array
    #: (point,) pressure per undeformed area
    pressure: FloatArray
    #: sum of the forces along the press, the last axis
    along: float

    @property
    def active(self) -> BoolArray:
        """(point,) whether each point is in contact."""
        return np.asarray(self.pressure > 0)


def push(
    surface: Surface,
    traction: FloatArray,
    stiffness: FloatArray,
    pressure: FloatArray,
) -> Pushed:
    """Return the action of the contact on the nodes, from its action at the surface's points.

    Parameters
    ----------
    surface : points on the touched face
    traction : (point, axis) float; force over modulus per undeformed area
    stiffness : (point, axis, axis) float; negative derivative of the traction by the point's
        position, per mm
    pressure : (point,) float; normal part of the traction, over modulus
    """
    weight, wide = surface.weight_mm2, surface.vector_trace
    points = np.arange(weight.size + 1)
    blocks = sparse.bsr_array((stiffness * weight[:, None, None], points[:-1], points))
    return Pushed(
        force=wide.T @ (traction * weight[:, None]).ravel(),
        stiffness=sparse.csr_array(wide.T @ blocks.tocsr() @ wide),
        pressure=pressure,
        along=float(weight @ traction[:, -1]),
    )


class MovingContact(Protocol):
    """Interface of the contact with a rigid object that is pressed into the body."""

    @property
    def carried(self) -> FloatArray:
        """(point,) Lagrange multiplier: pressure over modulus at an overlap of 0."""
        ...

    def evaluate(self, moved_mm: FloatArray, depth_mm: float, active: BoolArray | None) -> Pushed:
        """Return force, stiffness and pressure of the contact on the deformed body.

        Parameters
        ----------
        moved_mm : displacement unknowns of the body
        depth_mm : travel of the object
        active : (point,) whether a point is in contact; None: if its pressure is positive
        """
        ...

    def settle(self, moved_mm: FloatArray, depth_mm: float) -> "MovingContact":
        """Return the contact after a finished load step.

        Raises
        ------
        StepFailedError : the solution converged, but its contact is rejected as wrong
        """
        ...

    def carry(self, pressure: FloatArray) -> "MovingContact":
        """Return the contact with the Lagrange multiplier `pressure` (point,)."""
        ...


@dataclass(frozen=True)
class NewtonOptions:
    """Parameters of Newton's method and of the load steps."""

    #: largest displacement of a node in a Newton step, mm
    largest_move_mm: float
    #: largest residual of a free unknown over the contact force
    tolerance: float = 1e-7
    max_iterations: int = 40
    #: number of iterations after which the contact set is kept constant
    patience: int = 12
    #: number of updates of the Lagrange multiplier that are each followed by a further solution
    augmentations: int = 2
    #: number of times that a failed load step is halved
    halvings: int = 5


@dataclass(frozen=True)
class Problem:
    """A body with its supports and the parameters of its solution."""

    body: MixedBody
    #: (n,) numbers of the unknowns that no support sets to zero
    free: IntArray
    options: NewtonOptions


@dataclass(frozen=True)
class Equilibrium:
    """A body in equilibrium with the object at one depth."""

    #: (unknown,) displacements, mm, and pressures over modulus
    state: FloatArray
    contact: MovingContact
    depth_mm: float
    pushed: Pushed
    iterations: int
    #: change of the state per mm of depth in the last load step, for the first guess of the next
    #: step; None before the first step
    rate: FloatArray | None = None


class StepFailedError(Exception):
    """Error for a load step without solution; a shorter step may have one."""


def press_to(problem: Problem, start: Equilibrium, depth_mm: float) -> Equilibrium:
    """Return the equilibrium at a depth, in one load step from `start` or in several.

    A load step that fails is halved.

    Raises
    ------
    SolverError : the shortest allowed step failed
    """
    at, step = start, depth_mm - start.depth_mm
    shortest = step / 2**problem.options.halvings
    while at.depth_mm < depth_mm:
        aim = min(at.depth_mm + step, depth_mm)
        try:
            at = _step(problem, at, aim)
        except StepFailedError as failure:
            step /= 2
            if step < shortest:
                raise SolverError(
                    f"neo-Hookean press: no equilibrium beyond {at.depth_mm:.4g} mm ({failure}); "
                    "press less, use a thicker slab or a finer grid"
                ) from None
    return at


def _step(problem: Problem, start: Equilibrium, depth_mm: float) -> Equilibrium:
    equilibrium = replace(start, depth_mm=depth_mm, state=_predicted(problem, start, depth_mm))
    for _ in range(problem.options.augmentations + 1):
        equilibrium = _solve(problem, equilibrium)
        pressure = equilibrium.pushed.pressure
        equilibrium = replace(equilibrium, contact=equilibrium.contact.carry(pressure))
    moved_mm = problem.body.displacement_mm(equilibrium.state)
    settled = equilibrium.contact.settle(moved_mm, depth_mm)
    rate = (equilibrium.state - start.state) / (depth_mm - start.depth_mm)
    return replace(equilibrium, contact=settled, rate=rate)


def _predicted(problem: Problem, start: Equilibrium, depth_mm: float) -> FloatArray:
    """Return the first guess of the state at a depth: the last step's motion is continued.

    A free sheet moves as a whole under a small contact. The start itself is returned before the
    first step, or if the continued motion inverts an element.
    """
    if start.rate is None:
        return start.state
    ahead = start.state + start.rate * (depth_mm - start.depth_mm)
    return ahead if problem.body.is_admissible(ahead) else start.state


def _solve(problem: Problem, start: Equilibrium) -> Equilibrium:
    """Return the equilibrium at the depth and with the Lagrange multiplier of `start`."""
    options, frozen, at = problem.options, None, start
    for iteration in range(options.max_iterations):
        residual, tangent, pushed = _residual(problem.body, at, frozen)
        size = float(np.abs(residual[problem.free]).max())
        at = replace(at, pushed=pushed, iterations=start.iterations + iteration)
        if size < options.tolerance * max(pushed.along, 1e-6) and iteration > 0:
            return at
        if iteration == options.patience:
            frozen = pushed.active
        at = replace(at, state=at.state + _move(problem, tangent, residual))
        if not np.isfinite(at.state).all() or not problem.body.is_admissible(at.state):
            raise StepFailedError("an element turned inside out")
    raise StepFailedError(f"residual {size:.1e} after {options.max_iterations} iterations")


def _residual(
    body: MixedBody, at: Equilibrium, frozen: BoolArray | None
) -> tuple[FloatArray, sparse.csc_array, Pushed]:
    residual, tangent = body.assemble(at.state)
    pushed = at.contact.evaluate(body.displacement_mm(at.state), at.depth_mm, frozen)
    residual[: body.displacements] -= pushed.force
    wide = pushed.stiffness.tocoo()
    grown = sparse.csc_array((wide.data, (wide.row, wide.col)), shape=tangent.shape)
    return residual, sparse.csc_array(tangent + grown), pushed


def _move(problem: Problem, tangent: sparse.csc_array, residual: FloatArray) -> FloatArray:
    """Return a Newton step (unknown,), shortened to the largest allowed displacement."""
    move, free = np.zeros_like(residual), problem.free
    try:
        move[free] = -_solve_linear(sparse.csc_array(tangent[free][:, free]), residual[free])
    except RuntimeError as failure:
        raise StepFailedError("singular tangent") from failure
    largest = float(np.abs(move[: problem.body.displacements]).max())
    return move * min(1.0, problem.options.largest_move_mm / largest) if largest > 0 else move


def _solve_linear(matrix: sparse.csc_array, right: FloatArray) -> FloatArray:
    """Return the solution of `matrix` x = `right`, with a check of its residual."""
    solution: FloatArray = symmetric_lu(matrix).solve(right)
    if np.abs(matrix @ solution - right).max() > _LINEAR_RESIDUAL * np.abs(right).max():
        # Without pivoting the solution with an indefinite tangent can be inaccurate.
        solution = splu(matrix).solve(right)
    return solution
