import dataclasses

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from reconstruction.decoding.decode import AxisDecode, Decoded, DecodeOptions, Reason, decode
from reconstruction.errors import InputError
from reconstruction.patterns import PatternSet
from reconstruction.rig.calibration import Calibration, Pinhole
from reconstruction.rig.layers import PlaneLayers
from reconstruction.rig.sensor import SensorNoise
from reconstruction.triangulation import EpipolarTolerance, triangulate


def decoded_from(projector_px, sigma_px=0.01):
    """Return a Decoded as if these projector pixels had been measured, in double precision."""
    shape = projector_px.shape[:2]
    image = np.zeros(shape, np.float32)
    column, row = (
        AxisDecode(
            np.ascontiguousarray(projector_px[..., i]),
            image,
            np.zeros(shape, np.int16),
            image,
            image,
            np.full(shape, sigma_px, np.float32),
            image,
            image,
            image,
        )
        for i in range(2)
    )
    return Decoded(column, row, np.zeros(shape, np.uint8))


@pytest.mark.parametrize("use", ["column", "row", "both"])
def test_points_come_back(calibration, surface, project, use):
    """Expected: < 0.01 um, with distortion in both devices and the projector's axis off-image."""
    assert calibration.projector.cy_px > calibration.projector.height_px
    points = surface(calibration)
    result = triangulate(decoded_from(project(calibration, points)), calibration, use)
    assert result.valid.all()
    assert np.max(np.abs(result.points_world_mm - points)) < 1e-5


@pytest.mark.parametrize("layers", [None, PlaneLayers((1.0,), (1.5,))])
def test_a_single_axis_needs_no_epipolar_test(calibration, surface, project, layers):
    """Expected: the points that columns give with any rows; the other axis cannot be used."""
    rig = dataclasses.replace(calibration, layers=layers)
    whole = decoded_from(project(calibration, surface(calibration)))
    nowhere = dataclasses.replace(whole.row, coordinate_px=np.zeros_like(whole.row.coordinate_px))
    alone = dataclasses.replace(whole, row=nowhere, axes=("column",))
    result = triangulate(alone, rig, "column")
    unchecked = triangulate(whole, rig, "column", EpipolarTolerance(1e9))
    np.testing.assert_array_equal(result.points_world_mm, unchecked.points_world_mm)
    assert result.valid.mean() > 0.9
    for use in ("row", "both"):
        with pytest.raises(InputError, match="only 'column' was decoded"):
            triangulate(alone, rig, use)


FOLDING = (-0.5, 0.0, 0.0, 0.0, 0.0)
FOLD_RADIUS = np.sqrt(2.0 / 3.0)


def test_pixels_without_a_ray_have_no_point(calibration, aim):
    """Setup: camera to 0.7 of its focal length; its lens r (1 - 0.5 r^2) ends at 0.544."""
    camera = Pinhole(120, 90, 110.0, 110.0, 59.5, 44.5, FOLDING)
    rig = dataclasses.replace(calibration, camera=camera, T_world_from_cam=aim([0, 0, 50], [0] * 3))
    decoded = decoded_from(np.broadcast_to([640.0, 360.0], (90, 120, 2)))
    result = triangulate(decoded, rig, tolerance=EpipolarTolerance(1e9))
    rows, cols = np.mgrid[:90, :120]
    lost = np.hypot(cols - 59.5, rows - 44.5) / 110.0 > FOLD_RADIUS * 2.0 / 3.0
    assert lost.any()
    np.testing.assert_array_equal(result.mask_reason[lost], Reason.NO_POINT)
    assert result.valid[~lost].mean() > 0.9
    assert not result.points_world_mm[lost].any()


def test_coordinates_beyond_the_projector_fold_give_no_point(aim):
    """Setup: a plane, partly beyond the fold of the projector's lens.

    Expected: all before it is found, and no point beyond, though the pixels are on the image and
    have solutions there; next to the fold, those before it are within the tolerance.
    """
    camera = Pinhole(120, 90, 60.0, 60.0, 59.5, 44.5)
    projector = Pinhole(1280, 720, 500.0, 500.0, 639.5, 359.5, FOLDING)
    poses = aim([0.0, 0.0, 214.0], [0.0] * 3), aim([125.0, -110.0, 216.0], [0.0] * 3)
    rig = Calibration(camera, projector, *poses)
    pixels = np.stack(np.meshgrid(np.arange(120), np.arange(90)), axis=-1)
    rays = np.concatenate([camera.unproject(pixels), np.ones((90, 120, 1))], axis=-1)
    inside = 214.0 * rays @ rig.T_proj_from_cam[:3, :3].T + rig.T_proj_from_cam[:3, 3]
    radius = np.hypot(inside[..., 0], inside[..., 1]) / inside[..., 2]
    result = triangulate(decoded_from(projector.project(inside)), rig, "both")
    T = np.linalg.inv(rig.T_world_from_proj)
    x, y, z = np.moveaxis(result.points_world_mm[result.valid] @ T[:3, :3].T + T[:3, 3], -1, 0)
    assert (np.hypot(x, y) / z).max() < FOLD_RADIUS + 1e-6
    assert result.valid[radius < 0.99 * FOLD_RADIUS].all()
    assert (radius > 1.1 * FOLD_RADIUS).mean() > 0.02
    assert not result.valid[radius > 1.1 * FOLD_RADIUS].any()


