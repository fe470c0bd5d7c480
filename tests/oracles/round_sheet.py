"""The sheet in one dimension: round about an axis, or a strip in plane strain.

An oracle of `twin.mechanics.sheet` that shares no code with it. Incompressible neo-Hookean
Kirchhoff-Love sheet of finite rotation and stretch; the unknown r(S) is the surface midway between
the DEFORMED faces, in quadratic B-splines of the undeformed radius (strip: half width) S.

Frame: r (strip: x) and z along the press; z = 0 is the undeformed mid plane. The specimen is below
and first touches the lower face at travel 0. Units mm, N, MPa; a strip is 1 mm long.

Symbols: l1, l2 principal stretches (meridian, hoop; strip: l2 = 1), l3 = 1 / (l1 l2) that of the
thickness h, k1, k2 principal curvatures. With t = k1 + k2, q = k1^2 + k2^2 and
v = l1^2 k1^2 + l2^2 k2^2 the energy per undeformed area is

    W / mu = h/2 (l1^2 + l2^2 + l3^2 - 3) + h^3/24 [(2 t^2 + q) l3^2 + v] l3^2

The faces are at r +- (h/2) l3 n; the gap to a rigid part of signed distance phi is
g = phi(r) - (h/2) l3. Contact costs eps g^2 / 2 per undeformed area, eps = E* / (0.25 h).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded

from reconstruction.arrays import FloatArray
from tests.oracles.round_energy import Assembled, assemble, banded, spread
from tests.oracles.round_model import Anchors, Load, RoundSheet
from tests.oracles.sections import Section, bar_section, rod_section

__all__ = ["bar_section", "rod_section", "round_sheet_profile", "strip_sheet_profile"]

_TOLERANCE_MM = 1e-9
_MOST_ITERATIONS = 80
_LARGEST_MOVE_MM = 0.3


@dataclass(frozen=True)
class Equilibrium:
    """A solved sheet."""

    load: Load
    #: (function, [r, z])
    coefficients_mm: FloatArray
    anchors: Anchors
    #: (point,) gap to the nearest part
    gap_mm: FloatArray
    #: N, strip N/mm: of the specimen on the sheet along z
    force: float
    #: N/mm: lifts the lifted end
    lift_force: float
    energy: float
    iterations: int = 0


@dataclass(frozen=True)
class Profile:
    """Both faces along the section, axis to rim, and the contact force."""

    radius_mm: FloatArray
    #: above the undeformed upper face
    upper_z_mm: FloatArray
    lower_r_mm: FloatArray
    #: above the undeformed lower face
    lower_z_mm: FloatArray
    #: N; strip: N per mm of length
    force_n: float
    #: outermost touching point of the lower face, 0 if there is none
    contact_radius_mm: float
    #: deformed over undeformed thickness
    thickness_stretch: FloatArray


class NoEquilibriumError(Exception):
    """The path ends here."""


def round_sheet_profile(
    ball_radius_mm: float,
    thickness_mm: float,
    young_modulus_kpa: float,
    rim_mm: float,
    travel_mm: float,
    **options,
) -> Profile:
    """Press a ball into a round sheet; options as for `strip_sheet_profile`."""
    return _pressed_profile(
        rod_section(ball_radius_mm), thickness_mm, young_modulus_kpa, rim_mm, travel_mm, **options
    )


def strip_sheet_profile(
    section: Section,
    thickness_mm: float,
    young_modulus_kpa: float,
    rim_mm: float,
    travel_mm: float,
    **options,
) -> Profile:
    """Press an infinitely long bar or rod into a strip held at +- rim.

    Options
    -------
    pressure_kpa, tack_j_m2, stick, clamped
        Back pressure (ramped after the travel), adhesion, no slip once touched, kind of rim.
    step_mm, pitch_mm, fine_mm, tack_range_mm
        Sizes of steps and cells.
    """
    return _pressed_profile(
        section, thickness_mm, young_modulus_kpa, rim_mm, travel_mm, plane_strain=True, **options
    )


def _pressed_profile(
    section,
    thickness_mm,
    young_modulus_kpa,
    rim_mm,
    travel_mm,
    *,
    pressure_kpa=0.0,
    tack_j_m2=0.0,
    step_mm=0.1,
    **options,
) -> Profile:
    sheet = RoundSheet(
        section,
        thickness_mm,
        young_modulus_kpa * 1e-3,
        rim_mm,
        tack_n_mm=tack_j_m2 * 1e-3,
        **options,
    )
    result = follow(sheet, rest(sheet), Load(travel_mm), round(np.ceil(travel_mm / step_mm - 1e-9)))
    if pressure_kpa:
        result = follow(sheet, result, Load(travel_mm, pressure_kpa * 1e-3), 4)
    return profile(sheet, result)


def rest(sheet: RoundSheet) -> Equilibrium:
    """Return the flat sheet, just touched."""
    flat = np.column_stack((sheet.line.greville_mm, np.zeros(sheet.line.size)))
    nothing = np.zeros(sheet.line.points_mm.size)
    anchors = Anchors(nothing > 0, nothing, nothing, nothing, nothing)
    return balanced(sheet, Load(), flat, anchors)


def follow(sheet: RoundSheet, start: Equilibrium, aim: Load, steps: int) -> Equilibrium:
    """Solve from an equilibrium to a load in a number of steps, shorter ones where one fails.

    Raises
    ------
    NoEquilibriumError
        A step of 1/64 failed.
    """
    at, before, done, stride = start, None, 0.0, 1 / max(steps, 1)
    shortest = stride / 64
    while done < 1 - 1e-9:
        stride = min(stride, 1 - done)
        load = start.load.towards(aim, done + stride)
        guess = at.coefficients_mm
        if before is not None:
            guess = guess + (guess - before[0]) * stride / before[1]
        result = _solved(sheet, load, guess, at)
        if result is None:
            before, stride = None, stride / 2
            if stride < shortest:
                raise NoEquilibriumError(f"no equilibrium between {at.load} and {load}")
            continue
        before = (at.coefficients_mm, stride)
        at, done = _grip(sheet, result), done + stride
    return at


def profile(sheet: RoundSheet, result: Equilibrium) -> Profile:
    """Return both faces at the cells' edges and middles."""
    edges, half = sheet.line.edges_mm, sheet.thickness_mm / 2
    at = np.interp(np.arange(2 * edges.size - 1) / 2, np.arange(edges.size), edges)
    at[0] = 1e-6 * sheet.rim_mm  # no hoop on the axis itself
    upper, lower, thin = _faces(sheet, result, at)
    touching = _faces(sheet, result, sheet.line.points_mm)[1][result.gap_mm < 0, 0]
    return Profile(
        radius_mm=upper[:, 0],
        upper_z_mm=upper[:, 1] - half,
        lower_r_mm=lower[:, 0],
        lower_z_mm=lower[:, 1] + half,
        force_n=result.force,
        contact_radius_mm=float(touching.max(initial=0.0)),
        thickness_stretch=thin,
    )


