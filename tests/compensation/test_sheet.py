"""The object under a sheet against the one-dimensional oracle, which shares no code with it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from reconstruction.compensation import CompensatedSheet, SheetOpening, compensate_sheet, parts_of
from reconstruction.compensation.relief import filled, relief_on_frame
from reconstruction.compensation.scatter import variance_and_area
from reconstruction.errors import FitError
from tests.compensation.sheets import RIM_MM, YOUNG_KPA, coat_points, layer_of, pressed_ball
from tests.oracles.round_sheet import Profile


def thickness_error_um(sheet: CompensatedSheet, profile: Profile) -> float:
    """Return the mean error of the local thickness in the contact."""
    radius = np.hypot(sheet.relief.x_mm, sheet.relief.y_mm[:, None])
    true = np.interp(radius, profile.radius_mm, profile.thickness_stretch)
    wrong = sheet.layer.thickness_mm * (sheet.thinning - true)
    return 1e3 * float(wrong[sheet.contact].mean())


@pytest.mark.parametrize(("thickness_mm", "pressure_kpa"), [(0.1, 2.0), (0.3, 5.0)])
def test_ball_force_contact_and_modulus(thickness_mm: float, pressure_kpa: float) -> None:
    """Expected: R to 1 um and h / 100, thickness to 2 um; force, E to 3 %, 6 % of thick ones."""
    profile = pressed_ball(thickness_mm, pressure_kpa)
    sheet = compensate_sheet(*coat_points(profile, 5e-4), layer_of(thickness_mm, pressure_kpa))
    (ball,) = parts_of(sheet)
    assert ball.form == "ball"
    assert ball.radius_mm == pytest.approx(4.0, abs=1e-3 + 0.01 * thickness_mm)
    assert abs(ball.radius_mm - 4.0) < 3 * ball.sigma_mm + 3e-4
    assert abs(thickness_error_um(sheet, profile)) < 2.0
    assert sheet.force_n == pytest.approx(profile.force_n, rel=0.02 + 0.12 * thickness_mm)
    radius = np.sqrt(sheet.balance.upright_mm2[sheet.contact].sum() / np.pi)
    assert radius == pytest.approx(profile.contact_radius_mm, rel=0.04)
    modulus = sheet.modulus_of_free_span_kpa()
    assert modulus is not None
    assert modulus[0] == pytest.approx(YOUNG_KPA, rel=0.02 + 0.15 * thickness_mm)


@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_a_force_gauge_determines_the_modulus(factor: float) -> None:
    """From the force of the oracle, for any prior modulus, within its uncertainty."""
    profile = pressed_ball(0.1, 2.0)
    layer = replace(layer_of(0.1, 2.0), young_modulus_kpa=factor * YOUNG_KPA)
    sheet = compensate_sheet(*coat_points(profile, 5e-4), layer)
    modulus, sigma = sheet.modulus_of_force_kpa(profile.force_n, 0.002)
    assert modulus == pytest.approx(YOUNG_KPA, rel=0.06)
    assert abs(modulus - YOUNG_KPA) < 2 * sigma < 0.2 * YOUNG_KPA
    with pytest.raises(FitError, match="modulus"):
        sheet.modulus_of_force_kpa(1e-4)


def test_object_is_the_parallel_surface() -> None:
    """Every point of the contact's core is on the ball, the coat one thickness outside."""
    profile = pressed_ball(0.2, 2.0)
    sheet = compensate_sheet(*coat_points(profile), layer_of(0.2, 2.0))
    core = parts_of(sheet)[0].core
    middle = np.array([0.0, 0.0, 0.6 - 0.2 - 4.0])
    away = np.linalg.norm(sheet.object_mm[core] - middle, axis=1) - 4.0
    coat = np.linalg.norm(sheet.relief.points_mm[core] - middle, axis=1) - 4.0
    assert np.abs(away).max() < 2.5e-3
    assert coat.min() > 0.12


def test_radius_changes_with_thickness_by_its_uncertainty() -> None:
    """A layer 5 um too thick changes the radius by the uncertainty predicted for 5 um."""
    points = coat_points(pressed_ball(0.2, 2.0))
    (known,) = parts_of(compensate_sheet(*points, layer_of(0.2, 2.0, sigma_thickness_mm=5e-3)))
    (thicker,) = parts_of(compensate_sheet(*points, layer_of(0.205, 2.0)))
    assert known.layer_mm == pytest.approx(known.radius_mm - thicker.radius_mm, rel=0.1)


