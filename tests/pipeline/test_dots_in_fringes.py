"""Printed dots under fringes, through the camera and the decoder."""

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from reconstruction.errors import InputError
from reconstruction.pipeline import reconstruct
from twin.config import load_experiment, vary
from twin.mechanics import material_points
from twin.optics.checks import check_renderable
from twin.optics.rig import true_calibration
from twin.pipeline import Memory, measure, record
from twin.pipeline.captures import options_of
from twin.pipeline.fringes import dots_warnings
from twin.pipeline.lit_frames import albedo
from twin.pipeline.press import PressedFace

from .repeats import repeated_heights

DOTS = {
    "photometric.markers": {
        "pitch_x_mm": 1.2, "pitch_y_mm": 1.0, "radius_mm": 0.25, "relative_albedo": 0.2,
    }
}  # fmt: skip
CENTRE = {
    "camera.binning": 2, "camera.width_px": 320, "camera.height_px": 240, "decode.filter_taps": 0,
}  # fmt: skip


@pytest.fixture(scope="module")
def recordings(mi, pressed):
    """Return the experiment with dots and its recording, and the recording without dots."""
    experiment = load_experiment("examples/slab_balls", CENTRE | DOTS | {"render.samples": 16})
    bare = vary(experiment, {"photometric.markers": None})
    return experiment, record(experiment, pressed), record(bare, pressed)


@pytest.fixture(scope="module")
def covered(recordings):
    """Return the share of each pixel that dots cover, (row, col)."""
    experiment, dotted, bare = recordings
    white = dotted.capture.patterns.index("white").start
    ratio = dotted.radiance.frames[white] / bare.radiance.frames[white]
    return (1.0 - ratio) / (1.0 - experiment.photometric.markers.relative_albedo)


def test_sigma_inside_a_dot_is_the_scatter(recordings, covered):
    """Spread of z over 16 exposures over the predicted sigma, per pixel.

    Expected: in the median 0.9777 (chi-square, 15 degrees of freedom), here to 2 %, inside and
    outside the dots; sigma inside is larger by a factor between those of shot noise, r^-1/2, and of
    read noise, 1 / r.
    """
    experiment, recording, _ = recordings
    heights, sigmas, valid = repeated_heights(experiment, recording)
    sigma = np.mean(sigmas, axis=0)
    ratio = np.std(heights, axis=0, ddof=1) / np.where(valid, sigma, 1.0)
    inside, outside = valid & (covered > 0.999), valid & (covered < 0.001)
    assert np.count_nonzero(inside) > 1500
    assert np.median(ratio[inside]) == pytest.approx(0.9777, rel=0.02)
    assert np.median(ratio[outside]) == pytest.approx(0.9777, rel=0.02)
    r = experiment.photometric.markers.relative_albedo
    assert r**-0.5 < np.median(sigma[inside]) / np.median(sigma[outside]) < 1.0 / r


def test_bias_at_the_edge_of_a_dot(recordings, covered, pressed):
    """A pixel with a share s in a dot has the coordinate of the centroid of its light.

    Expected: without noise, the centroid is off the centre by at most (1 - r) s (1 - s) /
    (2 (1 - (1 - r) s)) px of an edge along a pixel's side, 0.19 px for r = 0.2; in z this is
    divided by the tangent of the triangulation angle. Inside the dots there is no bias.
    """
    experiment, _, _ = recordings
    ideal = vary(experiment, {"camera.noise": False})
    exact = record(ideal, pressed)
    points = reconstruct(exact.capture, options_of(ideal.decode)).point_map
    truth_mm = exact.truth.points_world_mm
    error_um = 1e3 * np.abs(points.points_world_mm[..., 2] - truth_mm[..., 2])
    edge = points.valid & (covered > 0.05) & (covered < 0.95)
    inside = points.valid & (covered > 0.999)
    dark = 1.0 - experiment.photometric.markers.relative_albedo
    share = np.linspace(0.0, 1.0, 1001)
    off_px = np.max(dark * share * (1.0 - share) / (2.0 * (1.0 - dark * share)))
    pixel_um = 1e3 * np.median(np.diff(truth_mm[60, :, 0]))
    angle = np.deg2rad(true_calibration(experiment).triangulation_angle_deg)
    largest_um = off_px * pixel_um / np.tan(angle)
    assert np.percentile(error_um[edge], 99) < 1.2 * largest_um
    assert np.percentile(error_um[edge], 99) > 0.7 * largest_um
    assert np.sqrt(np.mean(error_um[inside] ** 2)) < 0.15


