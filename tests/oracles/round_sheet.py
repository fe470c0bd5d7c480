"""The sheet in one dimension: round about an axis, or a strip in plane strain.

An oracle of `twin.mechanics.sheet` that shares no code with it. Incompressible neo-Hookean
Kirchhoff-Love sheet of finite rotation and stretch; the unknown r(S) is the surface midway between
the DEFORMED faces, in quadratic B-splines of the undeformed radius (strip: half width) S.

Frame: r (strip: x) and z along the press; z = 0 is the undeformed mid plane. The specimen comes
from below and first touches the lower face at travel 0. Units mm, N, MPa; a strip is 1 mm long.

Symbols: l1, l2 principal stretches (meridian, hoop; strip: l2 = 1), l3 = 1 / (l1 l2) that of the
thickness h, k1, k2 principal curvatures. With t = k1 + k2, q = k1^2 + k2^2 and
v = l1^2 k1^2 + l2^2 k2^2 the energy per undeformed area is

    W / mu = h/2 (l1^2 + l2^2 + l3^2 - 3) + h^3/24 [(2 t^2 + q) l3^2 + v] l3^2

The faces lie at r +- (h/2) l3 n; the gap to a rigid part of signed distance phi is
g = phi(r) - (h/2) l3. Touching costs eps g^2 / 2 per undeformed area, eps = E* / (0.25 h).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded

from tests.oracles.jets import Jet, variables
from tests.oracles.sections import FloatArray, Section, bar_section, rod_section

__all__ = ["bar_section", "rod_section", "round_sheet_profile", "strip_sheet_profile"]

_COMPLIANT_SHARE = 0.25
_SLIPPING_SHARE = 0.5
_TOLERANCE_MM = 1e-9
_BAND = 5


@dataclass(frozen=True)
class Line:
    """Quadratic B-splines on graded cells of 0..rim, fine near the axis and at the rim."""

    rim_mm: float
    fine_mm: float
    pitch_mm: float
    growth: float = 0.12
    coarse_mm: float = 0.25

    @cached_property
    def edges_mm(self) -> FloatArray:
        s = np.linspace(0, self.rim_mm, 20001)
        away = np.minimum(np.maximum(s - self.fine_mm, 0), self.rim_mm - s)
        density = 1 / np.minimum(self.pitch_mm + self.growth * away, self.coarse_mm)
        cells = np.concatenate(([0.0], np.cumsum((density[1:] + density[:-1]) / 2))) * s[1]
        return np.interp(np.linspace(0, cells[-1], int(np.ceil(cells[-1])) + 1), cells, s)

    @cached_property
    def knots_mm(self) -> FloatArray:
        return np.concatenate(([0.0] * 2, self.edges_mm, [self.rim_mm] * 2))

    @cached_property
    def size(self) -> int:
        return self.edges_mm.size + 1

    @cached_property
    def greville_mm(self) -> FloatArray:
        return (self.knots_mm[1:-2] + self.knots_mm[2:-1]) / 2

    @cached_property
    def points_mm(self) -> FloatArray:
        """Two Gauss points per cell."""
        shares = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3)
        return (self.edges_mm[:-1, None] + np.diff(self.edges_mm)[:, None] * shares).ravel()

    @cached_property
    def weights_mm(self) -> FloatArray:
        return np.repeat(np.diff(self.edges_mm) / 2, 2)

    @cached_property
    def local(self) -> FloatArray:
        """(point, derivative, function): the three splines that live at each Gauss point."""
        cell = np.repeat(np.arange(self.size - 2), 2)[:, None] + np.arange(3)
        return np.stack(
            [np.take_along_axis(self.table(self.points_mm, d), cell, 1) for d in range(3)], axis=1
        )

    def table(self, at_mm: FloatArray, derivative: int) -> FloatArray:
        """Return all splines at (point,): (point, function)."""
        return BSpline(self.knots_mm, np.eye(self.size), 2)(at_mm, nu=derivative)


@dataclass(frozen=True)
class RoundSheet:
    """A sheet, what holds it and what it meets."""

    section: Section
    thickness_mm: float
    young_modulus_mpa: float
    rim_mm: float
    plane_strain: bool = False
    #: no slope at the rim; otherwise free to turn there
    clamped: bool = True
    stick: bool = False
    #: adhesion energy in N/mm per undeformed area and the range of its forces
    tack_n_mm: float = 0.0
    tack_range_mm: float = 0.08
    #: not a mirror at S = 0 but an end that is free along x and lifted
    lifted_end: bool = False
    pitch_mm: float = 0.05
    fine_mm: float = 5.0

    @property
    def shear_modulus_mpa(self) -> float:
        return self.young_modulus_mpa / 3

    @cached_property
    def line(self) -> Line:
        return Line(self.rim_mm, self.fine_mm, self.pitch_mm)

    @cached_property
    def weights_mm2(self) -> FloatArray:
        """(point,) undeformed area; a strip counts with both its halves."""
        line = self.line
        if self.plane_strain:
            return line.weights_mm * (1 if self.lifted_end else 2)
        return 2 * np.pi * line.points_mm * line.weights_mm

    @cached_property
    def unknowns(self) -> FloatArray:
        """(2 n,) number of the free unknown behind each coefficient, -1 where it is held."""
        n = self.line.size
        free = np.ones((n, 2), dtype=bool)
        free[-1] = False
        free[-2, 1] = not self.clamped
        free[0] = (True, False) if self.lifted_end else (False, False)
        number = np.where(free, np.cumsum(free).reshape(n, 2) - 1, -1)
        if not self.lifted_end:
            number[0, 1] = number[1, 1]  # no slope on the axis
        return number.ravel()


@dataclass(frozen=True)
class Anchors:
    """Where Gauss points (point,) stick to the specimen, in its own frame."""

    held: FloatArray
    x_mm: FloatArray
    z_mm: FloatArray
    #: unit tangent there, frozen: the anchoring is a true potential
    tangent_x: FloatArray
    tangent_z: FloatArray


@dataclass(frozen=True)
class Load:
    """What is prescribed."""

    travel_mm: float = 0.0
    #: on the upper face, along -z on the flat sheet, following the surface
    pressure_mpa: float = 0.0
    #: of the lifted end
    lift_mm: float = 0.0

    def towards(self, other: "Load", share: float) -> "Load":
        """Return the load a share of the way to another."""
        here, there = (np.array(list(vars(load).values())) for load in (self, other))
        return Load(*(here + share * (there - here)).tolist())


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
    """Both faces along the section, axis to rim, and what holds them up."""

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
        How finely to solve.
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
    found = follow(sheet, rest(sheet), Load(travel_mm), round(np.ceil(travel_mm / step_mm - 1e-9)))
    if pressure_kpa:
        found = follow(sheet, found, Load(travel_mm, pressure_kpa * 1e-3), 4)
    return profile(sheet, found)


def rest(sheet: RoundSheet) -> Equilibrium:
    """Return the flat sheet, just touched."""
    flat = np.column_stack((sheet.line.greville_mm, np.zeros(sheet.line.size)))
    nothing = np.zeros(sheet.line.points_mm.size)
    anchors = Anchors(nothing > 0, nothing, nothing, nothing, nothing)
    return _balanced(sheet, Load(), flat, anchors)


def follow(sheet: RoundSheet, start: Equilibrium, aim: Load, steps: int) -> Equilibrium:
    """Go from an equilibrium to a load in so many steps, shorter ones where one fails.

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
        found = _solved(sheet, load, guess, at)
        if found is None:
            before, stride = None, stride / 2
            if stride < shortest:
                raise NoEquilibriumError(f"no equilibrium between {at.load} and {load}")
            continue
        before = (at.coefficients_mm, stride)
        at, done = _grip(sheet, found), done + stride
    return at


