"""The thin sheet against derivatives, closed forms, its twin in one dimension, and solids."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq, minimize

from tests.mechanics.sheets import (
    EXACT,
    FINE,
    NOTHING,
    YOUNG_KPA,
    ball,
    bar,
    build_sheet,
    finer_at_the_rim,
    laws,
    line,
    pressed,
    rod,
    round_sheet,
    strip,
)
from tests.oracles.round_sheet import (
    Profile,
    bar_section,
    round_sheet_profile,
    strip_sheet_profile,
)
from twin.config.models import Mechanics, Press
from twin.mechanics import press
from twin.mechanics.sheet.case import sheet_case
from twin.mechanics.sheet.energy import Bodies, Sheet, SheetState
from twin.mechanics.sheet.equilibrium import settle
from twin.mechanics.sheet.faces import sample
from twin.mechanics.sheet.grid import Frame, sheet_grid
from twin.mechanics.sheet.kernel import SLOTS
from twin.mechanics.sheet.laws import Grip
from twin.mechanics.sheet.path import Loads, advance, follow, mounted
from twin.mechanics.sheet.result import contact_force_n
from twin.mechanics.sheet.thickness import SheetThickness
from twin.shape import SignedDistance
from twin.specimens.kinds.ball import Ball

SOLIDS = json.loads((Path(__file__).parent / "reference/solid_sheets.json").read_text())


# ---- derivatives -----------------------------------------------------------------------------


def everything_at_once(wedge: float = 0.0, **frame: float) -> tuple[Sheet, SheetState]:
    """A round, pre-stretched, heavy sheet under pressure on a tacky ball, half of it stuck.

    With `wedge`, mm per mm, its thickness increases along x.
    """
    law = laws(0.3, tack=0.2, tack_range_mm=0.3, weight_kpa=0.05)
    sheet = round_sheet(law, ball(), line(5.0, 1.5, 0.5), pre_stretch=1.1, **frame)
    sheet.grid = sheet.grid.with_thickness(
        SheetThickness(None, (wedge, 0.0), None) if wedge else None
    )
    result = follow(sheet, Loads(0.6, 1.0), EXACT)
    random = np.random.default_rng(3)
    points = sheet.grid.rest.area_mm2.shape
    normal = random.normal(size=(*points, 3))
    grip = Grip(
        (random.uniform(size=points) < 0.5).astype(float),
        random.normal(size=(*points, 3)),
        normal / np.linalg.norm(normal, axis=-1, keepdims=True),
        random.choice([np.inf, 100.0], size=points),
    )
    return sheet, replace(result, grip=grip)


def times_tangent(sheet: Sheet, along: np.ndarray) -> np.ndarray:
    """Multiply by the tangent of the last evaluation, of which only the upper half is stored."""
    rows, cols = along.shape[:2]
    product = np.zeros((rows + 4, cols + 4, 3))
    wide = np.pad(along, ((2, 2), (2, 2), (0, 0)))
    for slot, (b, a) in enumerate(SLOTS):
        block = sheet._tangent[:, :, slot]
        shifted = np.s_[2 + b : 2 + b + rows, 2 + a : 2 + a + cols]
        product[2:-2, 2:-2] += np.einsum("jikl,jil->jik", block, wide[shifted])
        if slot:
            product[shifted] += np.einsum("jikl,jik->jil", block, along)
    return product[2:-2, 2:-2]


@pytest.mark.parametrize(("rim_compliance", "wedge"), [(0.0, 0.0), (4.0, 0.02)])
def test_forces_and_tangent_are_the_energys_derivatives(
    rim_compliance: float, wedge: float
) -> None:
    sheet, state = everything_at_once(wedge, rim_compliance_mm2_per_n=rim_compliance)
    random = np.random.default_rng(4)
    off, way = random.normal(scale=1e-3, size=(2, *state.control_mm.shape)) * sheet.grid.free

    def at(step: float) -> tuple[float, np.ndarray, np.ndarray]:
        now = sheet.evaluate(state.control_mm + off + step * way, state, tangent=True)
        touch = sheet.touch(now.surface[..., 0, :], state.travel_mm)
        return now.energy, sheet._forces.copy(), sheet.gap_mm(now.surface, touch)[0]

    def derivative(part: int) -> np.ndarray:
        near, far = (np.asarray(at(s)[part]) - at(-s)[part] for s in (0.01, 0.02))
        return (8 * near - far) / (12 * 0.01)

    slope, forces = derivative(0), derivative(1)
    gap = at(0)[2]
    assert (gap < 0).sum() > 20 < ((gap > 0) & (gap < 0.3)).sum()
    assert all((np.signbit(at(s)[2]) == np.signbit(gap)).all() for s in (-0.02, 0.02))
    _, gradient, _ = at(0)
    assert slope == pytest.approx(float((gradient * way).sum()), rel=1e-8)
    np.testing.assert_allclose(
        times_tangent(sheet, way)[sheet.grid.free],
        forces[sheet.grid.free],
        atol=1e-8 * np.abs(forces).max(),
    )


@dataclass(frozen=True)
class Steeper:
    """A distance as tables between their nodes give it: its gradient is not quite 1 long."""

    true: SignedDistance

    def evaluate(self, points_mm: np.ndarray, reach_mm: float) -> tuple:
        return tuple(1.05 * part for part in self.true.evaluate(points_mm, reach_mm))


def test_anchors_on_a_steeper_distance_have_a_true_energy() -> None:
    """Forces of springs along the surface are the energy's slope for unit normals only."""
    steeper = Bodies((Steeper(ball().moving[0]),))
    sheet = round_sheet(laws(0.3, tack=0.2, tack_range_mm=0.3), steeper, line(5.0, 1.5, 0.5), True)
    state = sheet.regripped(follow(sheet, Loads(0.2), FINE))
    way = np.random.default_rng(6).normal(size=state.control_mm.shape) * sheet.grid.free
    moved = replace(state, control_mm=state.control_mm + 1e-2 * way)
    ends = [
        sheet.evaluate(moved.control_mm + s * way, state, tangent=False).energy
        for s in (1e-6, -1e-6)
    ]
    sheet.evaluate(moved.control_mm, state, tangent=False)
    assert state.grip.held.sum() > 20
    slope = float((sheet._forces * way).sum())
    assert (ends[0] - ends[1]) / 2e-6 == pytest.approx(slope, rel=1e-5)


