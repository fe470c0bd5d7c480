"""The contact solver against Hertz, a Fredholm solution and finite elements.

Reference figures: those of the prototypes made before this solver.
"""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import fft

from twin.config import load_experiment
from twin.mechanics import PressedElastomer, SolverError
from twin.mechanics.contact import _Brake, solve_contact, solve_on_layer
from twin.mechanics.control import DepthControl, ForceControl
from twin.mechanics.layer import BondedLayer
from twin.pipeline.press import press_specimen
from twin.specimens import height_above_lowest
from twin.specimens.kinds.ball import Ball
from twin.specimens.kinds.flat import Flat
from twin.specimens.kinds.rod import Rod

Field = NDArray[np.float64]


class HalfSpace:
    """Love's solution for a square cell under uniform pressure, convolved without wrap-round."""

    def __init__(self, cells: int, pitch: float) -> None:
        self.cells, half = cells, pitch / 2
        x = pitch * fft.fftfreq(2 * cells, 1 / (2 * cells))
        x, y = np.meshgrid(x, x)

        def corner(p: Field, q: Field) -> Field:
            # arcsinh(q / |p|) is Love's logarithm, free of its cancellation.
            return p * np.arcsinh(q / np.abs(p)) + q * np.arcsinh(p / np.abs(q))

        kernel = (
            corner(x + half, y + half)
            - corner(x + half, y - half)
            - corner(x - half, y + half)
            + corner(x - half, y - half)
        ) / np.pi
        self.spectrum = fft.rfft2(kernel)

    def deflect(self, pressure: Field) -> Field:
        n = self.cells
        wide: Field = fft.irfft2(fft.rfft2(pressure, s=(2 * n, 2 * n)) * self.spectrum)
        return wide[:n, :n]


class HalfPlane:
    """A half-space under pressure that is the same all along y: one row, periodic in x."""

    def __init__(self, cells: int, pitch: float) -> None:
        k = 2 * np.pi * fft.rfftfreq(cells, pitch)
        # The mean is at rest: depth is arbitrary for a line, load, pressure and width are not.
        self.spectrum = np.divide(2, k, out=np.zeros_like(k), where=k > 0)

    def deflect(self, pressure: Field) -> Field:
        result: Field = fft.irfft(fft.rfft(pressure) * self.spectrum, n=pressure.shape[1])
        return result


CELLS, WIDTH, RADIUS = 128, 3.0, 10.0
PITCH = WIDTH / CELLS
CENTRES = (np.arange(CELLS) + 0.5) * PITCH - WIDTH / 2
PARABOLOID = (CENTRES**2 + CENTRES[:, None] ** 2) / (2 * RADIUS)
DEPTH = 0.1
HERTZ_FORCE = 4 / 3 * np.sqrt(RADIUS) * DEPTH**1.5
HERTZ_A = np.sqrt(RADIUS * DEPTH)
HERTZ_P0 = 3 * HERTZ_FORCE / (2 * np.pi * HERTZ_A**2)


@pytest.mark.parametrize("by", ["depth", "force"])
def test_hertz_ball_on_a_half_space(by: str) -> None:
    """E* = 1: force 0.1 %, depth 0.1 %, peak pressure 0.5 %, radius one cell."""
    control = DepthControl(DEPTH) if by == "depth" else ForceControl(HERTZ_FORCE, PITCH**2)
    contact = solve_contact(HalfSpace(CELLS, PITCH).deflect, PARABOLOID, control, 1e-6)
    assert contact.pressure.sum() * PITCH**2 == pytest.approx(HERTZ_FORCE, rel=1e-3)
    assert contact.depth_mm == pytest.approx(DEPTH, rel=1e-3)
    assert contact.pressure.max() == pytest.approx(HERTZ_P0, rel=5e-3)
    radius = np.sqrt((contact.pressure > 0).sum() / np.pi) * PITCH
    assert radius == pytest.approx(HERTZ_A, abs=PITCH)


def test_a_rod_presses_as_hertz_line_contact() -> None:
    """E* = 1, R 2.4: peak pressure 0.5 %, half width one cell; the next rod is 80 widths away."""
    b, radius, pitch = 0.3, 2.4, 0.3 / 34
    cells = 2720
    load = np.pi * b**2 / (4 * radius)  # per length
    x = (np.arange(cells) + 0.5) * pitch - cells * pitch / 2
    # A rod along x is a cylinder across y: its profile is sampled along the solver's one row.
    height = height_above_lowest(Rod(diameter_mm=2 * radius), np.zeros(1), x).T
    parabola = np.broadcast_to(x**2 / (2 * radius), (1, cells))
    near = np.abs(x) < 1.2 * b
    np.testing.assert_allclose(height[0, near], parabola[0, near], rtol=0.01, atol=1e-6)
    contact = solve_contact(
        HalfPlane(cells, pitch).deflect, parabola, ForceControl(load, pitch), 1e-7
    )
    assert contact.pressure.max() == pytest.approx(np.sqrt(load / (np.pi * radius)), rel=5e-3)
    width = (contact.pressure > 0).sum() * pitch / 2
    assert width == pytest.approx(b, abs=pitch)


