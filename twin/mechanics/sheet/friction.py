"""Coulomb friction of the thin sheet: limit, slip and traction at its Gauss points.

A point that touches has a spring to its anchor, in the tangent plane of the touched body. Its force
is limited to the friction coefficient times the contact pressure; beyond the limit the point slips.
After each load step the anchors of points that slip are set back, so that their springs have the
limit's force (return mapping of plasticity, Wriggers 2006, Computational Contact Mechanics, 5.2).
Within a load step the limits follow the contact pressure by fixed-point iteration.

Arrays are (row, col, 4), at the Gauss points of the cells; pressure and traction are per undeformed
area, kPa. Tack does not increase the limit.
"""

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray
from twin.mechanics.sheet.laws import Grip, Laws


def friction_limit_kpa(
    gap_mm: FloatArray, laws: Laws, thickness_ratio: FloatArray, coefficient: float
) -> FloatArray:
    """Return the largest friction at each point, infinite for an infinite coefficient.

    Parameters
    ----------
    gap_mm : distance of the lower face from the nearest body; negative where it is pressed in
    thickness_ratio : local over mean undeformed thickness
    """
    if np.isinf(coefficient):
        return np.full(gap_mm.shape, np.inf)
    pressed_mm = np.maximum(-gap_mm, 0.0)
    return np.asarray(coefficient * laws.contact_stiffness / thickness_ratio * pressed_mm)


@dataclass(frozen=True, eq=False)
class Friction:
    """Friction at the Gauss points of a sheet, and how far points have slipped.

    Attributes
    ----------
    traction_kpa : (row, col, 4, xyz) force of the bodies on the sheet; 0 without an anchor
    slip_mm : (row, col, 4, xyz) slip since the anchors were last set
    """

    traction_kpa: FloatArray
    slip_mm: FloatArray

    @property
    def slips(self) -> BoolArray:
        """Points whose friction is at its limit."""
        return np.asarray((self.slip_mm != 0).any(axis=-1))


def friction_at(away: FloatArray, grip: Grip, stiffness: FloatArray) -> Friction:
    """Return the friction at points whose distances from their anchors are `away`.

    Parameters
    ----------
    away : (row, col, 4, xyz) mm
    stiffness : (row, col, 4) of the springs to the anchors, kPa/mm
    """
    away = away - (away * grip.normal).sum(axis=-1, keepdims=True) * grip.normal
    away = np.where(grip.held[..., None] > 0, away, 0.0)
    length_mm = np.linalg.norm(away, axis=-1)
    spring_mm = np.minimum(length_mm, grip.limit_kpa / stiffness)
    share = np.where(length_mm > spring_mm, spring_mm / np.maximum(length_mm, 1e-300), 1.0)
    spring = share[..., None] * away
    return Friction(-stiffness[..., None] * spring, away - spring)
