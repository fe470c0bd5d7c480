"""Orientation of images, and irradiance against distance and angle, in closed form."""

import numpy as np
import pytest
import trimesh

from twin.config import load_experiment
from twin.optics.light import pattern_set
from twin.optics.rig import true_calibration
from twin.pipeline import render

SMALL = {
    "camera.width_px": 60,
    "camera.height_px": 45,
    "camera.pixel_pitch_um": {"value": 144.0, "source": "test"},
    "coating.flake_fraction": 0.0,
    "patterns.steps": 3,
    "patterns.code": "gray",
}


def rendered(face, changes=None):
    experiment = load_experiment("examples/slab_balls", SMALL | (changes or {}))
    return experiment, render(experiment, face)


def white_frame(experiment, stack):
    patterns = pattern_set(experiment.projector, experiment.patterns)
    return stack.frames[patterns.index("white").start]


def test_right_is_right_and_up_is_up(mi, plane):
    """A raised tile at world (+8, +5): right of the middle and in the upper half of the image."""
    tile = trimesh.creation.box(extents=[3.0, 3.0, 1.0])
    tile.apply_translation([8.0, 5.0, 0.5])
    both = trimesh.util.concatenate([plane, tile])
    both.vertex_normals = np.concatenate([plane.vertex_normals, tile.vertex_normals])
    experiment, stack = rendered(both)
    rows, columns = np.nonzero(stack.truth.points_world_mm[..., 2] > 0.9)
    camera = true_calibration(experiment).camera
    # The tile's top is 213 mm away; its centre is at its pinhole projection, within 0.5 px.
    wanted = camera.project([8.0, -5.0, experiment.camera.pose.standoff_mm - 1.0])
    np.testing.assert_allclose([columns.mean(), rows.mean()], wanted, atol=0.5)
    assert columns.min() > 30
    assert rows.max() < 22


def test_projector_columns_grow_to_the_right_and_rows_downwards(mi, plane):
    """Projector at azimuth 0 without roll: its image on the coat is oriented as the camera's."""
    truth = rendered(plane)[1].truth
    assert np.all(np.diff(truth.column_px, axis=1)[truth.lit[:, 1:]] > 0)
    assert np.all(np.diff(truth.row_px, axis=0)[truth.lit[1:]] > 0)
    x_mm, y_mm = truth.points_world_mm[..., 0], truth.points_world_mm[..., 1]
    assert np.all(np.diff(x_mm, axis=1) > 0)
    assert np.all(np.diff(y_mm, axis=0) < 0)


@pytest.mark.parametrize(("standoff_mm", "polar_deg"), [(250.0, 25.0), (400.0, 45.0)])
def test_light_falls_with_the_square_of_the_distance_and_the_cosine(
    mi, plane, standoff_mm, polar_deg
):
    """Every lit pixel: rho / pi * E1 / z^2 * cos(plane, ray) / cos(axis, ray)."""
    from twin.optics.rig import irradiance_at_1mm

    pose = {"projector.pose.standoff_mm": standoff_mm, "projector.pose.polar_deg": polar_deg}
    experiment, stack = rendered(plane, pose)
    calibration = true_calibration(experiment)
    T_world_from_proj = calibration.T_world_from_proj
    ray = stack.truth.points_world_mm.astype(np.float64) - T_world_from_proj[:3, 3]
    distance_mm, axial_mm = np.linalg.norm(ray, axis=-1), ray @ T_world_from_proj[:3, 2]
    cos_plane, cos_axis = -ray[..., 2] / distance_mm, axial_mm / distance_mm
    white = irradiance_at_1mm(experiment.projector, calibration.projector) / axial_mm**2
    expected = experiment.coating.base_albedo / np.pi * white * cos_plane / cos_axis
    radiance = white_frame(experiment, stack)
    inside = stack.truth.lit & (radiance > 0.0)
    inside &= (np.abs(stack.truth.column_px - 639.5) < 600) & (
        np.abs(stack.truth.row_px - 359.5) < 330
    )
    assert inside.sum() > 500
    assert np.ptp(expected[inside]) > 0.05 * expected[inside].mean()
    np.testing.assert_allclose(radiance[inside], expected[inside], rtol=1e-3)