def profile(sheet: RoundSheet, found: Equilibrium) -> Profile:
    """Return both faces at the cells' edges and middles."""
    edges, half = sheet.line.edges_mm, sheet.thickness_mm / 2
    at = np.interp(np.arange(2 * edges.size - 1) / 2, np.arange(edges.size), edges)
    at[0] = 1e-6 * sheet.rim_mm  # no hoop on the axis itself
    upper, lower, thin = _faces(sheet, found, at)
    touching = _faces(sheet, found, sheet.line.points_mm)[1][found.gap_mm < 0, 0]
    return Profile(
        radius_mm=upper[:, 0],
        upper_z_mm=upper[:, 1] - half,
        lower_r_mm=lower[:, 0],
        lower_z_mm=lower[:, 1] + half,
        force_n=found.force,
        contact_radius_mm=float(touching.max(initial=0.0)),
        thickness_stretch=thin,
    )


def _faces(sheet: RoundSheet, found: Equilibrium, at_mm: FloatArray):
    """Return upper and lower face (point, [r, z]) and the stretch of the thickness (point,)."""
    middle, along = (sheet.line.table(at_mm, d) @ found.coefficients_mm for d in (0, 1))
    j = np.hypot(*along.T)
    thin = 1 / j if sheet.plane_strain else at_mm / (j * middle[:, 0])
    up = (
        np.stack((-along[:, 1], along[:, 0]), axis=1) * (sheet.thickness_mm / 2 * thin / j)[:, None]
    )
    return middle + up, middle - up, thin