@settings(max_examples=60)
@given(
    angle_deg=st.floats(10.0, 50.0),
    azimuth_deg=st.floats(0.0, 360.0),
    distance_mm=st.floats(120.0, 400.0),
    camera_k1=st.sampled_from([0.0, -0.2, 0.15]),
    projector_k1=st.sampled_from([0.0, -0.1, 0.1]),
    tangential=st.floats(-1e-3, 1e-3),
    cy_px=st.floats(-300.0, 1200.0),
    relief_mm=st.floats(0.0, 3.0),
)
def test_any_rig_triangulates_its_projected_points(
    aim, surface, project, *, angle_deg, azimuth_deg, distance_mm, camera_k1, projector_k1,
    tangential, cy_px, relief_mm,
):  # fmt: skip
    camera = Pinhole(40, 30, 300.0, 310.0, 18.0, 16.0, (camera_k1, 0.05, tangential, 1e-4, 0.0))
    lens = (projector_k1, 0.0, 1e-4, tangential, 0.0)
    projector = Pinhole(1280, 720, 1500.0, 1500.0, 600.0, cy_px, lens)
    angle, azimuth = np.radians(angle_deg), np.radians(azimuth_deg)
    side = np.sin(angle) * np.array([np.cos(azimuth), np.sin(azimuth)])
    calibration = Calibration(
        camera,
        projector,
        aim([0.0, 0.0, 214.0], [0.0, 0.0, 0.0]),
        aim([*(distance_mm * side), distance_mm * np.cos(angle)], [0.0, 0.0, 0.0]),
    )
    points = surface(calibration, relief_mm)
    result = triangulate(decoded_from(project(calibration, points)), calibration, "both")
    assert result.valid.all()
    assert np.max(np.abs(result.points_world_mm - points)) < 1e-5
    along_column = abs(np.cos(azimuth)) > 0.3
    assume(along_column)
    result = triangulate(decoded_from(project(calibration, points)), calibration, "column")
    assert result.valid.all()
    assert np.max(np.abs(result.points_world_mm - points)) < 1e-5


def test_sigma_is_the_spread_of_z(calibration, surface, project):
    """Setup: known noise on both coordinates. Expected: sigma_z within 3 % for every use."""
    points, rng = surface(calibration), np.random.default_rng(5)
    exact = project(calibration, points)
    for use in ("column", "row", "both"):
        normalised = []
        for _ in range(5):
            noisy = exact + rng.normal(0.0, [0.02, 0.01], exact.shape)
            decoded = decoded_from(noisy)
            column = dataclasses.replace(
                decoded.column, sigma_px=np.full(exact.shape[:2], 0.02, np.float32)
            )
            result = triangulate(dataclasses.replace(decoded, column=column), calibration, use)
            error_mm = (result.points_world_mm - points)[..., 2][result.valid]
            normalised.append(error_mm / result.sigma_z_mm[result.valid])
        assert np.std(normalised) == pytest.approx(1.0, rel=0.03)


def test_sigma_xyz_and_covariance_are_the_spread(aim, surface, project):
    """Setup: an oblique camera, 400 trials. Expected: sigma of x, y, z and their covariances 5 %.

    Why: 400 trials of 30 pixels know a standard deviation to 0.7 % and each pixel's to 3.5 %.
    """
    calibration = Calibration(
        Pinhole(6, 5, 50.0, 50.0, 2.0, 2.0, (-0.05, 0.1, 1e-3, 0.0, 0.0)),
        Pinhole(1280, 720, 1536.0, 1530.0, 640.0, 360.0, (-0.02, 0.01, 1e-4, 2e-4, 0.0)),
        aim([70.0, 90.0, 180.0], [0.0, 0.0, 0.0]),
        aim([-60.0, 10.0, 220.0], [0.0, 0.0, 0.0]),
    )
    points, rng = surface(calibration), np.random.default_rng(8)
    exact = project(calibration, points)
    result = triangulate(decoded_from(exact), calibration, "both")
    trials = [
        triangulate(decoded_from(exact + rng.normal(0.0, 0.01, exact.shape)), calibration, "both")
        for _ in range(400)
    ]
    error = np.stack([t.points_world_mm.astype(float) for t in trials]) - points
    ratio = error.std(axis=0) / result.sigma_xyz_mm
    assert np.sqrt(np.mean(ratio**2, axis=(0, 1))) == pytest.approx(1.0, rel=0.05)
    spread = np.einsum("nrci,nrcj->ij", error, error) / (len(trials) * 30)
    np.testing.assert_allclose(spread, result.covariance_mm2.mean(axis=(0, 1)), rtol=0.1)


