"""A rigid ball pressed into a round slab at large strain: the reference for the linear slab.

Neo-Hookean Q2/Q1 elements with contact in the current configuration, frictionless to full stick;
the same code at small strain (`linear=True`) reproduces the Fredholm solution. Axes r, z with z
along the press, z = 0 on the undeformed touched face. Everything is at unit Young's modulus.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.interpolate import CubicSpline

from reconstruction.arrays import FloatArray, IntArray
from tests.oracles.ball_contact import BallContact
from tests.oracles.round_grid import RoundGrid
from twin.mechanics.errors import PressError
from twin.mechanics.reference.grid import Surface, graded
from twin.mechanics.reference.mixed import MixedBody, moduli, neo_hookean
from twin.mechanics.reference.mixed import linear as small_strain
from twin.mechanics.reference.newton import Equilibrium, NewtonOptions, Problem, Pushed, press_to

Support = Literal["bonded", "simple", "clamped", "ledge"]

# Penetration remains below a micrometre after the augmentations.
_PENALTY_OVER_SHEAR = 60.0
_FINE_SHARE = 0.6


@dataclass(frozen=True)
class RoundSlab:
    """An undeformed round slab and its support; lengths in mm."""

    thickness_mm: float
    #: 7 thicknesses represent an unbounded bonded layer
    outer_radius_mm: float
    poisson_ratio: float
    #: far face bonded, or rim: no deflection, no displacement, or an annulus of the far face fixed
    support: Support
    #: width of the annulus of the `ledge`
    ledge_mm: float = 0.0


@dataclass(frozen=True)
class Resolution:
    """Sizes of elements and steps; the default takes half a minute for 1 mm by a ball of R 4."""

    radial: int = 44
    axial: int = 12
    surface_points: int = 5
    #: longest load step over the ball's radius
    step_over_radius: float = 1 / 56


@dataclass(frozen=True)
class AxisymmetricPress:
    """A solved press, at unit Young's modulus; lengths in mm."""

    depth_mm: float
    force_over_modulus_mm2: float
    #: (step,) the load steps
    path_depth_mm: FloatArray
    path_force_over_modulus_mm2: FloatArray
    #: (node,) undeformed radii of the nodes of both faces
    r_mm: FloatArray
    #: (node, [r, z]) displacement of the touched and of the far face
    touched_mm: FloatArray
    far_mm: FloatArray
    #: (point,) deformed radius of the points of contact, and pressure per deformed area there
    contact_r_mm: FloatArray
    pressure_over_modulus: FloatArray
    linear: bool

    @property
    def contact_radius_mm(self) -> float:
        """Outermost point of contact, good to 0.2 of an element."""
        return float(self.contact_r_mm.max(initial=0.0))

    def touched_face_mm(self, r_mm: FloatArray) -> FloatArray:
        """Return the touched face's deflection along the press, at deformed radii (...)."""
        return self._seen(self.touched_mm, r_mm)

    def far_face_mm(self, r_mm: FloatArray) -> FloatArray:
        """Return the far face's deflection along the press, at deformed radii (...)."""
        return self._seen(self.far_mm, r_mm)

    def _seen(self, moved: FloatArray, r_mm: FloatArray) -> FloatArray:
        # At small strain the sheet's points do not move sideways: the linear slab's convention.
        at = self.r_mm if self.linear else self.r_mm + moved[:, 0]
        curve = CubicSpline(at, moved[:, 1], bc_type=((1, np.zeros(())), "natural"))
        face: FloatArray = curve(np.minimum(r_mm, at[-1]))
        return face