def _faces(sheet: RoundSheet, result: Equilibrium, at_mm: FloatArray):
    """Return upper and lower face (point, [r, z]) and the stretch of the thickness (point,)."""
    middle, along = (sheet.line.table(at_mm, d) @ result.coefficients_mm for d in (0, 1))
    j = np.hypot(*along.T)
    thin = 1 / j if sheet.plane_strain else at_mm / (j * middle[:, 0])
    up = (
        np.stack((-along[:, 1], along[:, 0]), axis=1) * (sheet.thickness_mm / 2 * thin / j)[:, None]
    )
    return middle + up, middle - up, thin


def _solved(
    sheet: RoundSheet, load: Load, guess: FloatArray, start: Equilibrium
) -> Equilibrium | None:
    """Minimise the energy from a guess; None if Newton's method does not converge."""
    at = guess.copy()
    if sheet.lifted_end:
        at[0, 1] = load.lift_mm
    anchors = start.anchors
    here = assemble(sheet, load, at, anchors)
    for iteration in range(_MOST_ITERATIONS):
        move, falls = _newton_move(sheet, here)
        largest = np.abs(move).max()
        share = min(1.0, _LARGEST_MOVE_MM / max(largest, _TOLERANCE_MM))
        there = assemble(sheet, load, at + share * move, anchors)
        while not there.energy <= here.energy - 1e-4 * share * falls + _noise(sheet):
            share /= 2
            if share < 1e-6:
                return None
            there = assemble(sheet, load, at + share * move, anchors)
        at, here = at + share * move, there
        if largest < _TOLERANCE_MM:
            return replace(balanced(sheet, load, at, anchors), iterations=iteration + 1)
    return None


