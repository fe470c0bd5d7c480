"""The spectral operators: exact for a single mode, symmetric, and faithful between the cells."""

import numpy as np
import pytest

from twin.mechanics.layer import BondedLayer, FreeSlab
from twin.mechanics.transfer import opposite_transfer

SLAB = FreeSlab(
    rows=48, cols=60, length_x_mm=15.0, length_y_mm=12.0, thickness_mm=2.0, poisson_ratio=0.49
)
LAYER = BondedLayer(
    rows=48, cols=60, length_x_mm=15.0, length_y_mm=12.0, thickness_mm=2.0, poisson_ratio=0.4
)


def mode(x_mm: np.ndarray, y_mm: np.ndarray) -> np.ndarray:
    across_x = np.sin(3 * np.pi * (x_mm + 7.5) / 15.0)
    return across_x * np.sin(2 * np.pi * (y_mm[:, None] + 6.0) / 12.0)


K = np.hypot(3 * np.pi / 15.0, 2 * np.pi / 12.0)


def test_a_sine_mode_of_the_free_slab_keeps_its_shape() -> None:
    q = K * 2.0
    even, odd = (np.cosh(q) - 1) / (np.sinh(q) + q), (np.cosh(q) + 1) / (np.sinh(q) - q)
    compliance = 2 * (1 - 0.49**2) / K * (even + odd) / 2
    wave = mode(SLAB.x_mm, SLAB.y_mm)
    np.testing.assert_allclose(SLAB.deflect(wave), compliance * wave, atol=1e-6 * compliance)
    transferred = compliance * opposite_transfer(np.array([q]))[0]
    np.testing.assert_allclose(
        SLAB.deflect_opposite(wave), transferred * wave, atol=1e-6 * transferred
    )
    # Nodes: finer than the cells, and coarser.
    for rows, cols in ((100, 90), (20, 24)):
        x, y = np.linspace(-7.5, 7.5, cols + 1), np.linspace(-6, 6, rows + 1)
        nodes = SLAB.opposite_at_nodes(wave, rows, cols)
        np.testing.assert_allclose(nodes, transferred * mode(x, y), atol=1e-6 * transferred)


@pytest.mark.parametrize("layer", [SLAB, LAYER])
def test_operator_is_symmetric_and_positive(layer: FreeSlab | BondedLayer) -> None:
    first, second = np.random.default_rng(1).normal(size=(2, 48, 60))
    forward, backward = np.vdot(first, layer.deflect(second)), np.vdot(second, layer.deflect(first))
    assert forward == pytest.approx(backward, rel=1e-10)
    assert np.vdot(first, layer.deflect(first)) > 0


def test_nodes_on_the_rim_stay_at_zero_and_pass_through_the_cell_values() -> None:
    pressure = np.random.default_rng(2).uniform(size=(48, 60))
    # Twice the cells: every second node from the first is at a cell centre.
    nodes = SLAB.opposite_at_nodes(pressure, 96, 120)
    np.testing.assert_allclose(nodes[1::2, 1::2], SLAB.deflect_opposite(pressure), atol=1e-12)
    for rim in (nodes[0], nodes[-1], nodes[:, 0], nodes[:, -1]):
        assert not rim.any()


def test_uniform_pressure_compresses_the_bonded_layer_by_its_oedometer_modulus() -> None:
    nu = 0.4
    modulus = (1 - nu) / ((1 + nu) * (1 - 2 * nu))
    deflection = LAYER.deflect(np.full((48, 60), 0.01))
    np.testing.assert_allclose(deflection, 0.01 * 2.0 / modulus, rtol=1e-12)


def test_back_pressure_and_press_mirror_each_other() -> None:
    # Both faces of the free slab are alike: equal pressures on both thin it symmetrically.
    uniform = np.full((48, 60), 0.01)
    touched = SLAB.deflect(uniform) - SLAB.deflect_opposite(uniform)
    coated = SLAB.opposite_at_nodes(uniform, 96, 120, uniform_load=-0.01)
    np.testing.assert_allclose(coated[1::2, 1::2], -touched, atol=1e-12)