def test_dots_on_a_moving_face_are_rejected():
    keys = {"motion.z_mm_s": 1.0, "camera.exposure_ms": 2.8}
    experiment = load_experiment("examples/slab_balls", DOTS | keys)
    with pytest.raises(
        InputError, match=r"photometric\.markers: .*remove \[photometric\.markers\]"
    ):
        check_renderable(experiment)


def test_dots_of_a_press_are_fixed_in_its_material(recordings, covered, pressed):
    """Why: the renderer gets the material coordinates by way of the stored geometry.

    Expected: no pixel more than 0.2 from half covered is in the dot of another material point. The
    displacement is up to 0.3 mm: at the places without load, a tenth of the pixels are.
    """
    experiment, recording, _ = recordings
    markers = experiment.photometric.markers
    places_mm = recording.truth.points_world_mm[..., :2].astype(np.float64)
    nodes_mm = pressed.face_y_mm, pressed.face_x_mm
    of_node = np.stack(material_points(pressed, experiment.elastomer, experiment.press), axis=-1)
    material_mm = RegularGridInterpolator(nodes_mm, of_node)(places_mm[..., ::-1])
    clear, pitch_mm = np.abs(covered - 0.5) > 0.2, (markers.pitch_x_mm, markers.pitch_y_mm)

    def wrong(points_mm):
        off_mm = points_mm - np.round(points_mm / pitch_mm) * pitch_mm
        inside = np.linalg.norm(off_mm, axis=-1) < markers.radius_mm
        return np.mean((inside != (covered > 0.5))[clear])

    assert wrong(material_mm) == 0.0
    assert wrong(places_mm) > 0.1


def test_dots_of_a_bare_specimen_have_a_warning(mi):
    """Expected: one line with the remedy."""
    keys = {
        "modality": "direct_fpp", "render.photons": 1000, "render.bounces": 0,
        "camera.width_px": 80, "camera.height_px": 60, "patterns.steps": 3,
    }  # fmt: skip
    measured = measure(load_experiment("examples/slab_ball", keys | DOTS))
    (line,) = (line for line in measured.warnings if "photometric.markers" in line)
    assert line.startswith("photometric.markers has no effect with modality = 'direct_fpp'")
    assert line.endswith("set modality = 'contact_fpp'")


def test_edges_of_dots_have_a_warning():
    """Expected: one line for a coat with dots, none without."""
    bare = load_experiment("examples/slab_balls")
    (line,) = dots_warnings(vary(bare, DOTS))
    assert "standard deviations do not include it; use smaller pixels" in line
    assert dots_warnings(bare) == []


def test_labels_of_the_albedo_have_the_dots(recordings, covered, pressed):
    """Expected: in dots `relative_albedo` of the coat's, outside them the coat's, to float32."""
    with_dots = recordings[0]
    without = vary(with_dots, {"photometric.markers": None})
    of_dots, of_coat = (
        albedo(experiment, PressedFace.of(pressed), Memory()) for experiment in (with_dots, without)
    )
    ratio = of_dots / of_coat
    r = with_dots.photometric.markers.relative_albedo
    np.testing.assert_allclose(ratio[covered > 0.999], r, rtol=1e-6)
    np.testing.assert_allclose(ratio[covered < 0.001], 1.0, rtol=1e-6)
