"""The one-trace renderer against closed forms: radiometry, geometry, shadows, determinism."""

import numpy as np
import pytest
import trimesh

from tests.optics.scenes import coated_scene
from twin.config import load_experiment
from twin.optics.light import pattern_set
from twin.pipeline import render

SMALL = {"camera.width_px": 240, "camera.height_px": 184, "camera.binning": 2}
# 240 binned pixels over the whole field of view
WIDE = {"value": 36.0, "source": "test"}


@pytest.fixture(scope="module")
def experiment():
    changes = SMALL | {"camera.pixel_pitch_um": WIDE, "coating.flake_fraction": 0.0}
    return load_experiment("examples/slab_balls", changes)


def white_frame(experiment, stack):
    patterns = pattern_set(experiment.projector, experiment.patterns)
    return stack.frames[patterns.index("white").start]


def test_plane_radiance_is_albedo_times_irradiance_over_pi(mi, experiment, plane):
    """L = rho/pi E; E on the plane = E1 / z^2 * cos(surface) / cos(projector axis)."""
    from twin.optics.scene import rig_of

    stack, rig = render(experiment, plane), rig_of(experiment)
    truth = stack.truth.points_world_mm[92 // 2, 120 // 2]
    pose = rig.projector.T_world_from_device
    ray = truth - pose[:3, 3]
    axial_mm = ray @ pose[:3, 2]
    cos_surface, cos_axis = -ray[2] / np.linalg.norm(ray), axial_mm / np.linalg.norm(ray)
    irradiance = rig.irradiance_at_1mm / axial_mm**2 * cos_surface / cos_axis
    expected = experiment.coating.base_albedo / np.pi * irradiance
    assert white_frame(experiment, stack)[92 // 2, 120 // 2] == pytest.approx(expected, rel=1e-4)


def test_flux_through_an_oblique_plane_is_the_projectors(mi, experiment):
    """Integral of the irradiance over the world plane that catches the image: the flux, 0.5 %."""
    from twin.optics.scene import rig_of

    rig, step_mm = rig_of(experiment), 0.5
    side = np.arange(-200.0, 200.0, step_mm)
    x_mm, y_mm = (axis.ravel() for axis in np.meshgrid(side, side))
    points = mi.Point3f(x_mm, y_mm, np.zeros_like(x_mm))
    column_px, row_px, axial_mm = (np.array(value) for value in rig.projector.project(points))
    pinhole, source = rig.projector.pinhole, rig.projector.T_world_from_device[:3, 3]
    distance_mm = np.linalg.norm(np.stack([x_mm, y_mm, 0 * x_mm], axis=-1) - source, axis=-1)
    irradiance = rig.irradiance_at_1mm / axial_mm**2 * source[2] / axial_mm
    inside = (np.abs(column_px - (pinhole.width_px - 1) / 2) < pinhole.width_px / 2) & (
        np.abs(row_px - (pinhole.height_px - 1) / 2) < pinhole.height_px / 2
    )
    assert np.all(distance_mm[inside] > axial_mm[inside] * (1 - 1e-6))
    flux = irradiance[inside].sum() * step_mm**2
    assert flux == pytest.approx(experiment.projector.flux_mw, rel=5e-3)


def test_truth_lies_on_the_surface_and_projects_to_its_pixel(mi, experiment, bump):
    from twin.optics.rig import true_calibration

    truth = render(experiment, bump).truth
    hit = truth.lit
    points = truth.points_world_mm[hit].astype(np.float64)
    surface = 0.8 * np.exp(-(points[:, 0] ** 2 + points[:, 1] ** 2) / 4.0)
    np.testing.assert_allclose(points[:, 2], surface, atol=3e-4)  # chords of 50 um facets
    calibration = true_calibration(experiment)
    T_proj_from_world = np.linalg.inv(calibration.T_world_from_proj)
    in_projector = points @ T_proj_from_world[:3, :3].T + T_proj_from_world[:3, 3]
    wanted = calibration.projector.project(in_projector)
    np.testing.assert_allclose(truth.column_px[hit], wanted[:, 0], atol=1e-3)
    np.testing.assert_allclose(truth.row_px[hit], wanted[:, 1], atol=1e-3)
    T_cam_from_world = np.linalg.inv(calibration.T_world_from_cam)
    in_camera = points @ T_cam_from_world[:3, :3].T + T_cam_from_world[:3, 3]
    pixels = calibration.camera.project(in_camera)
    rows, cols = np.nonzero(hit)
    np.testing.assert_allclose(pixels, np.stack([cols, rows], axis=-1), atol=2e-3)


def test_an_occluder_casts_the_geometric_shadow(mi, experiment, plane):
    """A wall at the field, projector at 25 deg: shadow length = height * tan(angle at edge)."""
    wall = trimesh.creation.box(extents=[0.5, 40.0, 6.0])
    wall.apply_translation([8.0, 0.0, 3.0])
    both = trimesh.util.concatenate([plane, wall])
    both.vertex_normals = np.concatenate([plane.vertex_normals, wall.vertex_normals])
    truth = render(experiment, both).truth
    from twin.optics.rig import true_calibration

    source = true_calibration(experiment).T_world_from_proj[:3, 3]
    edge = np.array([7.75, 0.0, 6.0])
    tip_x_mm = edge[0] - edge[2] * (source[0] - edge[0]) / (source[2] - edge[2])
    row = truth.points_world_mm[92 // 2]
    dark = row[(row[:, 2] < 0.01) & ~truth.lit[92 // 2], 0]
    dark = dark[dark < 7.7]
    assert dark.min() == pytest.approx(tip_x_mm, abs=0.25)  # one camera pixel is 0.24 mm


def test_same_experiment_same_bytes(mi, experiment, bump):
    first, second = render(experiment, bump), render(experiment, bump)
    assert all(a.tobytes() == b.tobytes() for a, b in zip(first.frames, second.frames, strict=True))
    assert first.truth.points_world_mm.tobytes() == second.truth.points_world_mm.tobytes()


def test_light_is_linear_in_the_pattern(mi, experiment, bump):
    """Frames of one N-step set add up to N times their mean level: N/2 (white + black)."""
    stack = render(experiment, bump)
    patterns = pattern_set(experiment.projector, experiment.patterns)
    mean = np.mean(stack.frames[patterns.index("phase", "column")], axis=0)
    white, black = (stack.frames[patterns.index(kind).start] for kind in ("white", "black"))
    lit = white > 0.5 * white.max()
    # 8-bit rounding of the 18 levels moves their mean by up to half a level of 255
    np.testing.assert_allclose(mean[lit], 0.5 * (white + black)[lit], rtol=1 / 255)


def test_one_look_up_per_smooth_pixel_is_as_good_as_one_per_sample(mi, bump):
    """Both methods, paper's rig at demo resolution: frames to 0.4 % of white, phase to 1e-4 px.

    A bump with an occluding wall, so that mixed pixels (one look-up per sample) occur as well.
    """
    from reconstruction.decoding.decode import DecodeOptions, decode
    from reconstruction.rig.sensor import SensorNoise
    from twin.optics.light import light_tables
    from twin.optics.one_trace import trace_stack
    from twin.optics.scene import rig_of

    centre = {"camera.binning": 2, "camera.width_px": 640, "camera.height_px": 480}
    experiment = load_experiment("examples/slab_balls", centre)
    wall = trimesh.creation.box(extents=[0.3, 20.0, 2.0])
    wall.apply_translation([3.0, 0.0, 0.5])
    face = trimesh.util.concatenate([bump, wall])
    face.vertex_normals = np.concatenate([bump.vertex_normals, wall.vertex_normals])
    patterns = pattern_set(experiment.projector, experiment.patterns)
    tables = light_tables(experiment.projector, patterns)
    scene, rig = coated_scene(experiment, face), rig_of(experiment)
    shared, each = (
        np.stack(trace_stack(scene, rig, tables, 4, smooth_within_px=limit))
        for limit in (0.25, -1.0)
    )
    white = each[patterns.index("white").start].max()
    assert np.abs(shared - each).max() < 4e-3 * white
    sensor = SensorNoise(gain_dn_per_e=1.0, read_noise_e=1.0, black_level_dn=0.0, saturation_dn=1e9)
    columns = [
        decode(stack / white * 4000.0, patterns, sensor, DecodeOptions(filter_taps=0)).column
        for stack in (shared, each)
    ]
    difference = columns[0].coordinate_px - columns[1].coordinate_px
    assert np.abs(difference).max() < 1e-3
    assert np.sqrt(np.mean(difference**2)) < 1e-4
