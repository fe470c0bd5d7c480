"""Tangential traction in a contact with Coulomb friction, for one increment of the travel.

In each cell of the contact the traction q is bounded by friction, |q| <= mu p. The face moves by
the increment dU of the specimen where it sticks; where it slips, the slip dU - du has the direction
of q. For a given pressure p these conditions are those of the minimum of

    q (B q) / 2 - q (B q0 + dU)   for |q| <= mu p,

with the compliance B, and the traction q0 before the increment (after J. J. Kalker,
Three-Dimensional Elastic Bodies in Rolling Contact, 1990). The minimum is unique. It is found by
accelerated projected gradients with restart (Beck, Teboulle, SIAM J. Imaging Sci. 2, 183 (2009);
O'Donoghue, Candes, Found. Comput. Math. 15, 715 (2015)).

Arrays are (row, col); traction and pressure are divided by Young's modulus.
"""

import numpy as np

from reconstruction.arrays import FloatArray
from twin.mechanics.control import inner
from twin.mechanics.errors import SolverError
from twin.mechanics.shear import InPlane, ShearPatch

# Largest change of the traction in the last pass over its largest bound.
_TOLERANCE = 1e-6
_MOST_PASSES = 5000


def solve_friction(
    patch: ShearPatch, bound: FloatArray, target_mm: InPlane, guess: InPlane
) -> InPlane:
    """Return the traction over modulus after an increment of the travel.

    Parameters
    ----------
    bound : (row, col) float; friction coefficient times pressure over modulus, 0 outside the
        contact
    target_mm : in-plane displacement of the face if it sticks everywhere, B q0 + dU, mm
    guess : first guess of the traction over modulus, for example that before the increment

    Raises
    ------
    SolverError : no solution within the passes
    """
    traction = limited(guess, bound)
    trial, momentum, step = traction, 1.0, 1 / patch.largest
    smallest = _TOLERANCE * float(bound.max())
    for _ in range(_MOST_PASSES):
        at = patch.displace(trial)
        slip = InPlane(target_mm.x - at.x, target_mm.y - at.y)
        after = limited(InPlane(trial.x + step * slip.x, trial.y + step * slip.y), bound)
        change = InPlane(after.x - traction.x, after.y - traction.y)
        residual = max(float(np.abs(after[axis] - trial[axis]).max()) for axis in (0, 1))
        if residual <= smallest:
            return after
        # Restart: the step from the trial point has turned back against the last change.
        if sum(inner(trial[axis] - after[axis], change[axis]) for axis in (0, 1)) > 0:
            momentum = 1.0
        following = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        weight = (momentum - 1) / following
        trial = InPlane(after.x + weight * change.x, after.y + weight * change.y)
        traction, momentum = after, following
    raise SolverError(
        f"press: no solution of the friction within {_MOST_PASSES} passes; use a coarser "
        "press.solver_pitch_mm"
    )


def limited(traction: InPlane, bound: FloatArray) -> InPlane:
    """Return traction shortened to `bound` (row, col) where it is larger."""
    size = np.hypot(traction.x, traction.y)
    factor = np.divide(bound, size, out=np.ones_like(bound), where=size > bound)
    return InPlane(traction.x * factor, traction.y * factor)