def test_pressure_follows_the_surface() -> None:
    """The forces of 1 kPa do the work of p times the area's normal on any displacement."""
    grid = sheet_grid(Frame(10.0, 8.0), line(5.0, 5.0, 0.25), line(4.0, 4.0, 0.25))
    sheet = Sheet(grid, laws(0.3), NOTHING, -0.15)
    x, y = np.meshgrid(grid.x.greville / 5, grid.y.greville / 4)
    rim = ((1 - x**2) * (1 - y**2))[..., None]
    control = grid.mounted_mm + rim * np.stack((0.4 * y, 0.3 * x * y, 1.5 + x), axis=-1)
    way = np.where(grid.free, rim * np.stack((y, x**2, 1 + x * y), axis=-1), 0.0)
    forces = []
    for pressure in (0.0, 1.0):
        sheet.evaluate(control, replace(mounted(grid), pressure_kpa=pressure), tangent=False)
        forces.append(sheet._forces.copy())
    surface, moved = sheet.surface(control), sheet.surface(way)[..., 0, :]
    across = np.cross(surface[..., 1, :], surface[..., 2, :])
    work = float(((across * moved).sum(axis=-1) * grid.rest.area_mm2).sum())
    assert float(((forces[1] - forces[0]) * way).sum()) == pytest.approx(work, rel=1e-3)


# ---- closed forms ----------------------------------------------------------------------------


