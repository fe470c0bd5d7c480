"""Damping of a sheet's tangent that is not positive definite: viscosity, or a convex tangent.

The viscosity changes from step to step as in the method of Levenberg and Marquardt.
"""

from dataclasses import dataclass, replace

import numpy as np

from twin.mechanics.sheet.energy import Sheet

LEAST_VISCOSITY, MOST_VISCOSITY = 1.0, 1e15
"""Least and largest viscosity other than 0, kPa/mm."""

GROWTH = 8.0
"""Factor of the viscosity of a tangent that is not definite."""

_CONVEX_FROM = 1e4
# A tangent that was not definite is tried again after 1 step, 2, 4 and at most this number.
_MOST_CONVEX_STEPS = 16
# Of a step's predicted gain.
_POOR, _GOOD = 0.5, 0.75


@dataclass(frozen=True)
class Damping:
    """Damping that makes a tangent positive definite: viscosity, kPa/mm, and convex tangents."""

    viscosity: float = 0.0
    #: number of further steps with a convex tangent
    convex_steps: int = 0
    #: number of convex steps after the last indefinite tangent
    last_convex_steps: int = 0

    @property
    def convex(self) -> bool:
        """Whether the next tangent is convex."""
        return self.convex_steps > 0

    def times(self, factor: float) -> "Damping":
        """Return the damping with the viscosity multiplied by `factor`."""
        return replace(self, viscosity=factor * self.viscosity)

    def convexified(self) -> "Damping":
        """Return the damping with a convex tangent for twice as many steps as the last time.

        The number of steps is at least 1 and at most `_MOST_CONVEX_STEPS`.
        """
        steps = min(max(2 * self.last_convex_steps, 1), _MOST_CONVEX_STEPS)
        return replace(self, convex_steps=steps, last_convex_steps=steps)

    def after_step(self) -> "Damping":
        """Return the damping with one convex step less."""
        return replace(self, convex_steps=max(self.convex_steps - 1, 0))


def exact_viscosity(sheet: Sheet, damping: Damping, *, once: bool) -> float | None:
    """Factorise the exact tangent plus a viscosity; return the viscosity, None without success.

    The viscosity is increased up to `_CONVEX_FROM`. Only one value is tried if `once` is True, or
    if an earlier tangent was indefinite: the viscosity that the worst point of such a sheet needs
    would slow the whole sheet.
    """
    viscosity = max(damping.viscosity, GROWTH) if damping.last_convex_steps else damping.viscosity
    if once or damping.last_convex_steps:
        return viscosity if sheet.factorise(viscosity) else None
    # A reduced viscosity that is too low is nearly sufficient; more makes short steps for long.
    growth = float(np.sqrt(GROWTH)) if viscosity else GROWTH**2
    while not sheet.factorise(viscosity):
        viscosity = max(growth * viscosity, LEAST_VISCOSITY)
        if viscosity > _CONVEX_FROM:
            return None
    return viscosity


def adapted(viscosity: float, share: float, gain: float) -> float:
    """Return the viscosity of the next step, as in the method of Levenberg and Marquardt.

    It decreases after a step as good as predicted. It increases after a shortened or a poor step.

    Parameters
    ----------
    share : fraction of the last step that was made
    gain : decrease of the energy in that step over the predicted decrease
    """
    if share < 1:
        return max(viscosity, LEAST_VISCOSITY / 2) * min(GROWTH, 2 / max(share, 1 / GROWTH))
    if gain < _POOR:
        return 2 * viscosity
    less = viscosity if gain < _GOOD else viscosity / GROWTH
    return 0.0 if less < LEAST_VISCOSITY / 4 else less
