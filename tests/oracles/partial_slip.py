"""Partial slip of a ball on a thick layer by Cattaneo and Mindlin, and by the project's solver.

Cattaneo (1938), Mindlin (1949): a tangential force T < mu N on two bodies pressed by N makes them
stick within c = a (1 - T / (mu N))^(1/3), with the contact radius a, and moves them by
3 mu N (2 - nu) / (16 G a) [1 - (1 - T / (mu N))^(2/3)]. The closed form neglects slip across T.

A thick layer is stiffer than the half-space by a displacement T c_0 that is uniform over the
contact, where c_0 is the difference of their compliances at the loaded point.
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import quad

from reconstruction.arrays import BoolArray, FloatArray
from twin.mechanics.contact import solve_on_layer
from twin.mechanics.control import DepthControl
from twin.mechanics.friction import solve_friction
from twin.mechanics.layer import BondedLayer
from twin.mechanics.patch import Span
from twin.mechanics.shear import InPlane, ShearedLayer, along_wave

RADIUS_MM, DEPTH_MM, THICKNESS_MM, NU = 4.0, 0.25, 12.0, 0.49


@dataclass(frozen=True, eq=False)
class PartialSlip:
    """Solution at the travel of the closed form; arrays are (row, col) on the contact's cells."""

    #: solved over expected value
    force_ratio: float
    radius_ratio: float
    travel_mm: float
    bound: FloatArray
    traction: InPlane
    slip_mm: InPlane
    sticking: BoolArray


def paraboloid(layer: BondedLayer) -> FloatArray:
    """Return the height of the ball's paraboloid behind its tip, (row, col), mm."""
    x, y = np.meshgrid(layer.x_mm, layer.y_mm)
    return np.asarray((x**2 + y**2) / (2 * RADIUS_MM))


def solve_partial_slip(share: float, mu: float = 0.5, cells: int = 768) -> PartialSlip:
    """Slide a ball by the travel at which T is `share` of mu N, on cells of 76.8 mm / `cells`."""
    layer = BondedLayer(cells, cells, 76.8, 76.8, THICKNESS_MM, NU)
    contact = solve_on_layer(layer, paraboloid(layer), DepthControl(DEPTH_MM))
    touching, area = contact.pressure > 0, layer.cell_area_mm2
    load, radius = (
        float(contact.pressure.sum()) * area,
        float(np.sqrt(touching.sum() * area / np.pi)),
    )
    patch = ShearedLayer(layer).patch(*map(Span.around, np.nonzero(touching), touching.shape))
    travel = _travel_mm(share, mu * load, radius)
    bound = mu * contact.pressure[patch.cells]
    still, moved = np.zeros_like(bound), np.full_like(bound, travel)
    traction = solve_friction(patch, bound, InPlane(moved, still), InPlane(still, still))
    displaced = patch.displace(traction)
    sticking = np.hypot(*traction) < (1 - 1e-3) * bound
    stick_radius = float(np.sqrt(sticking.sum() * area / np.pi))
    return PartialSlip(
        force_ratio=float(traction.x.sum()) * area / (share * mu * load),
        radius_ratio=stick_radius / radius / (1 - share) ** (1 / 3),
        travel_mm=travel,
        bound=bound,
        traction=traction,
        slip_mm=InPlane(moved - displaced.x, -displaced.y),
        sticking=sticking,
    )


def _travel_mm(share: float, limit_mm2: float, radius_mm: float) -> float:
    """Return the travel, mm, at which T / E is `share` of `limit_mm2`, mu N / E."""
    shear = 1 / (2 * (1 + NU))
    half_space = 3 * limit_mm2 * (2 - NU) / (16 * shear * radius_mm)
    excess, _ = quad(_excess, 0, 40)
    uniform = share * limit_mm2 * excess / (4 * np.pi * THICKNESS_MM)
    return float(half_space * (1 - (1 - share) ** (2 / 3)) + uniform)


def _excess(q: float) -> float:
    """Return the difference of both compliances of layer and half-space times E k, at q = k h."""
    along = float(along_wave(np.array(q), NU)) - 1
    return 2 * (1 - NU**2) * along + 2 * (1 + NU) * (np.tanh(q) - 1)
