"""Sideways motion of the coat: closed forms of the plate and of a single wave, and its sign."""

import numpy as np
import pytest

from twin.config.models import Elastomer, Press
from twin.mechanics import in_plane_displacement, press
from twin.mechanics.layer import BondedLayer, FreeSlab
from twin.mechanics.transfer import solve_transfer
from twin.specimens.kinds.ball import Ball


def test_a_plate_turns_its_fibres() -> None:
    """Kirchhoff: the far face, half a thickness from the middle, moves by -h/2 grad w."""
    slab = FreeSlab(64, 64, 200.0, 200.0, 2.0, 0.3)
    wave = np.sin(np.pi * (slab.x_mm + 100) / 200)
    pressure = 1e-6 * np.outer(wave, wave)
    w = slab.opposite_at_nodes(pressure, 64, 64)
    u_x, u_y = slab.opposite_in_plane_at_nodes(pressure, 64, 64)
    x = np.linspace(-100, 100, 65)
    k = np.pi / 200
    slope = k * np.outer(np.sin(k * (x + 100)), np.cos(k * (x + 100))) * w.max()
    np.testing.assert_allclose(u_x, -slope, atol=2e-3 * slope.max())
    np.testing.assert_allclose(u_y, -slope.T, atol=2e-3 * slope.max())


def test_a_plate_is_bent_alike_from_either_side() -> None:
    """In a plate 100 times as long as thick, shear and squeezing are negligible to bending."""
    slab = FreeSlab(64, 64, 200.0, 200.0, 2.0, 0.3)
    nothing, uniform = np.zeros((64, 64)), np.full((64, 64), 1e-6)
    expected, _ = slab.opposite_in_plane_at_nodes(uniform, 64, 64)
    own, _ = slab.opposite_in_plane_at_nodes(nothing, 64, 64, uniform_load=1e-6)
    np.testing.assert_allclose(own, expected, atol=2e-3 * np.abs(expected).max())


@pytest.mark.parametrize("preload", [{"back_pressure_kpa": 2.0}, {"gravity_deg": 0.0}])
def test_a_preloaded_sheet_turns_its_fibres_too(preload: dict[str, float]) -> None:
    """Kirchhoff on a draped or sagging sheet: the coat moves by -h/2 times its own slope."""
    values = {"thickness_mm": 1, "length_x_mm": 24, "length_y_mm": 24, "young_modulus_kpa": 300}
    slab = Elastomer.model_validate(values | {"poisson_ratio": 0.3, "density_kg_m3": 1070})
    load = Press(
        control="depth", depth_mm=0.3, solver_pitch_mm=0.16, relief_pitch_mm=0.05, **preload
    )
    pressed = press(Ball(), slab, load)
    u_x, u_y = in_plane_displacement(pressed, slab, load)
    slope_y, slope_x = np.gradient(pressed.face_z_mm, pressed.face_y_mm, pressed.face_x_mm)
    for moved, slope in ((u_x, slope_x), (u_y, slope_y)):
        assert np.sqrt(np.mean((moved + slope / 2) ** 2)) < 0.05 * np.sqrt(np.mean(slope**2)) / 2


def test_a_single_wave_of_the_bonded_layer() -> None:
    layer = BondedLayer(48, 60, 15.0, 12.0, 2.0, 0.4)
    k_x, k_y = 2 * np.pi * 2 / 15.0, 2 * np.pi / 12.0
    k = np.hypot(k_x, k_y)
    x, y = np.meshgrid(layer.x_mm, layer.y_mm)
    phase = k_x * x + k_y * y
    phi = solve_transfer(np.array([2.0 * k]), 0.4, "bonded").tangential_t[0]
    size = 2 * (1 - 0.4**2) * phi / k
    u_x, u_y = layer.in_plane(np.cos(phase))
    np.testing.assert_allclose(u_x, -size * k_x / k * np.sin(phase), atol=1e-6 * abs(size))
    np.testing.assert_allclose(u_y, -size * k_y / k * np.sin(phase), atol=1e-6 * abs(size))


@pytest.mark.parametrize(("layout", "inwards"), [("contact_face", True), ("opposite_face", False)])
def test_under_a_ball_the_touched_face_shrinks_and_the_far_face_spreads(
    layout: str, inwards: bool
) -> None:
    slab = Elastomer.model_validate(
        {
            "thickness_mm": 3,
            "length_x_mm": 20,
            "length_y_mm": 20,
            "young_modulus_kpa": 300,
            "poisson_ratio": 0.3,
            "layout": layout,
        }
    )
    load = Press(control="depth", depth_mm=0.4, solver_pitch_mm=0.16, relief_pitch_mm=0.05)
    pressed = press(Ball(), slab, load)
    u_x, u_y = in_plane_displacement(pressed, slab, load)
    assert u_x.shape == u_y.shape == pressed.face_z_mm.shape
    right = u_x[pressed.face_y_mm.size // 2, np.searchsorted(pressed.face_x_mm, 0.6)]
    assert (right < 0) == inwards
    np.testing.assert_allclose(u_x, u_y.T, atol=1e-3 * np.abs(u_x).max())
    np.testing.assert_allclose(u_x, -u_x[:, ::-1], atol=1e-3 * np.abs(u_x).max())