@pytest.mark.parametrize(("rim", "factor"), [("clamped", 1.0), ("simple", 5.5 / 1.5)])
def test_a_little_pressure_bends_a_round_sheet_as_a_plate(rim: str, factor: float) -> None:
    """p a^4 / (64 D), and (5 + nu) / (1 + nu) of it on a simple rim."""
    sheet = round_sheet(laws(0.5), NOTHING, finer_at_the_rim(line(5.0, 2.5, 0.5), 0.05), rim=rim)
    pressure = 1e-3 * 64 * (YOUNG_KPA * 0.5**3 / 9) / 5.0**4
    result = settle(sheet, replace(mounted(sheet.grid), pressure_kpa=pressure), EXACT)
    middle = sheet.grid.evaluate(result.control_mm, np.zeros(1), np.zeros(1))[0][0, 0, 2]
    assert -middle == pytest.approx(1e-3 * factor, rel=0.01)


@pytest.mark.parametrize(("rim", "coefficient"), [("simple", 0.00406235), ("clamped", 0.00126532)])
def test_a_little_pressure_bends_a_square_sheet_as_a_plate(rim: str, coefficient: float) -> None:
    """Navier's series, and Timoshenko's table for the clamped square: w = c p a^4 / D."""
    places = finer_at_the_rim(line(5.0, 2.5, 0.5), 0.05)
    sheet = Sheet(sheet_grid(Frame(10.0, 10.0, rim=rim), places, places), laws(0.5), NOTHING, -0.25)
    pressure = 1e-3 * (YOUNG_KPA * 0.5**3 / 9) / 10.0**4 / coefficient
    result = settle(sheet, replace(mounted(sheet.grid), pressure_kpa=pressure), EXACT)
    middle = sheet.grid.evaluate(result.control_mm, np.zeros(1), np.zeros(1))[0][0, 0, 2]
    assert -middle == pytest.approx(1e-3, rel=0.01)


def test_a_light_touch_bends_it_as_the_spectral_plate() -> None:
    """Travel h / 100. At the ball the two yield differently: faces per force."""
    elastomer, light = build_sheet(poisson_ratio=0.4999), {"depth_mm": 0.003}
    sheet = pressed(Ball(), elastomer, "simple", **light)
    load = Press(control="depth", relief_pitch_mm=0.05, solver_pitch_mm=0.02, **light)
    plate = press(Ball(), elastomer, load)
    near = plate.face_z_mm > 0.01 * plate.face_z_mm.max()
    ratio = (sheet.face_z_mm / sheet.force_n)[near] / (plate.face_z_mm / plate.force_n)[near]
    assert np.abs(ratio - 1).max() < 0.01


@pytest.mark.parametrize("pressure_kpa", [0.3, -1.0])
def test_an_inflated_strip_is_an_arc_of_a_neo_hookean_membrane(pressure_kpa: float) -> None:
    """Half angle a: stretch a / sin a, tension mu h (l - l^-3) = |p| R, R = rim / sin a."""
    h, mu = 0.05, YOUNG_KPA / 3

    def tension_left(angle: float) -> float:
        stretch = angle / np.sin(angle)
        return mu * h * (stretch - stretch**-3) - abs(pressure_kpa) * 10.0 / np.sin(angle)

    rise = 10.0 * np.tan(brentq(tension_left, 1e-3, 3.0) / 2)
    sheet = strip(laws(h), NOTHING, line(10.0, 8.0, 0.5), rim="simple")
    start = mounted(sheet.grid)
    result, _ = advance(sheet, start, start, Loads(0.0, pressure_kpa), EXACT)
    middle = sheet.grid.evaluate(result.control_mm, np.zeros(1), np.zeros(1))[0][0, 0, 2]
    assert middle == pytest.approx(-np.sign(pressure_kpa) * rise, rel=1e-3)


