"""A stretched block bent around a frictionless cylinder: neo-Hookean, any thickness, exact.

Rivlin (Proceedings of the Royal Society A 195, 463-473, 1949): in plane strain an incompressible
block bends into a sector with fibres on circles, at r with the stretch w r. The bent block
continues as a flat one that is loaded only by its tension; both slide freely, so that per
undeformed length each has the same energy less tension times stretch (the material's own force).
Shear modulus 1.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq


@dataclass(frozen=True)
class HangingBlock:
    """Line of tension, tension and thickness of the flat part."""

    #: distance of its line of tension from the cylinder's axis
    distance_mm: float
    #: per width, over the shear modulus
    tension_over_shear: float
    #: thickness of the flat part
    local_mm: float


def tension_distance(radius_mm: float, thickness_mm: float, across: float) -> HangingBlock:
    """Return the tension of a block bent round a cylinder; `across`: stretch of its flat part."""
    thinned = 1 / across
    flat = (across**2 + thinned**2 - 2) / 2 - (across**2 - thinned**2)

    def kept_too_much(turn_per_mm: float) -> float:
        return _bent(radius_mm, thickness_mm, turn_per_mm)[1] - flat

    turn = float(
        brentq(kept_too_much, 0.3 * across / (radius_mm + thickness_mm), across / radius_mm)
    )
    tension = (across**2 - thinned**2) * thickness_mm * thinned
    moment = _bent(radius_mm, thickness_mm, turn)[0]
    return HangingBlock(moment / tension, tension, thickness_mm * thinned)


def _bent(radius_mm: float, thickness_mm: float, turn_per_mm: float) -> tuple[float, float]:
    """Return the moment about the axis, and energy less tension times stretch per thickness."""
    points, weights = np.polynomial.legendre.leggauss(60)
    depth = thickness_mm * (points + 1) / 2
    r, outer = (np.sqrt(radius_mm**2 + 2 * of / turn_per_mm) for of in (depth, thickness_mm))
    along, through = turn_per_mm * r, 1 / (turn_per_mm * r)
    # Radial stress by equilibrium, zero on the free side.
    pressed = _radial(r, turn_per_mm) - _radial(outer, turn_per_mm)
    hoop = pressed + along**2 - through**2
    per_depth = weights * thickness_mm / 2
    energy = (along**2 + through**2 - 2) / 2
    return float(per_depth @ hoop / turn_per_mm), float(weights @ (energy - hoop) / 2)


def _radial(r_mm, turn_per_mm):
    return (turn_per_mm * r_mm) ** 2 / 2 + 1 / (2 * (turn_per_mm * r_mm) ** 2)