@dataclass(frozen=True)
class _Assembled:
    energy: float
    #: (2 n,) derivative by the coefficients
    gradient: FloatArray
    #: (point, variable, variable) weighted second derivative of the energy
    bend: FloatArray
    gap_mm: FloatArray
    force: float


def _assemble(sheet: RoundSheet, load: Load, coefficients: FloatArray, anchors: Anchors):
    weights = sheet.weights_mm2
    local = _spread(sheet, coefficients)
    y = variables(local)
    strained = _strained(sheet, y, load.pressure_mpa)
    touched, gap = _touched(sheet, y, load.travel_mm, anchors)
    total = strained + touched
    slopes = _gathered(sheet, weights * total.slope)
    return _Assembled(
        energy=float(weights @ total.value),
        gradient=slopes,
        bend=np.moveaxis(weights * total.bend, 2, 0),
        gap_mm=gap,
        force=-float(weights @ touched.slope[3]),
    )


def _spread(sheet: RoundSheet, coefficients: FloatArray) -> FloatArray:
    """Return r, r', r'', z, z', z'' at the Gauss points: (variable, point)."""
    local = sheet.line.local
    cell = np.repeat(np.arange(sheet.line.size - 2), 2)[:, None] + np.arange(3)
    return np.einsum("qda,qac->cdq", local, coefficients[cell]).reshape(6, -1)


def _strained(sheet: RoundSheet, y: list[Jet], pressure_mpa: float) -> Jet:
    """Return the sheet's own energy and that of the pressure, per undeformed area."""
    p, p1, p2, z, z1, z2 = y
    s, h = sheet.line.points_mm, sheet.thickness_mm
    squared1 = p1 * p1 + z1 * z1
    j = squared1**0.5
    k1 = (p1 * z2 - z1 * p2) / (squared1 * j)
    bent1 = squared1 * k1 * k1
    if sheet.plane_strain:
        sum_of_squares, thin2 = squared1 + 1.0, squared1**-1
        t, q, v, swept = k1, k1 * k1, bent1, z * p1
    else:
        squared2 = (p * p) * s**-2
        k2 = z1 / (j * p)
        sum_of_squares, thin2 = squared1 + squared2, (squared1 * squared2) ** -1
        t, q, v = k1 + k2, k1 * k1 + k2 * k2, bent1 + squared2 * k2 * k2
        swept = z * p1 * p * s**-1
    membrane = (sum_of_squares + thin2 - 3) * (h / 2)
    bending = ((2 * t * t + q) * thin2 + v) * thin2 * (h**3 / 24)
    return (membrane + bending) * sheet.shear_modulus_mpa + swept * pressure_mpa


