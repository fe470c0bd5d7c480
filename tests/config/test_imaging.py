"""Closed forms of a thin lens and of the triangulation triangle, against Gauss's lens equation."""

import numpy as np
import pytest

from twin.config import imaging

LENSES = [(50.0, 214.0, 8.0), (25.0, 100.0, 1.6), (418.0, 1000.0, 5.7)]
PIXEL_MM = 0.0045


def image_mm(focal_mm, distance_mm):
    """Return the image distance v of 1 / f = 1 / u + 1 / v."""
    return 1.0 / (1.0 / focal_mm - 1.0 / distance_mm)


def circle_mm(focal_mm, distance_mm, f_number, at_mm):
    """Return the size of the cone of light from `at_mm` in the image plane of `distance_mm`."""
    focus_mm, plane_mm = image_mm(focal_mm, at_mm), image_mm(focal_mm, distance_mm)
    return focal_mm / f_number * abs(focus_mm - plane_mm) / focus_mm


@pytest.mark.parametrize(("focal_mm", "distance_mm", "f_number"), LENSES)
def test_magnification_distance_and_focal_length_obey_the_lens_equation(
    focal_mm, distance_mm, f_number
):
    size = image_mm(focal_mm, distance_mm) / distance_mm
    assert imaging.magnification_at(focal_mm, distance_mm) == pytest.approx(size, rel=1e-12)
    assert imaging.distance_of(focal_mm, size) == pytest.approx(distance_mm, rel=1e-12)
    assert imaging.focal_length_of(size, distance_mm) == pytest.approx(focal_mm, rel=1e-12)


@pytest.mark.parametrize(("focal_mm", "distance_mm", "f_number"), LENSES)
def test_blur_at_both_limits_of_the_depth_of_field_is_one_pixel(focal_mm, distance_mm, f_number):
    limits_mm = imaging.depth_limits_mm(focal_mm, f_number, distance_mm, PIXEL_MM)
    assert limits_mm[0] < distance_mm < limits_mm[1]
    for at_mm in limits_mm:
        blur_mm = circle_mm(focal_mm, distance_mm, f_number, at_mm)
        assert blur_mm == pytest.approx(PIXEL_MM, rel=1e-9)


@pytest.mark.parametrize(("focal_mm", "distance_mm", "f_number"), LENSES)
def test_f_number_for_a_depth_blurs_its_near_end_by_one_pixel(focal_mm, distance_mm, f_number):
    depth_mm = 0.8
    needed = imaging.f_number_for(focal_mm, depth_mm, distance_mm, PIXEL_MM)
    near_mm = distance_mm - depth_mm / 2
    assert circle_mm(focal_mm, distance_mm, needed, near_mm) == pytest.approx(PIXEL_MM, rel=1e-9)
    again_mm = imaging.depth_for(focal_mm, needed, distance_mm, PIXEL_MM)
    assert again_mm == pytest.approx(depth_mm, rel=1e-9)


def test_depth_of_field_is_without_end_from_the_hyperfocal_distance_on():
    hyperfocal_mm = 25.0**2 / (8.0 * PIXEL_MM) + 25.0
    near_mm, far_mm = imaging.depth_limits_mm(25.0, 8.0, 1.001 * hyperfocal_mm, PIXEL_MM)
    assert far_mm == float("inf")
    assert near_mm == pytest.approx(hyperfocal_mm / 2, rel=1e-2)


def direction(polar_deg, azimuth_deg):
    polar, azimuth = np.deg2rad([polar_deg, azimuth_deg])
    along = [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
    return np.array(along)


@pytest.mark.parametrize(
    ("angle_deg", "polar_deg", "azimuth_deg"),
    [(25, 0, 0), (25, 12.5, 180), (40, 20, 90), (40, 30, 135), (20, 80, 0), (70, 5, 0)],
)
def test_polar_angle_gives_the_angle_between_both_devices(angle_deg, polar_deg, azimuth_deg):
    upright_deg = imaging.polar_of_angle(angle_deg, polar_deg, -azimuth_deg)
    cosine = direction(polar_deg, azimuth_deg) @ direction(upright_deg, 0.0)
    assert np.rad2deg(np.arccos(cosine)) == pytest.approx(angle_deg, abs=1e-9)
    assert 0.0 <= upright_deg < 90.0


@pytest.mark.parametrize(("angle_deg", "polar_deg"), [(100, 0), (5, 12.5), (120, 20)])
def test_no_projector_above_the_coat_is_at_the_angle(angle_deg, polar_deg):
    assert imaging.polar_of_angle(angle_deg, polar_deg, 180.0) is None


def test_baseline_is_the_third_side_of_the_triangle():
    sides_mm = np.linalg.norm(214.0 * direction(0, 0) - 250.0 * direction(25, 0))
    assert imaging.angle_of_baseline(sides_mm, 214.0, 250.0) == pytest.approx(25.0, abs=1e-9)
    assert imaging.angle_of_baseline(36.0 - 1e-6, 214.0, 250.0) is None
    assert imaging.angle_of_baseline(464.0 + 1e-6, 214.0, 250.0) is None