def press_axisymmetric(
    slab: RoundSlab,
    radius_mm: float,
    depth_mm: float,
    *,
    friction: float = 0.0,
    linear: bool = False,
    resolution: Resolution | None = None,
) -> AxisymmetricPress:
    """Press a rigid ball into the middle of a round slab, to a depth.

    Parameters
    ----------
    slab : RoundSlab
        The slab.
    radius_mm, depth_mm : float, mm
        Ball, and its travel after first touch.
    friction : float
        Coulomb coefficient; `math.inf` sticks. Only at large strain.
    linear : bool
        Small strain and contact on the undeformed face.
    resolution : Resolution, optional
        Sizes of elements and steps.

    Returns
    -------
    AxisymmetricPress
        Force, contact and both faces.

    Raises
    ------
    PressError
        Lengths or friction out of range.
    SolverError
        No equilibrium, or only one with a hole in the contact.
    """
    _check(slab, radius_mm, depth_mm, friction, linear)
    fineness = resolution or Resolution()
    grid, element_mm = _grid(slab, radius_mm, depth_mm, fineness)
    body = MixedBody(grid, small_strain if linear else neo_hookean, moduli(slab.poisson_ratio))
    surface = grid.surface(fineness.surface_points)
    rest = np.zeros_like(surface.weight_mm2)
    penalty = _PENALTY_OVER_SHEAR * body.moduli.shear / element_mm
    contact = BallContact(
        surface, grid.nodes_mm, radius_mm, penalty, friction, linear, rest, rest, rest
    ).settle(np.zeros_like(grid.nodes_mm), 0.0)
    untouched = contact.evaluate(np.zeros_like(grid.nodes_mm), 0.0, None)
    path = [Equilibrium(np.zeros(body.unknowns), contact, 0.0, untouched, 0)]
    steps = int(np.ceil(depth_mm / (radius_mm * fineness.step_over_radius) - 1e-9))
    problem = Problem(body, _free(body, slab), NewtonOptions(largest_move_mm=element_mm))
    for aim in np.linspace(0, depth_mm, steps + 1)[1:]:
        path.append(press_to(problem, path[-1], float(aim)))
    return _result(body, surface, path, linear)


def _check(
    slab: RoundSlab, radius_mm: float, depth_mm: float, friction: float, linear: bool
) -> None:
    if not 0 < depth_mm < slab.thickness_mm and slab.support == "bonded":
        raise PressError(
            f"axisymmetric press: depth {depth_mm:g} mm must be between 0 and the thickness of "
            f"{slab.thickness_mm:g} mm"
        )
    if not 0 < radius_mm < slab.outer_radius_mm or not 0 < slab.poisson_ratio < 0.5:
        raise PressError(
            f"axisymmetric press: a ball of radius {radius_mm:g} mm in a slab of radius "
            f"{slab.outer_radius_mm:g} mm with Poisson's ratio {slab.poisson_ratio:g}; "
            "the ball must be smaller than the slab and 0 < nu < 0.5"
        )
    if linear and friction:
        raise PressError("axisymmetric press: the linear slab is frictionless; set friction = 0")
    if slab.support == "ledge" and not 0 < slab.ledge_mm < slab.outer_radius_mm:
        raise PressError(
            f"axisymmetric press: a ledge of {slab.ledge_mm:g} mm must be wider than 0 and "
            f"narrower than the slab's radius of {slab.outer_radius_mm:g} mm"
        )


def _grid(
    slab: RoundSlab, radius_mm: float, depth_mm: float, fineness: Resolution
) -> tuple[RoundGrid, float]:
    """Return the grid and the size of an element under the ball."""
    fine_mm = min(1.6 * np.sqrt(radius_mm * depth_mm), 1.2 * radius_mm, 0.6 * slab.outer_radius_mm)
    fine = round(_FINE_SHARE * fineness.radial)
    r = _refined(fine_mm, slab.outer_radius_mm, fine, fineness.radial - fine)
    if slab.support == "ledge":
        # The ledge's edge must be a grid line.
        inner = slab.outer_radius_mm - slab.ledge_mm
        r[np.abs(r - inner)[1:-1].argmin() + 1] = inner
    return RoundGrid((r, graded(slab.thickness_mm, fineness.axial, 1.25))), fine_mm / fine