def _touched(sheet: RoundSheet, y: list[Jet], travel_mm: float, anchors: Anchors):
    """Return the contact's energy per undeformed area and the gap (point,) to the nearest part."""
    p, p1, _, z, z1, _ = y
    half = sheet.thickness_mm / 2
    raised = z + (half - travel_mm)
    thin = (p1 * p1 + z1 * z1) ** -0.5
    if not sheet.plane_strain:
        thin = thin * sheet.line.points_mm / p
    energy, gaps = p * 0.0, []
    for part in sheet.section:
        near = part(p.value, raised.value)
        gap = _composed(near, p, raised) - thin * half
        energy = energy + gap.through(*_law(sheet, gap.value))
        gaps.append(gap.value)
    slip = (p - anchors.x_mm) * anchors.tangent_x + (raised - anchors.z_mm) * anchors.tangent_z
    stiff = sheet.shear_modulus_mpa / (_SLIPPING_SHARE * sheet.thickness_mm)
    return energy + slip * slip * (0.5 * stiff * anchors.held), np.min(gaps, axis=0)


def _composed(near, x: Jet, z: Jet) -> Jet:
    """Return a signed distance as a function of what x and z depend on."""
    nx, nz, k = near.normal_x, near.normal_z, near.curvature_per_mm
    along = nz * x.slope - nx * z.slope
    return Jet(
        near.distance_mm,
        nx * x.slope + nz * z.slope,
        nx * x.bend + nz * z.bend + k * along[:, None] * along,
    )


def _law(sheet: RoundSheet, gap: FloatArray):
    """Return the potential of a gap and its two derivatives, per undeformed area."""
    plane_modulus = sheet.young_modulus_mpa / 0.75
    stiff = np.where(gap < 0, plane_modulus / (_COMPLIANT_SHARE * sheet.thickness_mm), 0.0)
    G, reach = sheet.tack_n_mm, sheet.tack_range_mm
    u = np.clip(gap / reach, 0, 1)
    value = 0.5 * stiff * gap**2 - G * (1 - u) ** 2 * (1 + 2 * u)
    near = (gap >= 0) & (gap < reach)
    second = stiff + np.where(near, 6 * G * (1 - 2 * u) / reach**2, 0.0)
    return value, stiff * gap + 6 * G * u * (1 - u) / reach, second


def _gathered(sheet: RoundSheet, slopes: FloatArray) -> FloatArray:
    """Return the gradient by the coefficients (2 n,) from that by the variables."""
    parts = np.einsum("qda,cdq->qac", sheet.line.local, slopes.reshape(2, 3, -1))
    return np.bincount(_numbers(sheet).ravel(), parts.ravel(), 2 * sheet.line.size)


def _numbers(sheet: RoundSheet) -> FloatArray:
    """Return (point, 6) coefficients that move each Gauss point, function by function."""
    first = np.repeat(np.arange(sheet.line.size - 2), 2)[:, None]
    return 2 * first + np.arange(6)


def _banded(sheet: RoundSheet, bend: FloatArray) -> FloatArray:
    """Return the tangent of the free unknowns in lower banded form."""
    local, points = sheet.line.local, bend.shape[0]
    operator = np.zeros((points, 2, 3, 3, 2))
    operator[:, 0, :, :, 0] = operator[:, 1, :, :, 1] = local
    operator = operator.reshape(points, 6, 6)
    blocks = np.swapaxes(operator, 1, 2) @ bend @ operator
    number = sheet.unknowns[_numbers(sheet)]
    row, column = np.broadcast_arrays(number[:, :, None], number[:, None])
    keep = (column >= 0) & (row >= column)
    size = sheet.unknowns.max() + 1
    flat = (row - column)[keep] * size + column[keep]
    return np.bincount(flat, blocks[keep], (_BAND + 1) * size).reshape(_BAND + 1, size)


