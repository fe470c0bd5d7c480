"""Triangulation below plane layers, against Snell's invariant, finite differences and air."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import brentq

from reconstruction.errors import CaptureError, InputError
from reconstruction.rig.calibration import read_calibration, write_calibration
from reconstruction.rig.layers import PlaneLayers
from reconstruction.triangulation import triangulate

from .test_triangulate import decoded_from

GEL_ON_WINDOW = PlaneLayers((9.0, 6.0), (1.52, 1.41))
WITH_A_GAP = PlaneLayers((14.0, 12.0, 9.0), (1.9, 1.0, 1.41))


def first_leg(device_mm, point_mm, layers):
    """Return the direction in air of the light from a device to a point.

    By symmetry it is in the plane of incidence, and n sin(theta) is the same in all media: found
    by bracketing (Brent) in the sine; the kernels take Newton's method in the tangent.
    """
    way_mm = np.hypot(*(point_mm[:2] - device_mm[:2]))
    levels = [device_mm[2], *layers.tops_mm, point_mm[2]]
    heights, n = -np.diff(levels), np.array([1.0, *layers.iors])

    def excess(sine):
        return np.sum(heights * sine / np.sqrt(n**2 - sine**2)) - way_mm

    sine = brentq(excess, 0.0, 1.0 - 1e-9, xtol=1e-15, rtol=1e-15)
    along = (point_mm[:2] - device_mm[:2]) / max(way_mm, 1e-300)
    return np.array([*(along * sine), -np.sqrt(1.0 - sine**2)])


def seen_from(device, T_world_from_device, point_mm, layers):
    """Return the pixel of a point below layers in a device."""
    ray = T_world_from_device[:3, :3].T @ first_leg(T_world_from_device[:3, 3], point_mm, layers)
    return device.project(ray)


@pytest.fixture
def measured(calibration, surface):
    """Return a function: view of camera pixels through layers, by forward projection."""

    def make(layers, roll_deg=0.0):
        c, s = np.cos(np.deg2rad(roll_deg)), np.sin(np.deg2rad(roll_deg))
        roll = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
        T = calibration.T_world_from_proj @ roll
        rig = dataclasses.replace(calibration, layers=layers, T_world_from_proj=T)
        points = surface(calibration).reshape(-1, 3)[::397] - [0.0, 0.0, 0.5]
        camera = [seen_from(rig.camera, rig.T_world_from_cam, point, layers) for point in points]
        projector = [
            seen_from(rig.projector, rig.T_world_from_proj, point, layers) for point in points
        ]
        return rig, points, np.array(camera), np.array(projector)

    return make


def looked_at(rig, camera_px, projector_px, use):
    """Triangulate single sight lines: a camera of one pixel centred on each of them."""
    result, sigma, valid = [], [], []
    for at, pixel in zip(camera_px, projector_px, strict=True):
        x, y = rig.camera.unproject(at)
        single = dataclasses.replace(
            rig.camera, width_px=1, height_px=1, cx_px=-x * rig.camera.fx_px,
            cy_px=-y * rig.camera.fy_px, distortion=(0.0,) * 5,
        )  # fmt: skip
        point_map = triangulate(
            decoded_from(pixel.reshape(1, 1, 2)), dataclasses.replace(rig, camera=single), use
        )
        result.append(point_map.points_world_mm[0, 0])
        sigma.append(point_map.sigma_xyz_mm[0, 0])
        valid.append(point_map.valid[0, 0])
    return np.array(result), np.array(sigma), np.array(valid)


@pytest.mark.parametrize("layers", [GEL_ON_WINDOW, WITH_A_GAP], ids=["bonded", "gap"])
@pytest.mark.parametrize("use", ["column", "row", "both"])
def test_points_below_layers_come_back(measured, layers, use):
    """Expected: within 0.02 um, with distortion in both devices."""
    rig, points, camera_px, projector_px = measured(layers)
    result, _, valid = looked_at(rig, camera_px, projector_px, use)
    assert valid.all()
    assert np.max(np.abs(result - points)) < 2e-5


def test_layers_of_air_are_air(calibration, surface, project):
    points = surface(calibration) - [0.0, 0.0, 0.5]
    decoded = decoded_from(project(calibration, points))
    plain = triangulate(decoded, calibration, "both")
    air = PlaneLayers((9.0, 6.0), (1.0, 1.0))
    layered = triangulate(decoded, dataclasses.replace(calibration, layers=air), "both")
    assert layered.valid.all()
    np.testing.assert_allclose(layered.points_world_mm, plain.points_world_mm, atol=2e-6)
    np.testing.assert_allclose(layered.sigma_xyz_mm, plain.sigma_xyz_mm, rtol=2e-3, atol=1e-9)


@pytest.mark.parametrize(("use", "roll_deg"), [("column", 35.0), ("row", 35.0), ("both", 0.0)])
def test_sigma_is_how_far_a_point_moves(measured, use, roll_deg):
    """Setup: one coordinate is changed by its sigma. Expected: the point moves by the sigma.

    For both coordinates their effects add in quadrature.
    """
    rig, _, camera_px, projector_px = measured(GEL_ON_WINDOW, roll_deg)
    _, sigma, valid = looked_at(rig, camera_px, projector_px, use)
    assert valid.all()  # where there is no point, no value changes
    square = 0.0
    for axis in (0, 1) if use == "both" else (int(use == "row"),):
        step = np.zeros(2)
        step[axis] = 0.01
        ahead, behind = (
            looked_at(rig, camera_px, projector_px + sign * step, use)[0] for sign in (1, -1)
        )
        square = square + ((ahead - behind) / 2) ** 2
    np.testing.assert_allclose(np.sqrt(square), sigma, rtol=2e-2, atol=2e-7)


def test_a_surface_above_the_last_interface_is_no_point(calibration, surface, project):
    layers = PlaneLayers((-1.0, -2.0), (1.5, 1.4))
    rig = dataclasses.replace(calibration, layers=layers)
    result = triangulate(decoded_from(project(calibration, surface(calibration))), rig, "column")
    assert not result.valid.any()
    assert not result.points_world_mm.any()


def test_layers_are_kept_in_the_calibration(calibration, tmp_path):
    path = tmp_path / "calibration.yaml"
    write_calibration(path, dataclasses.replace(calibration, layers=WITH_A_GAP))
    assert read_calibration(path).layers == WITH_A_GAP
    write_calibration(path, calibration)
    assert "layers" not in path.read_text()
    assert read_calibration(path).layers is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("layers: 3\n", "no list"),
        ("layers: [ { top_mm: 3. } ]\n", "top_mm and ior"),
        ("layers: [ { top_mm: 3., ior: glass } ]\n", "ior is no number"),
        ("layers: [ { top_mm: 3., ior: 0.5 } ]\n", "at least 1"),
        ("layers: [ { top_mm: 3, ior: 1.5 }, { top_mm: 4, ior: 1.4 } ]\n", "from the top"),
        ("layers: [ { top_mm: 500., ior: 1.5 } ]\n", "above the camera"),
    ],
)
def test_wrong_layers_raise_an_error(calibration, tmp_path, text, message):
    path = tmp_path / "calibration.yaml"
    write_calibration(path, calibration)
    path.write_text(path.read_text() + text)
    with pytest.raises(CaptureError, match=message):
        read_calibration(path)


def test_a_list_of_another_length_is_rejected():
    with pytest.raises(InputError, match="2 interfaces and 1 indices"):
        PlaneLayers((1.0, 0.0), (1.5,))
