"""SYNTHETIC shading of a domed gel: its relief is measured relative to its undeformed shape."""

from dataclasses import replace

import imageio.v3 as imageio
import numpy as np
import pytest

from reconstruction.errors import InputError
from reconstruction.evaluate.fit import fit_sphere
from reconstruction.photometric import (
    BallPress,
    PhotometricDecoder,
    RestSurface,
    calibrate_sensor,
    read_height_map,
    read_sensor_calibration,
    reconstruct_photometric,
    write_height_map,
    write_sensor_calibration,
)
from reconstruction.photometric.press_doubts import untouched_drift_mm
from tests.photometric.conftest import PITCH_MM, SHAPE, shade

DOME_MM, DISTANCE_MM = 40.0, 28.0
"""Radius of the dome, and distance of the pinhole from the plane z = 0, inside the gel."""


def view():
    """Return x to the right and y downwards (row, col), mm, of the pixels on the plane z = 0."""
    rows, cols = SHAPE
    row, col = np.indices(SHAPE, dtype=float)
    return (col - (cols - 1) / 2) * PITCH_MM, (row - (rows - 1) / 2) * PITCH_MM


def imaged(height, slope):
    """Return points (row, col, xyz), y upwards, and slopes of a surface by a pinhole camera.

    The height at the imaged point is found by iteration along the line of sight.
    """
    x0, y0 = view()
    z = np.zeros(SHAPE)
    for _ in range(25):
        scale = 1.0 - z / DISTANCE_MM
        z = height(x0 * scale, y0 * scale)
    x, y = x0 * scale, y0 * scale
    return np.stack([x, -y, z], axis=-1), slope(x, y)


def dome(x, y):
    return DOME_MM - np.sqrt(DOME_MM**2 - x**2 - y**2)


def dome_slope(x, y):
    return np.stack([y, x]) / np.sqrt(DOME_MM**2 - x**2 - y**2)


def pressed(x_mm, y_mm, radius_mm, depth_mm):
    """Return height and slope of the dome with a ball pressed into it; no gel beside it moves."""

    def raised(x, y):
        squared = np.maximum(radius_mm**2 - (x - x_mm) ** 2 - (y - y_mm) ** 2, 1e-12)
        return top + np.sqrt(squared) - radius_mm

    def height(x, y):
        return np.maximum(dome(x, y), raised(x, y))

    def slope(x, y):
        away = np.stack([y - y_mm, x - x_mm])
        inside = raised(x, y) > dome(x, y)
        depth = np.sqrt(np.maximum(radius_mm**2 - np.sum(away**2, axis=0), 1e-12))
        return np.where(inside, -away / depth, dome_slope(x, y))

    # The ball touches the dome where their centres are in one line.
    reach = np.hypot(x_mm, y_mm)
    top = DOME_MM - np.sqrt((DOME_MM + radius_mm) ** 2 - reach**2) + radius_mm + depth_mm
    return height, slope


@pytest.fixture(scope="module")
def rest():
    points, slopes = imaged(dome, dome_slope)
    x0, y0 = view()
    sight = np.stack([-y0, -x0]) / DISTANCE_MM
    return RestSurface(*(part.astype(np.float32) for part in (points, slopes, sight)))


@pytest.fixture(scope="module")
def presses_of_balls():
    rng, presses = np.random.default_rng(3), []
    for number in range(16):
        radius_mm = rng.uniform(2.5, 4.5)
        place = rng.uniform(-1.0, 1.0, 2) * (7.5, 5.0)
        slopes = imaged(*pressed(*place, radius_mm, radius_mm * rng.uniform(0.06, 0.2)))[1]
        presses.append(BallPress(shade(slopes, 1000 + number), 2.0 * radius_mm))
    return presses


@pytest.fixture(scope="module")
def calibration(rest, presses_of_balls):
    backgrounds = np.stack([shade(rest.slopes.astype(float), seed) for seed in range(4)])
    return calibrate_sensor(presses_of_balls, backgrounds, PITCH_MM, rest=rest)


def test_an_unpressed_dome_has_its_own_shape(calibration, rest):
    """Another image without load. Expected: the dome within 5 um RMS, a relief of 0."""
    image = shade(rest.slopes.astype(float), 77)
    decoder = PhotometricDecoder(calibration)
    decoded = decoder.decode(image)
    off_mm = decoded.height_mm - rest.points_mm[..., 2]
    assert np.sqrt(np.mean(off_mm**2)) < 0.005
    assert untouched_drift_mm(decoded, decoder.untouched(image).where) < 0.005


