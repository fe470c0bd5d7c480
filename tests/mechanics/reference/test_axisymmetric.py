"""Large strain, axisymmetric: consistency, its small-strain limit, and the linear slab against it.

Stored figures are from `generate_neo_hookean.py` (full size); the presses here are coarse.
"""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.oracles.axisymmetric import (
    AxisymmetricPress,
    Resolution,
    RoundSlab,
    press_axisymmetric,
)
from tests.oracles.ball_contact import BallContact
from tests.oracles.fredholm import press_ball
from tests.oracles.round_grid import RoundGrid
from twin.mechanics import PressError
from twin.mechanics.contact import solve_contact
from twin.mechanics.control import DepthControl
from twin.mechanics.layer import BondedLayer
from twin.mechanics.reference.grid import ElementGrid
from twin.mechanics.reference.mixed import Material, MixedBody, linear, moduli, neo_hookean

Field = NDArray[np.float64]

BONDED = RoundSlab(4.0, 28.0, 0.49, "bonded")
COARSE = Resolution(radial=24, axial=6)
RECTANGLES = (np.array([0.0, 0.5, 1.2, 1.5]), np.array([0.0, 0.4, 1.0]))
BRICKS = (np.array([0.0, 0.5]), np.array([0.0, 0.4, 1.0]), np.array([0.0, 0.3, 0.7]))


def grid_of(edges: tuple[Field, ...]) -> ElementGrid:
    return RoundGrid(edges) if len(edges) == 2 else ElementGrid(edges)


def stored(name: str) -> dict[str, Any]:
    text = Path(__file__).with_name("neo_hookean.json").read_text()
    case: dict[str, Any] = json.loads(text)[name]
    return case


@pytest.fixture(scope="module")
def coarse() -> AxisymmetricPress:
    return press_axisymmetric(BONDED, 4.0, 1.0, resolution=COARSE)


@pytest.mark.parametrize("edges", [RECTANGLES, BRICKS])
@pytest.mark.parametrize("material", [neo_hookean, linear])
def test_the_tangent_is_the_residuals_derivative(
    edges: tuple[Field, ...], material: Material
) -> None:
    body = MixedBody(grid_of(edges), material, moduli(0.49))
    state, direction = np.random.default_rng(0).normal(size=(2, body.unknowns)) * 0.02
    if body.grid.axes == 2:  # the nodes on the axis remain on it
        for vector in (state, direction):
            body.displacement_mm(vector)[body.grid.nodes_mm[:, 0] == 0, 0] = 0
    step = 1e-4
    ahead, behind = (body.assemble(state + sign * step * direction)[0] for sign in (1, -1))
    expected = (ahead - behind) / (2 * step)
    tangent = body.assemble(state)[1]
    np.testing.assert_allclose(tangent @ direction, expected, atol=1e-6 * abs(expected).max())
    assert abs(tangent - tangent.T).max() < 1e-12


@pytest.mark.parametrize("edges", [RECTANGLES, BRICKS])
@pytest.mark.parametrize("material", [neo_hookean, linear])
def test_patch_of_uniform_strain_is_in_equilibrium(
    edges: tuple[Field, ...], material: Material
) -> None:
    grid = grid_of(edges)
    body = MixedBody(grid, material, moduli(0.45))
    stretch = np.array([0.1, 0.1, -0.15] if grid.axes == 3 else [0.1, -0.15])
    three = np.eye(3) + np.diag([0.1, 0.1, -0.15] if grid.axes == 3 else [0.1, -0.15, 0.1])
    volume = np.linalg.det(three) - 1 if material is neo_hookean else np.trace(three) - 3
    state = np.full(body.unknowns, volume * body.moduli.bulk)
    state[: body.displacements] = (grid.nodes_mm * stretch).ravel()
    residual = body.assemble(state)[0]
    low, high = grid.nodes_mm.min(axis=0), grid.nodes_mm.max(axis=0)
    inside = ((grid.nodes_mm > low) & (grid.nodes_mm < high)).all(axis=1)
    forces = residual[: body.displacements].reshape(-1, grid.axes)
    assert abs(forces[inside]).max() < 1e-14
    assert abs(forces).max() > 1e-3
    assert abs(residual[body.displacements :]).max() < 1e-14


@pytest.mark.parametrize("friction", [0.0, 0.3, math.inf])
def test_contact_stiffness_is_the_forces_derivative(friction: float) -> None:
    grid = RoundGrid((np.linspace(0, 2, 5), np.array([0.0, 1.0])))
    surface = grid.surface(5)
    rest = np.zeros_like(surface.weight_mm2)
    contact = BallContact(surface, grid.nodes_mm, 4.0, 50.0, friction, False, rest, rest, rest)
    contact = contact.settle(np.zeros_like(grid.nodes_mm), 0.1).carry(rest + 1.0)
    moved, along = np.random.default_rng(1).normal(size=(2, *grid.nodes_mm.shape)) * 1e-2
    active = contact.evaluate(moved, 0.3, None).active
    ahead, behind = (
        contact.evaluate(moved + sign * 1e-5 * along, 0.3, active).force for sign in (1, -1)
    )
    expected = -(ahead - behind) / 2e-5
    result = contact.evaluate(moved, 0.3, active).stiffness @ along.ravel()
    np.testing.assert_allclose(result, expected, atol=1e-5 * abs(expected).max())