def _solved(sheet, load, guess, start) -> Equilibrium | None:
    """Minimise the energy from a guess; None where Newton's method does not get there."""
    at = guess.copy()
    if sheet.lifted_end:
        at[0, 1] = load.lift_mm
    anchors = start.anchors
    here = _assemble(sheet, load, at, anchors)
    for iteration in range(_MOST_ITERATIONS):
        move, falls = _newton_move(sheet, here)
        share = min(1.0, _LARGEST_MOVE_MM / np.abs(move).max())
        there = _assemble(sheet, load, at + share * move, anchors)
        while not there.energy <= here.energy - 1e-4 * share * falls + _noise(here):
            share /= 2
            if share < 1e-6:
                return None
            there = _assemble(sheet, load, at + share * move, anchors)
        at, here = at + share * move, there
        if share * np.abs(move).max() < _TOLERANCE_MM:
            return replace(_balanced(sheet, load, at, anchors), iterations=iteration + 1)
    return None


_MOST_ITERATIONS = 80
_LARGEST_MOVE_MM = 0.3


def _noise(here: _Assembled) -> float:
    """Return what rounding makes of the energy's differences."""
    return 1e-12 * abs(here.energy) + 1e-18


def _newton_move(sheet: RoundSheet, here: _Assembled):
    """Return the move of the coefficients (n, 2) and how fast the energy falls along it."""
    unknowns = sheet.unknowns
    free = unknowns >= 0
    slope = np.bincount(unknowns[free], here.gradient[free], unknowns.max() + 1)
    move = -cho_solve_banded((_factor(sheet, here.bend), True), slope)
    full = np.where(free, move[unknowns], 0.0).reshape(-1, 2)
    return full, -float(slope @ move)


def _factor(sheet: RoundSheet, bend: FloatArray) -> FloatArray:
    """Factor the exact tangent, or where it is indefinite its nearest convex likeness."""
    try:
        return cholesky_banded(_banded(sheet, bend), lower=True)
    except LinAlgError:
        value, vector = np.linalg.eigh(bend)
        convex = (vector * np.maximum(value, 0)[:, None]) @ np.swapaxes(vector, 1, 2)
        matrix = _banded(sheet, convex)
        matrix[0] *= 1 + 1e-7
        return cholesky_banded(matrix, lower=True)


def _balanced(sheet, load, coefficients, anchors) -> Equilibrium:
    found = _assemble(sheet, load, coefficients, anchors)
    return Equilibrium(
        load, coefficients, anchors, found.gap_mm, found.force, found.gradient[1], found.energy
    )


def _grip(sheet: RoundSheet, found: Equilibrium) -> Equilibrium:
    """Anchor what has newly touched at its nearest point, release what has left.

    A new anchor has neither energy nor force: the sheet stays in balance.
    """
    if not sheet.stick:
        return found
    reach = sheet.tack_range_mm if sheet.tack_n_mm else 0.0
    x, z = _spread(sheet, found.coefficients_mm)[[0, 3]]
    raised = z + sheet.thickness_mm / 2 - found.load.travel_mm
    near = [part(x, raised) for part in sheet.section]
    nearest = np.argmin([part.distance_mm for part in near], axis=0)
    nx, nz, distance = (
        np.choose(nearest, [getattr(part, name) for part in near])
        for name in ("normal_x", "normal_z", "distance_mm")
    )
    old, new = found.anchors, ~found.anchors.held & (found.gap_mm < 0.5 * reach)
    held = new | (old.held & (found.gap_mm < reach))
    anchors = Anchors(
        held,
        np.where(new, x - distance * nx, old.x_mm),
        np.where(new, raised - distance * nz, old.z_mm),
        np.where(new, nz, old.tangent_x),
        np.where(new, -nx, old.tangent_z),
    )
    return replace(found, anchors=anchors)