def test_tack_wraps_a_rod_to_the_least_energy() -> None:
    """G as the peeling edge shows it, within 3 %: least energy of a frictionless membrane.

    Of its half length `rim`, `held` (undeformed) is on the rod from the crest to the angle a;
    the rest is straight. Adhesion counts per undeformed area, so that the held part is the less
    stretched one: T1 = T2 cos at the edge. G follows from the stretch of the straight part.
    """
    rim, rise, h, G = 6.0, 1.5, 0.05, 0.2
    radius = 4.0 + h / 2

    def stretches(angle: float, held: float) -> tuple[float, float]:
        x, fall = radius * np.sin(angle), radius * (1 - np.cos(angle))
        return radius * angle / held, float(np.hypot(rim - x, rise - fall)) / (rim - held)

    def energy(at: np.ndarray, adhesion: float) -> float:
        on, off = (YOUNG_KPA / 6 * h * (s**2 + s**-2 - 2) for s in stretches(*at))
        return float((on - adhesion) * at[1] + off * (rim - at[1]))

    def stretched_by(adhesion: float) -> float:
        tight = {"xatol": 1e-8, "fatol": 1e-12}
        result = minimize(
            energy, (0.4, 1.55), args=(adhesion,), method="Nelder-Mead", options=tight
        )
        return stretches(*result.x)[1]

    sheet = strip(laws(h, tack=G, tack_range_mm=0.08), rod(4.0), line(rim, 2.5, 0.04))
    state = follow(sheet, Loads(rise), FINE)
    flat = sample(sheet, state, 0.1)
    straight = (np.abs(flat.middle_mm[3, :, 0]) > 3.5) & (np.abs(flat.middle_mm[3, :, 0]) < 5.0)
    measured = flat.stretch[3, straight, 0]
    assert np.ptp(measured) < 2e-4
    apparent = brentq(lambda g: stretched_by(g) - measured.mean(), 0.3 * G, 3 * G)
    assert apparent == pytest.approx(G, rel=0.03)


@pytest.mark.parametrize(
    "options", [{}, {"tack": 0.2}, {"sticks": True}, {"tack": 0.2, "sticks": True}]
)
def test_the_force_is_what_the_path_adds_to_the_energy(options: dict) -> None:
    sticks = options.pop("sticks", False)
    law = laws(0.3, **options)
    sheet = strip(law, bar(4.0, 0.9), line(6.0, 3.0, 0.1), sticks)
    middle = follow(sheet, Loads(0.6), EXACT)
    force = contact_force_n(sheet, middle)
    ends = []
    for step in (-1e-4, 1e-4):
        moved = settle(sheet, replace(middle, travel_mm=0.6 + step), EXACT)
        moved = replace(moved, grip=middle.grip)  # points released since have lost their energy
        ends.append(sheet.evaluate(moved.control_mm, moved, tangent=False).energy)
    assert 1e3 * force == pytest.approx((ends[1] - ends[0]) / 2e-4, rel=1e-3)


def test_a_round_sheet_has_the_discs_area() -> None:
    area = sheet_grid(Frame(20.0, 20.0, "round"), *2 * [line(10.0, 3.0, 0.25)]).rest.area_mm2.sum()
    assert area == pytest.approx(np.pi * 100.0, rel=1e-6)


def test_a_mounted_sheet_is_as_stretched_as_its_frame_says() -> None:
    sheet = round_sheet(laws(0.3), NOTHING, line(4.0, 2.0, 0.5), pre_stretch=1.25)
    result = settle(sheet, mounted(sheet.grid), EXACT)
    flat = sample(sheet, result, 0.2)
    inside = np.s_[1:-1, 1:-1]  # the disc's map is singular in the square's corners
    np.testing.assert_allclose(flat.stretch[inside], 1.25, rtol=1e-7)
    np.testing.assert_allclose(flat.thickness_mm[inside], 0.3 / 1.25**2, rtol=1e-7)
    np.testing.assert_allclose(flat.upper_mm[inside][..., 2], 0.15 / 1.25**2, rtol=1e-7)
    assert np.abs(flat.middle_mm[..., 0]).max() == pytest.approx(5.0, abs=1e-4)