def test_small_strain_mode_is_the_fredholm_solution() -> None:
    """R 4, h 4, d 1: force 1e-3, face 1 um."""
    pressed = press_axisymmetric(BONDED, 4.0, 1.0, linear=True, resolution=COARSE)
    truth = press_ball(4.0, 1.0, 4.0, 0.49)
    assert pressed.force_over_modulus_mm2 == pytest.approx(truth.force_over_modulus_mm2, rel=1e-3)
    assert pressed.contact_radius_mm == pytest.approx(truth.contact_radius_mm, abs=0.1)
    r = np.linspace(0, 10, 101)
    np.testing.assert_allclose(pressed.touched_face_mm(r), truth.deflection_mm(r), atol=4e-3)


def test_coarse_press_is_the_stored_one(coarse: AxisymmetricPress) -> None:
    """Notes' independent prototype: F / E = 6.8159."""
    case = stored("bonded_r4_h4_d1")
    assert case["force_over_modulus_mm2"] == pytest.approx(6.8159, rel=1e-4)
    assert coarse.force_over_modulus_mm2 == pytest.approx(case["force_over_modulus_mm2"], rel=2e-3)
    face = coarse.touched_face_mm(np.array(case["r_mm"]))
    np.testing.assert_allclose(face, case["touched_face_mm"], atol=6e-3)
    assert np.all(np.diff(coarse.path_force_over_modulus_mm2) > 0)


def test_linear_layer_against_large_strain() -> None:
    """R 4, h 4, d 1, bonded: force 3 %, face 5 um rms and 15 um at most within r = 10."""
    case = stored("bonded_r4_h4_d1")
    layer = BondedLayer(400, 400, 32.0, 32.0, 4.0, 0.49)
    r = np.hypot(layer.x_mm, layer.y_mm[:, None])
    height = np.where(r < 4, 4 - np.sqrt(np.maximum(16 - r**2, 0)), np.inf)
    contact = solve_contact(layer.deflect, height, DepthControl(1.0))
    force = float(contact.pressure.sum()) * layer.cell_area_mm2
    assert force == pytest.approx(case["force_over_modulus_mm2"], rel=0.03)
    near = r < 10
    truth = np.interp(r[near], case["r_mm"], case["touched_face_mm"])
    error = contact.deflection_mm[near] - truth

    assert np.sqrt(np.mean(error**2)) < 5e-3
    assert np.abs(error).max() < 15e-3


def test_sticking_stiffens_the_press_but_hardly_moves_the_face(coarse: AxisymmetricPress) -> None:
    """Notes: frictionless force 6.9 % below full stick, face within 6 um."""
    stuck = press_axisymmetric(BONDED, 4.0, 1.0, friction=math.inf, resolution=COARSE)
    ratio = coarse.force_over_modulus_mm2 / stuck.force_over_modulus_mm2
    assert ratio == pytest.approx(1 - 0.069, abs=0.005)
    r = np.linspace(0, 10, 201)
    np.testing.assert_allclose(stuck.touched_face_mm(r), coarse.touched_face_mm(r), atol=8e-3)


def test_pressure_carries_the_force(coarse: AxisymmetricPress) -> None:
    r, p = coarse.contact_r_mm, coarse.pressure_over_modulus
    # On the ball the normal is inclined: its component along the press is the cosine of the slope.
    force = np.trapezoid(2 * np.pi * np.append(0, r) * np.append(p[0], p), np.append(0, r))
    assert force == pytest.approx(coarse.force_over_modulus_mm2, rel=0.02)


def test_a_face_that_leaves_the_ball_inside_the_contact_is_spurious() -> None:
    grid = RoundGrid((np.linspace(0, 2, 9), np.array([0.0, 1.0])))
    surface = grid.surface(5)
    rest = np.zeros_like(surface.weight_mm2)
    contact = BallContact(surface, grid.nodes_mm, 4.0, 50.0, 0.0, False, rest, rest, rest)
    r, z = grid.nodes_mm.T
    moved = np.zeros_like(grid.nodes_mm)
    moved[:, 1] = np.where(z == 0, 0.3 - (4 - np.sqrt(16 - r**2)), 0.0)
    moved[:, 1] -= np.where(r > 1, 0.1, 1e-5)
    assert not contact.is_spurious(moved, 0.3)
    moved[:, 1] += np.where((r > 0.4) & (r < 0.8), 0.05, 0.0)
    assert contact.is_spurious(moved, 0.3)


@pytest.mark.parametrize(
    ("slab", "radius_mm", "depth_mm", "options", "message"),
    [
        (BONDED, 4.0, 4.5, {}, "between 0 and the thickness"),
        (BONDED, 40.0, 1.0, {}, "smaller than the slab"),
        (RoundSlab(4, 28, 0.5, "bonded"), 4.0, 1.0, {}, "0 < nu < 0.5"),
        (BONDED, 4.0, 1.0, {"linear": True, "friction": 0.5}, "frictionless"),
        (RoundSlab(4, 10, 0.49, "ledge"), 4.0, 1.0, {}, "ledge of 0 mm"),
    ],
)
def test_impossible_presses_are_refused_in_one_line(
    slab: RoundSlab, radius_mm: float, depth_mm: float, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(PressError, match=message) as caught:
        press_axisymmetric(slab, radius_mm, depth_mm, **options)
    assert "\n" not in str(caught.value)