@pytest.mark.parametrize("place", [(0.0, 0.0), (5.0, -3.0)])
def test_a_ball_in_a_dome_has_its_radius(calibration, rest, place):
    """A ball of 6 mm in the middle and on a flank of 8 degrees.

    Expected: heights within 15 um RMS; the points of the contact on a sphere of 3 mm, about its
    axis. With the pitch of the undeformed coat it was up to 3.5 % smaller, and 1 % with D = 280 mm.
    """
    surface = pressed(*place, 3.0, 0.4)
    points, slopes = imaged(*surface)
    image = shade(slopes, 5000)
    decoded = PhotometricDecoder(calibration).decode(image)
    assert np.sqrt(np.mean((decoded.height_mm - points[..., 2]) ** 2)) < 0.015
    inside = points[..., 2] - dome(points[..., 0], points[..., 1]) > 0.1
    measured = decoded.points_mm()[inside[decoded.valid]]
    fitted = fit_sphere(measured)
    assert fitted.radius_mm == pytest.approx(3.0, rel=0.025)
    np.testing.assert_allclose(fitted.centre_mm[:2], (place[0], -place[1]), atol=0.05)


@pytest.mark.parametrize("distance_mm", [DISTANCE_MM, 0.0])
def test_a_sphere_by_its_radius(rest, distance_mm):
    """Expected: the points and slopes that iteration along the lines of sight finds, to float32;
    for parallel lines the closed form R - sqrt(R^2 - r^2).
    """
    dome_surface = RestSurface.of_sphere(SHAPE, PITCH_MM, DOME_MM, distance_mm)
    if distance_mm:
        for name in ("points_mm", "slopes", "sight"):
            np.testing.assert_allclose(getattr(dome_surface, name), getattr(rest, name), atol=2e-5)
    else:
        np.testing.assert_allclose(dome_surface.points_mm[..., 2], dome(*view()), atol=2e-5)
        np.testing.assert_allclose(dome_surface.slopes, dome_slope(*view()), atol=2e-5)
        assert not dome_surface.sight.any()
    with pytest.raises(InputError, match="radius_mm: found 6, allowed more than"):
        RestSurface.of_sphere(SHAPE, PITCH_MM, 6.0, distance_mm)


def test_a_description_of_a_domed_gel(tmp_path, rest, presses_of_balls):
    """Setup: the images of the calibration, and a ball of 6 mm in the middle, as files.

    Expected: heights within 15 um RMS, as by the Python functions.
    """
    for number, press in enumerate(presses_of_balls):
        imageio.imwrite(tmp_path / f"ball_{number:02d}.png", press.image)
    for seed in range(4):
        imageio.imwrite(tmp_path / f"still_{seed}.png", shade(rest.slopes.astype(float), seed))
    points, slopes = imaged(*pressed(0.0, 0.0, 3.0, 0.4))
    imageio.imwrite(tmp_path / "press.png", shade(slopes, 5000))
    balls = "".join(
        f"[[calibrate.balls]]\ndiameter_mm = {press.ball_diameter_mm!r}\n"
        f'images = ["ball_{number:02d}.png"]\n'
        for number, press in enumerate(presses_of_balls)
    )
    described = tmp_path / "press.toml"
    described.write_text(
        'format = "photometric-press"\nversion = 1\nimage = "press.png"\n'
        f'background = ["still_*.png"]\n[calibrate]\npitch_mm = {PITCH_MM}\n{balls}'
        f"[calibrate.dome]\nradius_mm = {DOME_MM}\nview_distance_mm = {DISTANCE_MM}\n",
        encoding="utf-8",
    )
    decoded = reconstruct_photometric(described).height_map
    assert np.sqrt(np.mean((decoded.height_mm - points[..., 2]) ** 2)) < 0.015
    described.write_text(described.read_text().replace(f"radius_mm = {DOME_MM}", "radius_mm = 6.0"))
    with pytest.raises(InputError, match="radius_mm: found 6"):
        reconstruct_photometric(described)


def test_files_hold_the_dome(calibration, rest, tmp_path):
    write_sensor_calibration(tmp_path / "dome.npz", calibration)
    stored = read_sensor_calibration(tmp_path / "dome.npz")
    for name in ("points_mm", "slopes", "sight"):
        np.testing.assert_array_equal(getattr(stored.rest, name), getattr(rest, name))
    decoded = PhotometricDecoder(stored).decode(shade(rest.slopes.astype(float), 5))
    write_height_map(tmp_path / "height.nc", decoded)
    again = read_height_map(tmp_path / "height.nc")
    np.testing.assert_allclose(again.points_mm(), decoded.points_mm())
    np.testing.assert_array_equal(again.relief_mm, decoded.relief_mm)


def test_a_rest_surface_that_does_not_fit_is_refused(calibration, rest):
    with pytest.raises(InputError, match="sight is float64"):
        replace(rest, sight=rest.sight.astype(float))
    cut = RestSurface(rest.points_mm[1:], rest.slopes[:, 1:], rest.sight[:, 1:])
    with pytest.raises(InputError, match="the background has"):
        replace(calibration, rest=cut)