def test_camera_frame_is_the_same_points(calibration, surface, project):
    """Expected: each pixel's point is on its own ray, z is the depth; 0 where masked."""
    decoded = decoded_from(project(calibration, surface(calibration)))
    decoded.mask_reason[5, 6] = Reason.DARK
    result = triangulate(decoded, calibration)
    pixels = calibration.camera.project(result.points_cam_mm[result.valid].astype(float))
    row, col = np.nonzero(result.valid)
    np.testing.assert_allclose(pixels, np.column_stack([col, row]), atol=1e-4)
    assert result.points_cam_mm[5, 6].tolist() == [0.0, 0.0, 0.0]
    assert result.points_cam_mm[10, 10, 2] == pytest.approx(214.0, abs=1.5)


def test_both_is_never_worse(calibration, surface, project):
    decoded = decoded_from(project(calibration, surface(calibration)))
    column, row, both = (
        triangulate(decoded, calibration, use).sigma_z_mm for use in ("column", "row", "both")
    )
    assert np.all(both <= column * 1.000001)
    assert np.all(both <= row * 1.000001)


def test_masked_pixels_remain_masked_and_zero(calibration, surface, project):
    decoded = decoded_from(project(calibration, surface(calibration)))
    decoded.mask_reason[3:5, 7] = Reason.SATURATED
    result = triangulate(decoded, calibration)
    assert np.all(result.mask_reason[3:5, 7] == Reason.SATURATED)
    assert np.all(result.points_world_mm[~result.valid] == 0.0)
    assert np.all(result.sigma_z_mm[~result.valid] == 0.0)
    assert result.valid.sum() == result.valid.size - 2
    assert decoded.valid.sum() == result.valid.sum()


@pytest.mark.parametrize("use", ["column", "row"])
def test_wrong_fringe_order_breaks_the_epipolar_condition(calibration, surface, project, use):
    exact = project(calibration, surface(calibration))
    exact[10, 20, 0] += 18.0
    exact[30, 40, 1] -= 18.0
    result = triangulate(decoded_from(exact), calibration, use)
    assert result.mask_reason[30, 40] == Reason.EPIPOLAR_MISMATCH
    assert np.sum(~result.valid) <= 2
    loose = triangulate(decoded_from(exact), calibration, use, EpipolarTolerance(1000.0))
    assert loose.valid.all()


def test_small_mismatch_is_tolerated(calibration, surface, project):
    exact = project(calibration, surface(calibration))
    exact[..., 1] += 0.5
    assert triangulate(decoded_from(exact), calibration, "column").valid.all()
    strict = EpipolarTolerance(absolute_px=0.1)
    result = triangulate(decoded_from(exact), calibration, "column", strict)
    assert np.all(result.mask_reason == Reason.EPIPOLAR_MISMATCH)


def test_rays_that_meet_behind_have_no_point(calibration, surface, project):
    """Setup: column so far aside that the projector plane crosses the ray behind the camera."""
    exact = project(calibration, surface(calibration))
    exact[..., 0] += 5000.0
    result = triangulate(decoded_from(exact), calibration, "column")
    assert not result.valid.any()
    assert np.all(np.isfinite(result.points_world_mm))


def test_parallel_planes_have_no_point():
    """Setup: a projector above the camera: its columns show every depth alike."""
    camera, above = Pinhole(4, 3, 100.0, 100.0, 2.0, 1.0), np.eye(4)
    above[1, 3] = 10.0
    calibration = Calibration(camera, camera, np.eye(4), above)
    pixels = np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0)), axis=-1)
    result = triangulate(decoded_from(pixels), calibration, "column")
    assert np.all(result.mask_reason == Reason.NO_POINT)


def test_images_of_another_size_are_rejected(calibration):
    decoded = decoded_from(np.zeros((5, 6, 2)))
    with pytest.raises(InputError, match="120 x 90"):
        triangulate(decoded, calibration)
    with pytest.raises(InputError, match="'column', 'row' and 'both'"):
        triangulate(decoded, calibration, "diagonal")
    with pytest.raises(InputError, match="sigmas"):
        EpipolarTolerance(sigmas=-1.0)


def test_frames_to_points(calibration, surface, project, synthesise):
    """Setup: the whole chain with sensor noise. Expected: z errors of one predicted sigma."""
    patterns, sensor = PatternSet(1280, 720), SensorNoise(0.17, 6.2, 64.0, 4095.0)
    points = surface(calibration)
    observed = project(calibration, points)
    clean = synthesise(
        patterns, observed[..., 0], observed[..., 1], mean_dn=1900.0, amplitude_dn=1500.0
    )
    noise = np.random.default_rng(2).normal(size=clean.shape)
    stack = np.rint(clean + noise * np.sqrt(sensor.variance_dn2(clean))).astype(np.uint16)
    decoded = decode(stack, patterns, sensor, DecodeOptions(filter_taps=0))
    result = triangulate(decoded, calibration)
    assert result.valid.all()
    error = (result.points_world_mm - points)[..., 2] / result.sigma_z_mm
    assert np.std(error) == pytest.approx(1.0, rel=0.03)
    assert np.mean(error) == pytest.approx(0.0, abs=0.04)