def _bent_contact_mm(slab: RoundSlab, radius_mm: float, depth_mm: float) -> float:
    """Return an upper bound of the contact radius of a slab that bends, inf when bonded.

    Force of a plate on a simple rim under a point load (clamped: 2.3 times it; stretching adds
    as much again at a deflection of one thickness), then Hertz; a thin sheet touches the ball in a
    small spot for any depth of the press.
    """
    if slab.support == "bonded":
        return np.inf
    nu = slab.poisson_ratio
    rigidity = slab.thickness_mm**3 / (12 * (1 - nu**2))
    force = 16 * np.pi * rigidity * (1 + nu) / (3 + nu) * depth_mm / slab.outer_radius_mm**2
    factor = 1.0 if slab.support == "simple" else 2.3
    stretched = factor * force * (1 + (depth_mm / slab.thickness_mm) ** 2)
    return 2.0 * float(np.cbrt(0.75 * stretched * radius_mm * (1 - nu**2)))


def _free(body: MixedBody, slab: RoundSlab) -> IntArray:
    """Return the unknowns that are free of the support."""
    r, z = body.grid.nodes_mm.T
    near = 1e-9 * slab.outer_radius_mm
    far, rim = z > slab.thickness_mm - near, r > slab.outer_radius_mm - near
    held = np.zeros((r.size, 2), dtype=bool)
    held[r < near, 0] = True
    if slab.support == "bonded":
        held[far] = True
        held[rim, 0] = True
    elif slab.support == "simple":
        held[rim, 1] = True
    elif slab.support == "clamped":
        held[rim] = True
    else:
        held[far & (r > slab.outer_radius_mm - slab.ledge_mm - near)] = True
    free: IntArray = np.setdiff1d(np.arange(body.unknowns), np.flatnonzero(held))
    return free


def _result(
    body: MixedBody, surface: Surface, path: list[Equilibrium], linear: bool
) -> AxisymmetricPress:
    lines = body.grid.lines_mm
    moved = body.displacement_mm(path[-1].state).reshape(lines[0].size, lines[1].size, 2)
    r, pressure = _contact_pressure(body, surface, path[-1].pushed, path[-1].state, linear)
    return AxisymmetricPress(
        depth_mm=path[-1].depth_mm,
        force_over_modulus_mm2=path[-1].pushed.along,
        path_depth_mm=np.array([result.depth_mm for result in path]),
        path_force_over_modulus_mm2=np.array([result.pushed.along for result in path]),
        r_mm=lines[0],
        touched_mm=moved[:, 0],
        far_mm=moved[:, -1],
        contact_r_mm=r,
        pressure_over_modulus=pressure,
        linear=linear,
    )


def _contact_pressure(
    body: MixedBody, surface: Surface, pushed: Pushed, state: FloatArray, linear: bool
) -> tuple[FloatArray, FloatArray]:
    """Return deformed radii of contact points and pressure per deformed area there."""
    nodes, moved = body.grid.nodes_mm, body.displacement_mm(state)
    active = pushed.active
    before = (surface.trace @ nodes)[:, 0]
    if linear:
        return before[active], pushed.pressure[active]
    after = surface.trace @ (nodes + moved)
    slope = np.gradient(after, before, axis=0)
    stretch = np.linalg.norm(slope, axis=1) * after[:, 0] / before
    return after[active, 0], (pushed.pressure / stretch)[active]


def _refined(fine_mm: float, length_mm: float, fine: int, coarse: int) -> FloatArray:
    """Return edges on 0..length: `fine` equal steps up to fine_mm, then growing ones."""
    step, rest = fine_mm / fine, length_mm - fine_mm
    ratios = np.linspace(1.0, 8.0, 4000)
    powers = ratios[:, None] ** np.arange(1, coarse + 1)
    ratio = float(np.interp(rest, step * powers.sum(axis=1), ratios))
    return np.concatenate(
        (np.linspace(0, fine_mm, fine + 1), fine_mm + graded(rest, coarse, ratio)[1:])
    )