def _noise(sheet: RoundSheet) -> float:
    """Return the rounding error of the energy's differences: the membrane's sum less 3."""
    stiffness = sheet.shear_modulus_mpa * sheet.thickness_mm
    return float(8 * np.finfo(float).eps * stiffness * sheet.weights_mm2.sum())


def _newton_move(sheet: RoundSheet, here: Assembled):
    """Return the move of the coefficients (n, 2) and the slope of the energy along it."""
    unknowns = sheet.unknowns
    free = unknowns >= 0
    slope = np.bincount(unknowns[free], here.gradient[free], unknowns.max() + 1)
    move = -cho_solve_banded((_factor(sheet, here.bend), True), slope)
    full = np.where(free, move[unknowns], 0.0).reshape(-1, 2)
    return full, -float(slope @ move)


def _factor(sheet: RoundSheet, bend: FloatArray) -> FloatArray:
    """Factor the exact tangent, or where it is indefinite its nearest convex likeness."""
    try:
        return cholesky_banded(banded(sheet, bend), lower=True)
    except LinAlgError:
        value, vector = np.linalg.eigh(bend)
        convex = (vector * np.maximum(value, 0)[:, None]) @ np.swapaxes(vector, 1, 2)
        matrix = banded(sheet, convex)
        matrix[0] *= 1 + 1e-7
        return cholesky_banded(matrix, lower=True)


def balanced(
    sheet: RoundSheet, load: Load, coefficients: FloatArray, anchors: Anchors
) -> Equilibrium:
    """Return the forces at coefficients (function, [r, z]) that are in equilibrium."""
    result = assemble(sheet, load, coefficients, anchors)
    return Equilibrium(
        load, coefficients, anchors, result.gap_mm, result.force, result.gradient[1], result.energy
    )


def _grip(sheet: RoundSheet, result: Equilibrium) -> Equilibrium:
    """Anchor points that newly touch at their nearest point, release points that have left.

    A new anchor has neither energy nor force: the sheet remains in equilibrium.
    """
    if not sheet.stick:
        return result
    reach = sheet.tack_range_mm if sheet.tack_n_mm else 0.0
    x, z = spread(sheet, result.coefficients_mm)[[0, 3]]
    raised = z + sheet.thickness_mm / 2 - result.load.travel_mm
    near = [part(x, raised) for part in sheet.section]
    nearest = np.argmin([part.distance_mm for part in near], axis=0)
    nx, nz, distance = (
        np.choose(nearest, [getattr(part, name) for part in near])
        for name in ("normal_x", "normal_z", "distance_mm")
    )
    old, new = result.anchors, ~result.anchors.held & (result.gap_mm < 0.5 * reach)
    held = new | (old.held & (result.gap_mm < reach))
    anchors = Anchors(
        held,
        np.where(new, x - distance * nx, old.x_mm),
        np.where(new, raised - distance * nz, old.z_mm),
        np.where(new, nz, old.tangent_x),
        np.where(new, -nx, old.tangent_z),
    )
    return replace(result, anchors=anchors)