@pytest.mark.parametrize(("gravity_deg", "way"), [(0.0, -1), (180.0, 1)])
def test_weight_hangs_down(gravity_deg: float, way: int) -> None:
    """0: the camera is above and the coat sags away from it, by that of a clamped plate."""
    elastomer = build_sheet(density_kg_m3=1000.0, thickness_mm=1.0, outline="round")
    load = Press(control="depth", depth_mm=0.1, gravity_deg=gravity_deg)
    case = sheet_case(Ball(), elastomer, load, Mechanics(model="sheet"))
    sheet = round_sheet(case.laws, NOTHING, finer_at_the_rim(line(10.0, 5.0, 1.0), 0.1))
    result = settle(sheet, mounted(sheet.grid), EXACT)
    middle = sheet.grid.evaluate(result.control_mm, np.zeros(1), np.zeros(1))[0][0, 0, 2]
    plate = 1e-6 * 1000 * 9.80665 * 1.0 * 10.0**4 / (64 * YOUNG_KPA / 9)
    assert middle == pytest.approx(way * plate, rel=0.01)


# ---- its twin in one dimension ---------------------------------------------------------------


def off_the_profile_um(sheet: Sheet, state: SheetState, along: Profile, half_mm: float) -> float:
    """Return the upper face's largest distance in z from its twin's."""
    upper = sample(sheet, state, 0.05).upper_mm
    # The parameter square's corners are on the round rim, where its map is singular.
    across = upper[1:-1, 1:-1] if sheet.grid.frame.outline == "round" else upper[3:4]
    r = np.hypot(across[..., 0], across[..., 1] if sheet.grid.frame.outline == "round" else 0.0)
    twin = CubicSpline(along.radius_mm, along.upper_z_mm)(r) + sheet.laws.thickness_mm / 2
    return 1e3 * float(np.abs(across[..., 2] - twin)[r < half_mm].max())


@pytest.mark.parametrize(("pressure_kpa", "stick"), [(0.0, False), (0.0, True), (1.0, False)])
def test_the_round_sheet_is_its_axisymmetric_twin(pressure_kpa: float, stick: bool) -> None:
    sheet = round_sheet(laws(0.3), ball(), finer_at_the_rim(line(3.0, 3.0, 0.2), 0.05), stick)
    result = follow(sheet, Loads(0.4, pressure_kpa), FINE)
    twin = round_sheet_profile(
        4.0, 0.3, YOUNG_KPA, 3.0, 0.4, pressure_kpa=pressure_kpa, stick=stick, fine_mm=3.0,
        pitch_mm=0.025, step_mm=0.2,
    )  # fmt: skip
    assert off_the_profile_um(sheet, result, twin, 3.0) < 0.5
    held = 1e-3 * pressure_kpa * np.pi * 3.0**2
    assert contact_force_n(sheet, result) == pytest.approx(twin.force_n, rel=5e-3, abs=5e-3 * held)


@pytest.mark.parametrize(("pressure_kpa", "stick"), [(0.0, False), (0.0, True), (1.0, False)])
def test_the_strip_is_its_plane_strain_twin(pressure_kpa: float, stick: bool) -> None:
    sheet = strip(laws(0.2), bar(4.0, 0.3), finer_at_the_rim(line(10.0, 10.0, 0.05), 0.03), stick)
    result = follow(sheet, Loads(1.0, pressure_kpa), EXACT)
    twin = strip_sheet_profile(
        bar_section(4.0, 0.3), 0.2, YOUNG_KPA, 10.0, 1.0, pressure_kpa=pressure_kpa, stick=stick,
        pitch_mm=0.025, fine_mm=10.0, step_mm=0.2,
    )  # fmt: skip
    assert off_the_profile_um(sheet, result, twin, 10.0) < 0.5


# ---- solids ----------------------------------------------------------------------------------


