"""Thin lens of the camera: positions on the pupil, closed-form blur circle."""

import numpy as np
import pytest

from reconstruction.errors import InputError
from tests.optics.scenes import coated_scene
from twin.config import load_experiment
from twin.optics.export import export_stock
from twin.optics.light import light_tables, pattern_set
from twin.optics.rig import ThinLens, lens_places, true_calibration

OPEN = {
    "camera.depth_of_field": True,
    "camera.f_number": {"value": 2.8, "source": "test"},
    "camera.width_px": 384,
    "camera.height_px": 96,
    "camera.binning": 4,
    "patterns.steps": 3,
    "patterns.code": "gray",
    "coating.flake_fraction": 0.0,
}


@pytest.mark.parametrize("side", [2, 3, 4, 5, 6, 8, 16])
def test_places_have_the_discs_centroid_and_variance(side):
    """Uniform disc of radius 1: mean 0, variance 1/4 along every axis."""
    places = lens_places(side)
    np.testing.assert_allclose(places.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(places.T @ places / side**2, np.eye(2) / 4, atol=1e-12)
    assert np.hypot(*places.T).max() <= 1.0


def test_many_places_fill_the_disc_evenly_and_apart_from_the_grid():
    """256 samples: equal shares in rings and sectors, also of each quarter of the pixel."""
    places = lens_places(16)
    radius, angle = np.hypot(*places.T), np.arctan2(places[:, 1], places[:, 0])
    rings = np.histogram(radius**2, bins=4, range=(0, 1))[0]
    sectors = np.histogram(angle, bins=8, range=(-np.pi, np.pi))[0]
    assert np.abs(rings - 64).max() <= 3
    assert np.abs(sectors - 32).max() <= 3
    row, column = np.divmod(np.arange(256), 16)
    for quarter in ((row < 8) == top & ((column < 8) == left) for top in (0, 1) for left in (0, 1)):
        assert np.abs(places[quarter].mean(axis=0)).max() < 0.1


def test_one_sample_is_the_chief_ray():
    np.testing.assert_array_equal(lens_places(1), [[0.0, 0.0]])


def test_focus_is_the_plane_through_the_origin():
    experiment = load_experiment("examples/slab_balls", OPEN)
    lens = ThinLens.of(experiment.camera, true_calibration(experiment).T_world_from_cam)
    assert lens.focus_mm == pytest.approx(experiment.camera.pose.standoff_mm)
    assert lens.radius_mm == pytest.approx(50.0 / 2.8 / 2)
    assert ThinLens.of(load_experiment("examples/slab_balls").camera, np.eye(4)) is None


def test_rays_through_the_rim_span_the_circle_of_confusion(mi):
    """c = (f / N) fx |1/z - 1/z_focus| in undistorted pixels, at the centre and in a corner."""
    from twin.optics.scene import rig_of

    camera = rig_of(load_experiment("examples/slab_balls", OPEN)).camera
    lens, pinhole = camera.lens, camera.pinhole
    x_px, y_px = mi.Float([192.0, 1.0]), mi.Float([48.0, 90.0])
    for axial_mm in (190.0, lens.focus_mm, 230.0):
        images = []
        for place in (-1.0, 1.0):
            ray = camera.lens_ray(lens, x_px, y_px, (mi.Float(place), mi.Float(0.0)))
            way = axial_mm - camera.project(ray.o + 1e-3 * ray.d)[2] + 1e-3
            slope = camera.project(ray(1.0))[2] - camera.project(ray.o)[2]
            images.append(np.array(camera.project(ray(way / slope))[0], np.float64))
        wanted = 2 * lens.radius_mm * pinhole.fx_px * abs(1 / axial_mm - 1 / lens.focus_mm)
        np.testing.assert_allclose(np.abs(images[1] - images[0]), wanted, atol=0.02)


def test_lens_and_distortion_compose(mi):
    """In the focal plane, rays through all points of the lens meet the ray of the pinhole."""
    from twin.optics.scene import rig_of

    distorted = OPEN | {"camera.distortion": [-0.1, 0.02, 1e-3, -1e-3, 0.0]}
    camera = rig_of(load_experiment("examples/slab_balls", distorted)).camera
    x_px, y_px = mi.Float([5.0, 200.0, 380.0]), mi.Float([3.0, 50.0, 90.0])
    for place in ((0.0, 0.0), (0.9, 0.1), (-0.5, 0.7)):
        ray = camera.lens_ray(camera.lens, x_px, y_px, tuple(map(mi.Float, place)))
        at_focus = ray(-ray.o.z / ray.d.z)  # the camera looks straight down at z = 0
        pixels = camera.project(at_focus)
        np.testing.assert_allclose(np.array(pixels[0]), np.array(x_px), atol=5e-3)
        np.testing.assert_allclose(np.array(pixels[1]), np.array(y_px), atol=5e-3)


def test_an_edge_out_of_focus_has_the_discs_second_moment(mi, grid_face):
    """Sheet edge 6 mm above the focal plane: derivative of its image has variance 1/12 + c^2/16.

    Divided by the image of a whole sheet at that height, so that the light's own slope drops out;
    the coat is matte, since a highlight would give the places on the lens different weights.
    """
    from twin.optics.one_trace import trace_stack
    from twin.optics.scene import rig_of

    height_mm, edge_mm, samples = 6.0, 0.02, 256
    experiment = load_experiment("examples/slab_balls", OPEN)
    patterns = pattern_set(experiment.projector, experiment.patterns)
    tables, rig = light_tables(experiment.projector, patterns), rig_of(experiment)
    images = []
    for end_mm in (edge_mm, 16.0):
        sheet = grid_face(
            lambda x, _: height_mm + 0.0 * x, lambda x, _: (0.0 * x, 0.0 * x), pitch_mm=2.0
        )
        x_mm = np.interp(sheet.vertices[:, 0], [-16.0, 16.0], [-16.0, end_mm])
        sheet.vertices = np.column_stack([x_mm, sheet.vertices[:, 1:]])
        frames = trace_stack(coated_scene(experiment, sheet), rig, tables, samples)
        images.append(frames[patterns.index("white").start].astype(np.float64))
    profile = (images[0] / images[1]).mean(axis=0)
    share = -np.diff(profile)
    at_px = np.arange(share.size) + 0.5
    pinhole, lens = rig.camera.pinhole, rig.camera.lens
    axial_mm = lens.focus_mm - height_mm
    centre_px = pinhole.cx_px + pinhole.fx_px * edge_mm / axial_mm
    circle_px = 2 * lens.radius_mm * pinhole.fx_px * (1 / axial_mm - 1 / lens.focus_mm)
    assert circle_px > 8
    assert share.sum() == pytest.approx(1.0, abs=1e-3)
    mean_px = np.sum(share * at_px)
    # An edge is located by the samples that it parts: 0.034 px from each other on 8.7 px.
    assert mean_px == pytest.approx(centre_px, abs=0.02)
    variance = np.sum(share * (at_px - mean_px) ** 2)
    # A difference of box averages: the pixel box counts twice (1/12 each).
    assert variance == pytest.approx(circle_px**2 / 16 + 1 / 6, rel=0.02)


def test_without_depth_of_field_the_f_number_changes_no_byte(mi, plane):
    from twin.pipeline import render

    tiny = {"camera.width_px": 32, "camera.height_px": 24}
    frames = [
        render(
            load_experiment(
                "examples/slab_balls", tiny | {"camera.f_number": {"value": n, "source": "test"}}
            ),
            plane,
        ).frames
        for n in (2.8, 16.0)
    ]
    assert all(a.tobytes() == b.tobytes() for a, b in zip(*frames, strict=True))


def test_one_sample_sees_no_depth_of_field(mi):
    from twin.optics.scene import rig_of

    with pytest.raises(InputError, match=r"^render\.samples: found 1[^\n]*$"):
        rig_of(load_experiment("examples/slab_balls", OPEN | {"render.samples": 1}))


def test_the_exported_scene_has_the_thin_lens(mi, plane, tmp_path):
    small = {"projector.width_px": 320, "projector.height_px": 180}
    export_stock(load_experiment("examples/slab_balls", OPEN | small), plane, tmp_path)
    sensor = mi.load_file(str(tmp_path / "scene.xml")).sensors()[0]
    parameters = mi.traverse(sensor)
    assert parameters["aperture_radius"][0] == pytest.approx(50.0 / 2.8 / 2)
    assert parameters["focus_distance"][0] == pytest.approx(214.0)
