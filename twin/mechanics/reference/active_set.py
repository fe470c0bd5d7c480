"""Frictionless contact at scattered points of an elastic body, for the `fem` model.

The method is a primal-dual active set (Hintermueller, M., Ito, K., Kunisch, K. (2002): The
primal-dual active set strategy as a semismooth Newton method. SIAM J. Optim. 13, 865-888). It is
independent of the spectral model's contact solver. Find forces q >= 0 and gaps g >= 0 with q g = 0,
where g = A q + S - d: A is the compliance of the body, S the gap at first touch and d the depth.
On the active set the equations are solved by conjugate gradients, preconditioned by the compliance
of a half-space between the points. A is not assembled: each product with A is one linear solution.
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
# Largest residual gap over the depth: while the contact set changes, and at the end.
_ROUGH, _FINE = 1e-3, 1e-6
# (1 - nu^2) / pi at nu = 0.5
_HALF_SPACE = 0.75 / np.pi
_FIRST_POINTS = 12
# Number of passes without slack. After them, neglect violations of this share of the largest force
# and of the depth.
_PATIENCE, _SLACK = 12, 1e-4


@dataclass(frozen=True)
class PointContact:
    """Solution of a contact at scattered points."""

    #: (point,) force over Young's modulus, mm^2
    force: FloatArray
    #: travel of the specimen after first touch
    depth_mm: float
    #: number of loads for which the body was solved
    loads: int


@dataclass(frozen=True)
class ContactPoints:
    """Points of a face at which contact with the specimen is possible."""

    #: (point, node) sparse matrix: interpolates the deflections of nodes at the points
    trace: sparse.csr_array
    #: (node, xyz) positions of all nodes of the body
    nodes_mm: FloatArray
    #: (point,) compliance of the foundation between face and specimen: mm per force over modulus
    #: (mm^2)
    yielding: FloatArray
    #: (point,) gap between face and specimen at first touch, inf outside the specimen
    gap_mm: FloatArray


def press_points(
    deflect: Deflect,
    points: ContactPoints,
    *,
    depth_mm: float | None = None,
    force_over_modulus_mm2: float | None = None,
) -> PointContact:
    """Return the contact for a given depth or a given force (set one of the two).

    Parameters
    ----------
    deflect : linear, symmetric map from forces over modulus (point,), mm^2, to deflections along
        the press (point,), mm

    Raises
    ------
    PressError : no point touches the specimen
    SolverError : the contact set did not converge
    """
    known = np.isfinite(points.gap_mm)
    gap = np.where(known, points.gap_mm, 0.0)
    # First guess of the contact set: a ball touches where its gap is below about half the depth.
    # Under a given force the set starts with a few points.
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
    """Linear solver for the forces on a given contact set."""

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
        # The body also deflects as a whole; the solution for one uniform load gives this part.
        even = np.full(guess.shape[0], 1 / guess.shape[0])
        whole = float(even @ (self._deflected(even) - guess @ even))
        self.factor = cho_factor(guess + max(whole, 0.0), lower=True)

    def forces(self, aim: FloatArray, start: FloatArray) -> FloatArray:
        """Return forces over modulus (point,), mm^2, that deflect the set's points by `aim`, mm.

        Forces outside the set are 0. `start` (point,) is the first guess.
        """
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