def solid_limits(thickness_mm: float, kind: str) -> tuple[float, float]:
    """Return largest error of the upper face in um and of the force, relative."""
    for upto, face_um, force in ((0.3, 3.0, 0.01), (0.5, 7.0, 0.015), (1.0, 20.0, 0.04)):
        if thickness_mm <= upto:
            return face_um, 0.01 if kind == "stick" and upto <= 0.5 else force
    raise ValueError(thickness_mm)


@pytest.mark.parametrize("name", ["free_h0.3", "stick_h0.5", "free_h1"])
def test_the_sheet_is_the_solid(name: str) -> None:
    """A ball of R 4 to a travel of 0.5 and 1 mm; 0.1, 0.2 and 2 mm: `./run bench sheet`."""
    case = SOLIDS[name]
    face_um, force = solid_limits(case["thickness_mm"], case["kind"])
    law = laws(case["thickness_mm"])
    sheet = round_sheet(law, ball(), line(10.0, 1.5, 0.25), case["kind"] == "stick")
    state = before = mounted(sheet.grid)
    for solid in case["travels"][:2]:
        for travel in np.linspace(state.travel_mm, solid["travel_mm"], 4)[1:]:
            state, before = advance(sheet, state, before, Loads(float(travel)), FINE)
        upper = sample(sheet, state, 0.1).upper_mm[1:-1, 1:-1]
        r, tabled = np.hypot(upper[..., 0], upper[..., 1]), 0.1 * np.arange(100)
        true = CubicSpline(tabled, solid["upper_z_mm"])(r) + law.thickness_mm / 2
        assert 1e3 * np.abs(upper[..., 2] - true)[r < tabled[-1]].max() < face_um
        result = contact_force_n(sheet, state) / (1e-3 * YOUNG_KPA)
        assert result == pytest.approx(solid["force"], rel=force)


def clamp_shear_um(case: dict, travel_mm: float, force: float) -> float:
    """Return how much lower a sheet without shear is next to its clamp.

    A strip under tension T with a flank of slope s turns into it over l = sqrt(B / T),
    B = mu h^3 / 3, and its flank starts by s l beyond the clamp. With shear, stiffness S = 5/6 mu h
    (Timoshenko), by s l sqrt(S / (S + T)).
    """
    h, mu = case["thickness_mm"], 1 / 3
    slope = travel_mm / (10.0 - 2.0)
    tension, shear = force / 2 / np.sin(np.arctan(slope)), 5 / 6 * mu * h
    turned = slope * np.sqrt(mu * h**3 / 3 / tension)
    return 1e3 * float(turned * (1 - np.sqrt(shear / (shear + tension))))


@pytest.mark.parametrize("name", ["bar_h0.2", "bar_h0.5"])
def test_the_strip_is_the_solid(name: str) -> None:
    """To 5 mm from the middle of 10; at 2 mm of travel shear counts at the clamp."""
    case = SOLIDS[name]
    law = laws(case["thickness_mm"])
    sheet = strip(law, bar(4.0, 0.3), line(10.0, 10.0, 0.05))
    on_the_way: list[SheetState] = []
    for solid in case["travels"]:
        travel = solid["travel_mm"]
        state = follow(sheet, Loads(travel), EXACT, on_the_way)
        upper = sample(sheet, state, 0.05).upper_mm[3]
        true = CubicSpline(0.1 * np.arange(100), solid["upper_z_mm"])(np.abs(upper[:, 0]))
        error_um = 1e3 * (upper[:, 2] - law.thickness_mm / 2 - true)
        limit_um, force = solid_limits(law.thickness_mm, "bar")
        from_middle = np.abs(upper[:, 0])
        assert np.abs(error_um)[from_middle < 5.0].max() < limit_um
        beside_um = max(limit_um, clamp_shear_um(case, travel, solid["force"]))
        assert np.abs(error_um)[from_middle < 9.9].max() < beside_um
        result = contact_force_n(sheet, state) / 3000.0 / (1e-3 * YOUNG_KPA)
        assert result == pytest.approx(solid["force"], rel=force)
