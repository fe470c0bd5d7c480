"""Tangential compliance of a bonded layer: Lame's equations, limits, one wave, reciprocity."""

import numpy as np
import pytest

from reconstruction.arrays import FloatArray
from twin.mechanics.control import inner
from twin.mechanics.layer import BondedLayer
from twin.mechanics.patch import Span
from twin.mechanics.shear import InPlane, ShearedLayer, along_wave
from twin.mechanics.transfer import amplitudes


def solved_along_wave(q: FloatArray, nu: float) -> FloatArray:
    """Return Psi from the four solutions of Lame's equations, for traction along the wave."""
    top, bottom = amplitudes(q, 0.0, nu), amplitudes(q, 1.0, nu)
    rows = np.stack((top["S_zz"], top["S_xz"], bottom["U"], bottom["W"]), axis=-2)
    load = np.zeros((q.size, 4, 1))
    load[:, 1] = -1.0
    weights = np.linalg.solve(rows, load)[..., 0]
    displacement = np.einsum("qi,qi->q", top["U"], weights)
    return np.asarray(q / (1 - nu) * displacement)


@pytest.mark.parametrize("nu", [0.3, 0.49, 0.5])
def test_the_closed_form_solves_lames_equations(nu: float) -> None:
    q = np.geomspace(0.05, 15.0, 40)
    np.testing.assert_allclose(along_wave(q, nu), solved_along_wave(q, nu), rtol=1e-9)


@pytest.mark.parametrize("nu", [0.3, 0.5])
def test_thick_and_thin_layers(nu: float) -> None:
    """A half-space for short waves; for long waves simple shear of the layer, u = tau h / G."""
    assert along_wave(np.array([40.0, 900.0]), nu) == pytest.approx([1.0, 1.0], rel=1e-12)
    q = np.array([1e-3])
    assert along_wave(q, nu) == pytest.approx(q / (1 - nu), rel=1e-5)


def test_a_uniform_traction_shears_the_layer() -> None:
    layer = BondedLayer(16, 32, 20.0, 12.0, 2.0, 0.4)
    uniform = np.full((16, 32), 0.01)
    sheared = ShearedLayer(layer).displace(InPlane(uniform, -2 * uniform))
    expected = 0.01 * 2.0 * 2 * (1 + 0.4)
    np.testing.assert_allclose(sheared.x, expected, rtol=1e-12)
    np.testing.assert_allclose(sheared.y, -2 * expected, rtol=1e-12)


def test_one_wave_in_each_direction() -> None:
    """Along the wave vector Psi, across it the shear of a layer, tanh(q) / (G k)."""
    layer, nu = BondedLayer(48, 60, 15.0, 12.0, 2.0, 0.4), 0.4
    k_x, k_y = 2 * np.pi * 2 / 15.0, 2 * np.pi / 12.0
    k = np.hypot(k_x, k_y)
    x, y = np.meshgrid(layer.x_mm, layer.y_mm)
    wave = np.cos(k_x * x + k_y * y)
    along, across = np.array([k_x, k_y]) / k, np.array([-k_y, k_x]) / k
    psi = float(along_wave(np.array([2.0 * k]), nu)[0])
    for direction, size in (
        (along, 2 * (1 - nu**2) * psi / k),
        (across, 2 * (1 + nu) * np.tanh(2.0 * k) / k),
    ):
        moved = ShearedLayer(layer).displace(InPlane(direction[0] * wave, direction[1] * wave))
        for axis in (0, 1):
            np.testing.assert_allclose(moved[axis], size * direction[axis] * wave, atol=1e-9)


def random_fields(layer: BondedLayer, count: int) -> list[FloatArray]:
    """Return smooth random fields: without the shortest waves, which have no slope on the grid."""
    rng = np.random.default_rng(1)
    rows, cols = layer.rows, layer.cols
    coarse = [np.fft.rfft2(rng.normal(size=(rows, cols))) for _ in range(count)]
    for spectrum in coarse:
        spectrum[:, -1] = spectrum[rows // 2] = 0.0
    return [np.fft.irfft2(spectrum, s=(rows, cols)) for spectrum in coarse]


@pytest.mark.parametrize("nu", [0.3, 0.49])
def test_pressure_and_traction_are_reciprocal(nu: float) -> None:
    """Betti: work of a traction on the displacement by a pressure, and the other way round."""
    layer = BondedLayer(32, 48, 12.0, 9.0, 2.0, nu)
    pressure, x, y = random_fields(layer, 3)
    sheared, (u_x, u_y) = ShearedLayer(layer), layer.in_plane(pressure)
    work = inner(x, u_x) + inner(y, u_y)
    assert work == pytest.approx(inner(pressure, sheared.deflect(InPlane(x, y))), rel=1e-9)
    assert abs(work) > 1e-3 * abs(inner(pressure, layer.deflect(pressure)))


def test_a_patch_is_a_part_of_the_layer() -> None:
    layer = BondedLayer(32, 48, 12.0, 9.0, 2.0, 0.45)
    sheared, patch = ShearedLayer(layer), ShearedLayer(layer).patch(Span(5, 12), Span(9, 17))
    rng = np.random.default_rng(2)
    within = InPlane(*rng.normal(size=(2, 12, 17)))
    whole = InPlane(*np.zeros((2, 32, 48)))
    for axis in (0, 1):
        whole[axis][patch.cells] = within[axis]
    moved, expected = patch.displace(within), sheared.displace(whole)
    for axis in (0, 1):
        np.testing.assert_allclose(moved[axis], expected[axis][patch.cells], atol=1e-12)
    work = sum(inner(within[axis], moved[axis]) for axis in (0, 1))
    size = sum(inner(within[axis], within[axis]) for axis in (0, 1))
    assert 0 < work < patch.largest * size
