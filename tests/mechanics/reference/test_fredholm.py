"""The semi-analytic ball on a layer: its own limits, and the spectral layer against it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.oracles.fredholm import LayerBase, layer_compliance, press_ball
from twin.mechanics import PressError, SolverError
from twin.mechanics.contact import solve_contact
from twin.mechanics.control import DepthControl
from twin.mechanics.layer import BondedLayer
from twin.mechanics.transfer import solve_transfer

RADIUS, THICKNESS = 4.0, 4.0


def hertz_force(radius: float, depth: float, nu: float) -> float:
    return 4 / 3 / (1 - nu**2) * np.sqrt(radius) * depth**1.5


@given(nu=st.floats(0.1, 0.5), depth=st.floats(0.05, 1.0))
@settings(max_examples=8)
def test_paraboloid_on_a_half_space_is_hertz(nu: float, depth: float) -> None:
    ball = press_ball(RADIUS, depth, THICKNESS, nu, base="half_space", profile="paraboloid")
    assert ball.contact_radius_mm == pytest.approx(np.sqrt(RADIUS * depth), rel=1e-9)
    force = hertz_force(RADIUS, depth, nu)
    assert ball.force_over_modulus_mm2 == pytest.approx(force, rel=1e-9)
    peak = 1.5 * force / (np.pi * ball.contact_radius_mm**2)
    assert ball.pressure_over_modulus(np.zeros(1))[0] == pytest.approx(peak, rel=1e-7)


def test_sphere_on_a_half_space_is_sneddon() -> None:
    ball = press_ball(RADIUS, 1.5, THICKNESS, 0.49, base="half_space")
    a, R = ball.contact_radius_mm, RADIUS
    assert a * np.arctanh(a / R) == pytest.approx(1.5, rel=1e-9)
    force = ((a**2 + R**2) * np.arctanh(a / R) - a * R) / (1 - 0.49**2)
    assert ball.force_over_modulus_mm2 == pytest.approx(force, rel=1e-9)


def test_a_thick_layer_is_a_half_space() -> None:
    thick = press_ball(RADIUS, 0.1, 1e4, 0.49).force_over_modulus_mm2
    half_space = press_ball(RADIUS, 0.1, 1.0, 0.49, base="half_space").force_over_modulus_mm2
    assert thick == pytest.approx(half_space, rel=1e-3)


@pytest.mark.parametrize(
    ("chi", "nu", "ratio"),
    [
        (0.1, 0.4999, 1.12905),
        (0.4, 0.4999, 1.80107),
        (1.0, 0.4999, 5.11186),
        (0.4, 0.49, 1.77396),
        (1.0, 0.49, 4.79795),
    ],
)
def test_force_over_hertz_is_the_independent_prototype(chi: float, nu: float, ratio: float) -> None:
    """Ratios of an independent earlier implementation of our own."""
    depth = (chi * THICKNESS) ** 2 / RADIUS
    ball = press_ball(RADIUS, depth, THICKNESS, nu, profile="paraboloid")
    result = ball.force_over_modulus_mm2 / hertz_force(RADIUS, depth, nu)
    assert result == pytest.approx(ratio, rel=1e-5)


@pytest.mark.parametrize("base", ["bonded", "slip"])
def test_the_face_is_the_ball_within_the_contact_and_pressure_carries_the_force(
    base: LayerBase,
) -> None:
    ball = press_ball(RADIUS, 0.6, THICKNESS, 0.49, base=base)
    r = np.linspace(0, ball.contact_radius_mm, 3001)
    on_ball = 0.6 - (RADIUS - np.sqrt(RADIUS**2 - r**2))
    np.testing.assert_allclose(ball.deflection_mm(r), on_ball, atol=1e-7)
    force = np.trapezoid(2 * np.pi * r * ball.pressure_over_modulus(r), r)
    assert ball.force_over_modulus_mm2 == pytest.approx(force, rel=1e-4)
    outside = np.linspace(1.01, 1.2, 20) * ball.contact_radius_mm
    gap = ball.deflection_mm(outside) - (0.6 - RADIUS + np.sqrt(RADIUS**2 - outside**2))
    assert (gap > 0).all()


@pytest.mark.parametrize("nu", [0.3, 0.45, 0.49, 0.5])
def test_the_transfer_solve_is_the_closed_form(nu: float) -> None:
    q = np.geomspace(0.01, 30, 200)
    solved = solve_transfer(q, nu, "bonded").normal_t
    np.testing.assert_allclose(solved, layer_compliance(q, nu, "bonded"), rtol=1e-6)


@pytest.mark.parametrize("nu", [0.45, 0.49, 0.4999])
@pytest.mark.parametrize(("chi", "cells"), [(0.1, 512), (0.3, 320), (1.0, 320)])
def test_spectral_layer_is_the_fredholm_solution(chi: float, cells: int, nu: float) -> None:
    """Ball of 10 thicknesses: force to 0.3 %, face to 1 % of the depth.

    The window ends four thicknesses beyond the contact: its periodic images press along. With
    three the force errs by 0.37 % at chi = 1.
    """
    radius, thickness = 40.0, 4.0
    depth = (chi * thickness) ** 2 / radius
    truth = press_ball(radius, depth, thickness, nu)
    width = 2 * (truth.contact_radius_mm + 4 * thickness)
    layer = BondedLayer(cells, cells, width, width, thickness, nu)
    height = radius - np.sqrt(radius**2 - layer.x_mm**2 - layer.y_mm[:, None] ** 2)
    contact = solve_contact(layer.deflect, height, DepthControl(depth))
    force = float(contact.pressure.sum()) * layer.cell_area_mm2
    assert force == pytest.approx(truth.force_over_modulus_mm2, rel=3e-3)
    r = np.hypot(layer.x_mm, layer.y_mm[cells // 2])
    face = contact.deflection_mm[cells // 2]
    near = r < truth.contact_radius_mm + thickness
    np.testing.assert_allclose(face[near], truth.deflection_mm(r[near]), atol=0.01 * depth)


def test_wrong_lengths_and_too_deep_a_press_are_one_line() -> None:
    with pytest.raises(PressError, match="must be positive"):
        press_ball(RADIUS, -1.0, THICKNESS, 0.49)
    with pytest.raises(SolverError, match="no contact radius") as caught:
        press_ball(0.5, 5.0, 50.0, 0.49)
    assert "\n" not in str(caught.value)