def test_a_flat_punch_presses_as_boussinesq() -> None:
    """E* = 1: F = 2 a d to 0.5 %; the pressure in the middle is half of the mean."""
    cells, radius, depth = 192, 3.0, 0.1
    pitch = 7.0 / cells
    x = (np.arange(cells) + 0.5) * pitch - 3.5
    height = height_above_lowest(Flat(diameter_mm=2 * radius, edge_radius_mm=0.0), x, x)
    contact = solve_contact(HalfSpace(cells, pitch).deflect, height, DepthControl(depth), 1e-6)
    # The sampled disc's own radius: its cells cover pi a^2.
    a = np.sqrt(np.isfinite(height).sum() / np.pi) * pitch
    assert a == pytest.approx(radius, rel=2e-3)
    force = contact.pressure.sum() * pitch**2
    assert force == pytest.approx(2 * a * depth, rel=5e-3)
    middle = contact.pressure[cells // 2, cells // 2]
    assert middle == pytest.approx(force / (2 * np.pi * a**2), rel=1e-2)


def layer_and_ball(y_mm: float = 0.0) -> tuple[BondedLayer, Field]:
    layer = BondedLayer(
        rows=400, cols=400, length_x_mm=32, length_y_mm=32, thickness_mm=4, poisson_ratio=0.49
    )
    return layer, height_above_lowest(Ball(y_mm=y_mm), layer.x_mm, layer.y_mm)


def test_ball_on_a_bonded_layer_is_the_fredholm_solution() -> None:
    """R 4, h 4, d 0.6, nu 0.49: F / E = 2.7360, to 0.3 %."""
    layer, height = layer_and_ball()
    contact = solve_contact(layer.deflect, height, DepthControl(0.6))
    assert contact.pressure.sum() * layer.cell_area_mm2 == pytest.approx(2.7360, rel=3e-3)


def test_a_rigid_shift_only_shifts_the_solution() -> None:
    layer, height = layer_and_ball()
    still = solve_contact(layer.deflect, height, DepthControl(0.3))
    _, shifted = layer_and_ball(y_mm=25 * 32 / 400)
    moved = solve_contact(layer.deflect, shifted, DepthControl(0.3))
    expected = np.roll(still.pressure, 25, axis=0)
    np.testing.assert_allclose(moved.pressure, expected, atol=1e-6 * still.pressure.max())


def test_free_slab_is_the_finite_element_solution(reference_press: PressedElastomer) -> None:
    """20 x 20 x 4, R 4, d 1, nu 0.49, Taylor-Hood: F / E 0.9230 (0.5 %), peak 0.7218 (3 um)."""
    assert reference_press.force_n == pytest.approx(0.9230, rel=5e-3)
    assert reference_press.face_z_mm.max() == pytest.approx(0.7218, abs=3e-3)


@pytest.mark.parametrize("by", ["depth", "force"])
def test_two_grids_find_what_the_plain_solver_finds(by: str) -> None:
    layer, height = layer_and_ball(y_mm=1.3)
    plain = solve_contact(layer.deflect, height, DepthControl(0.4), 1e-7)
    force = plain.pressure.sum() * layer.cell_area_mm2
    control = DepthControl(0.4) if by == "depth" else ForceControl(force, layer.cell_area_mm2)
    result = solve_on_layer(layer, height, control, 1e-7)
    np.testing.assert_allclose(result.pressure, plain.pressure, atol=1e-4 * plain.pressure.max())
    assert result.depth_mm == pytest.approx(0.4, rel=1e-6)
    assert result.iterations < plain.iterations / 2


def test_contacts_far_apart_and_outside_the_first_patch_are_found() -> None:
    """A small ball that only a deep press reaches, and a plate that the pile-up touches."""
    layer = BondedLayer(160, 160, 32.0, 32.0, 2.0, 0.4999)
    ball = height_above_lowest(Ball(x_mm=-6), layer.x_mm, layer.y_mm)
    x, y = np.meshgrid(layer.x_mm, layer.y_mm)
    # The pile-up round the ball is about 0.05 mm high: a plate slightly beyond the press' reach.
    plate = np.where((np.abs(x - 2) < 3) & (np.abs(y) < 2), 0.61, np.inf)
    height = np.minimum(ball, plate)
    result = solve_on_layer(layer, height, DepthControl(0.6))
    gap = result.deflection_mm + height - 0.6
    assert gap.min() >= -1e-4 * 0.6
    assert (result.pressure[x > -1] > 0).any()


def test_running_out_of_passes_is_one_line() -> None:
    layer, height = layer_and_ball()
    with pytest.raises(SolverError, match="no contact solution within 5 passes") as caught:
        solve_contact(layer.deflect, height, DepthControl(0.6), max_iterations=5)
    assert "\n" not in str(caught.value)


def test_a_tilted_rod_under_a_draped_slab_is_found_without_rebounds() -> None:
    """Cells that join at once open the contact of a bending slab: a line search prevents that.

    Below 200 passes with it; without it over 1000 on one processor, 339 on a second one.
    """
    changes = {
        "specimen.x_mm": -0.2429829074759053, "specimen.y_mm": -0.041928252421451234,
        "specimen.tilt_deg": 0.7818191607156045, "specimen.yaw_deg": 0.0873492104301504,
        "press.depth_mm": 0.7667668789711536, "press.back_pressure_kpa": 16.834198310420753,
        "elastomer.thickness_mm": 2.9852608833583902, "elastomer.shore_a": 10.13986265468515,
    }  # fmt: skip
    experiment = load_experiment("examples/slab_rod", changes)
    assert press_specimen(experiment).iterations < 200


def test_the_brake_steps_to_the_least_energy_of_the_pass():
    """Energy 1 + slope t + curvature t^2 / 2 has its least at -slope / curvature."""
    brake = _Brake()
    assert brake.share(1.0, -1.0, 100.0) == 1.0  # the first pass is free
    assert brake.share(1.0, -1.0, 4.0) == 0.25
    assert brake.share(0.0, -1.0, 2.0 + 1e-9) == 1.0  # rises, but not above the last passes
    assert brake.share(1.0, 1.0, 4.0) == 1.0  # no descent: left to the search
