"""Frictionless contact at scattered points with a body that is solved for one load at a time.

A primal-dual active set (Hintermueller, M., Ito, K., Kunisch, K. (2002): The primal-dual active
set strategy as a semismooth Newton method. SIAM J. Optim. 13, 865-888), independent of the
spectral solver's conjugate gradients. Find forces q >= 0 and gaps g >= 0 with q g = 0, where
g = A q + S - d. On the active set the equations are solved by conjugate gradients, preconditioned
by the half-space's compliance between the points.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve

from reconstruction.arrays import BoolArray, FloatArray
from twin.mechanics.errors import PressError, SolverError

Deflect = Callable[[FloatArray], FloatArray]

_MAX_PASSES = 40
_MAX_ITERATIONS = 200
# Residual gap over the depth: while the contact set still moves, and at the end.
_ROUGH, _FINE = 1e-3, 1e-6
# (1 - nu^2) / pi at nu = 0.5
_HALF_SPACE = 0.75 / np.pi
_FIRST_POINTS = 12
# Passes without slack; then the force over the largest, and the gap over the depth, to neglect.
_PATIENCE, _SLACK = 12, 1e-4


@dataclass(frozen=True)
class PointContact:
    """A solved contact."""

    #: (point,) force over Young's modulus, mm^2
    force: FloatArray
    depth_mm: float
    #: number of loads for which the body was solved
    loads: int


@dataclass(frozen=True)
class ContactPoints:
    """Points where contact is possible."""

    #: (point, node) sparse: deflections of the face's nodes to those of the points
    trace: sparse.csr_array
    #: (node, xyz) of which only those in `trace` matter
    nodes_mm: FloatArray
    #: (point,) compliance of the foundation under a force over modulus, mm per mm^2
    yielding: FloatArray
    #: (point,) gap at first touch, inf where there is never contact
    gap_mm: FloatArray


def press_points(
    deflect: Deflect,
    points: ContactPoints,
    *,
    depth_mm: float | None = None,
    force_over_modulus_mm2: float | None = None,
) -> PointContact:
    """Press to a depth, or with a force (give one of the two).

    Parameters
    ----------
    deflect : forces over modulus (point,) to deflections along the press (point,), mm; symmetric

    Raises
    ------
    PressError : no point touches
    SolverError : the contact set did not converge
    """
    known = np.isfinite(points.gap_mm)
    gap = np.where(known, points.gap_mm, 0.0)
    # A ball touches where its gap is below about half the depth; a force starts with a few points.
    foremost = float(np.sort(gap[known])[:_FIRST_POINTS][-1])
    active = known & (gap <= max(0.5 * (depth_mm or 0.0), foremost))
    force = closing = lifting = np.zeros_like(gap)
    loads, tolerance = 0, _ROUGH
    for passes in range(1, _MAX_PASSES + 1):
        if not active.any():
            raise PressError(
                "press: the specimen touches no point of the elements; press deeper, or give more "
                "mechanics.tetrahedra"
            )
        solve = _ActiveSolve(deflect, points, active, tolerance)
        if depth_mm is not None:
            force, depth = solve.forces(depth_mm - gap, force), depth_mm
        else:
            closing = solve.forces(-gap, closing)
            lifting = solve.forces(np.ones_like(gap), lifting)
            depth = ((force_over_modulus_mm2 or 0.0) - float(closing.sum())) / float(lifting.sum())
            force = closing + depth * lifting
        loads += solve.loads + 1
        raised = deflect(force) + gap - depth
        # Late passes neglect small violations: otherwise two neighbours may alternate.
        slack = _SLACK if passes > _PATIENCE else 0.0
        touching = np.where(active, force > -slack * force.max(), (raised < -slack * depth) & known)
        settled = np.array_equal(touching, active)
        if settled and tolerance == _FINE:
            return PointContact(np.maximum(force, 0.0), depth, loads)
        if settled or passes >= _PATIENCE:
            tolerance = _FINE
        active = touching
    raise SolverError(
        f"press: the contact set did not settle within {_MAX_PASSES} passes; use a finer mesh"
    )


class _ActiveSolve:
    """Forces on a given contact set."""

    def __init__(
        self, deflect: Deflect, points: ContactPoints, active: BoolArray, tolerance: float
    ) -> None:
        self.deflect, self.active, self.tolerance, self.loads = deflect, active, tolerance, 0
        trace = sparse.csr_array(points.trace[active])
        nodes = np.unique(trace.indices)
        distance = np.linalg.norm(points.nodes_mm[nodes][:, None] - points.nodes_mm[nodes], axis=-1)
        # A node represents a disc that reaches half way to the next node, with the mean compliance
        # at half the disc's radius.
        nearest = np.where(distance > 0, distance, np.inf).min(axis=1)
        np.fill_diagonal(distance, nearest / 4)
        dense = trace[:, nodes].toarray()
        guess = dense @ (_HALF_SPACE / distance) @ dense.T + np.diag(points.yielding[active])
        # The body as a whole yields as well: one load determines by how much.
        even = np.full(guess.shape[0], 1 / guess.shape[0])
        whole = float(even @ (self._deflected(even) - guess @ even))
        self.factor = cho_factor(guess + max(whole, 0.0), lower=True)

    def forces(self, aim: FloatArray, start: FloatArray) -> FloatArray:
        """Return forces on the set that deflect its points by `aim` (point,), mm."""
        force = start[self.active]
        residual = aim[self.active] - self._deflected(force)
        goal = self.tolerance * float(np.abs(aim[self.active]).max())
        direction, before = np.zeros_like(force), 1.0
        for _ in range(_MAX_ITERATIONS):
            if float(np.abs(residual).max()) <= goal:
                break
            scaled = cho_solve(self.factor, residual)
            norm = float(residual @ scaled)
            direction = scaled + norm / before * direction
            image, before = self._deflected(direction), norm
            step = norm / float(direction @ image)
            force, residual = force + step * direction, residual - step * image
        return self._spread(force)

    def _deflected(self, force: FloatArray) -> FloatArray:
        self.loads += 1
        return np.asarray(self.deflect(self._spread(force))[self.active])

    def _spread(self, force: FloatArray) -> FloatArray:
        whole = np.zeros(self.active.size)
        whole[self.active] = force
        return whole