def test_tent_without_air_is_carried_by_its_tip_only() -> None:
    """A frictionless sheet without pressure touches within 0.6 mm: elsewhere N : b is zero."""
    profile = pressed_ball(0.2, 0.0)
    sheet = compensate_sheet(*coat_points(profile, 2e-4), layer_of(0.2, 0.0))
    radius = np.hypot(sheet.relief.x_mm, sheet.relief.y_mm[:, None])
    assert sheet.contact[radius < 0.3].all()
    assert not sheet.contact[radius > 1.0].any()
    assert sheet.modulus_of_free_span_kpa() is None


def test_sticking_sheet_is_within_its_uncertainty() -> None:
    """A sheet that sticks has stretched less on the ball; its sigma covers the difference."""
    profile = pressed_ball(0.2, 2.0, stick=True)
    sheet = compensate_sheet(*coat_points(profile, 5e-4), layer_of(0.2, 2.0, sticks=True))
    (ball,) = parts_of(sheet)
    assert abs(ball.radius_mm - 4.0) < 2 * ball.sigma_mm < 0.2


def test_gaps_and_noise_do_not_move_the_ball() -> None:
    """A stripe without points and 5 um of noise: R to its own uncertainty, gaps in no contact."""
    points, sigma = coat_points(pressed_ball(0.2, 2.0), 5e-3)
    outside = (points[:, 0] < 1.2) | (points[:, 0] > 1.4)
    sheet = compensate_sheet(points[outside], sigma[outside], layer_of(0.2, 2.0))
    largest = max(parts_of(sheet), key=lambda part: int(part.core.sum()))
    assert largest.form == "ball"
    assert abs(largest.radius_mm - 4.0) < 3 * largest.sigma_mm + 1e-3
    assert not (sheet.contact & ~sheet.relief.measured).any()


def test_texture_of_the_coat_is_part_of_the_uncertainty() -> None:
    """12 um RMS, correlated over 0.15 mm, moves a radius by some 20 um, as its sigma states."""
    (points, sigma), random = coat_points(pressed_ball(0.2, 2.0)), np.random.default_rng(5)
    side = 2 * int(RIM_MM / 0.05)
    texture = gaussian_filter(random.normal(size=(side, side)), 3.0)
    col, row = np.floor((points[:, :2].T + RIM_MM) / 0.05).astype(int)
    points[:, 2] += 0.012 / texture.std() * texture[row, col]
    sheet = compensate_sheet(points, sigma, layer_of(0.2, 2.0))
    (ball,) = parts_of(sheet)
    assert abs(ball.radius_mm - 4.0) < 3 * ball.sigma_mm
    assert 5e-3 < ball.sigma_mm < 0.06
    assert sheet.force_n == pytest.approx(pressed_ball(0.2, 2.0).force_n, rel=0.08)


def test_a_third_of_the_opening_is_not_enough_to_guess_the_rest() -> None:
    points, sigma = coat_points(pressed_ball(0.2, 2.0))
    with pytest.raises(FitError, match="length_x_mm"):
        compensate_sheet(points, sigma, layer_of(0.2, 2.0, rim_mm=30.0))


def test_gaps_are_filled_without_curvature() -> None:
    """Laplace's equation between two levels is a straight line."""
    z = np.zeros((30, 20))
    z[0], z[-1] = 1.0, 0.0
    known = np.zeros(z.shape, bool)
    known[[0, -1]] = True
    inside = np.ones(z.shape, bool)
    known[:, [0, -1]] = True
    z[:, [0, -1]] = np.linspace(1, 0, 30)[:, None]
    assert filled(z, known, inside) == pytest.approx(np.tile(np.linspace(1, 0, 30)[:, None], 20))


def test_correlation_area_of_a_gaussian_filter() -> None:
    """White noise after a Gaussian of s cells is correlated over 4 pi s^2 of them."""
    noise = gaussian_filter(np.random.default_rng(4).normal(size=(400, 400)), 1.5)
    variance, area = variance_and_area(noise, np.ones(noise.shape, bool), 1.0)
    assert variance == pytest.approx(1 / (4 * np.pi * 1.5**2), rel=0.05)
    assert area == pytest.approx(4 * np.pi * 1.5**2, rel=0.1)


def test_cells_hold_the_mean_of_their_points() -> None:
    points = np.array([[0.1, 0.1, 1.0], [0.2, 0.2, 3.0], [-0.5, 0.5, 5.0]])
    relief = relief_on_frame(points, np.full(3, 0.1), SheetOpening(2.0, 2.0), (2, 2))
    assert relief.points_mm[1, 1] == pytest.approx([0.15, 0.15, 2.0])
    assert relief.sigma_mm[1, 1] == pytest.approx(0.1 / np.sqrt(2))
    assert relief.measured.tolist() == [[False, False], [True, True]]
