"""Errors of printed dots against the displacement that the model of the elastomer computes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import griddata

from reconstruction.markers import DotPattern, DotStatus, DotTracks, FittedDots
from reconstruction.photometric import HeightMap, gel_motion
from twin.config import load_experiment
from twin.mechanics import material_points
from twin.optics.stack import Truth
from twin.pipeline.press import press_smooth
from twin.results.printed_dots import NO_DOTS, measured_dots, sensor_dots

SHAPE, PIXEL_MM, SIGMA_PX = (120, 160), 0.1268, 0.02
PITCH_MM, RADIUS_MM = np.array([2.2, 2.0]), 0.4
DOTS = {
    "photometric.markers": {
        "pitch_x_mm": PITCH_MM[0], "pitch_y_mm": PITCH_MM[1],
        "radius_mm": RADIUS_MM, "relative_albedo": 0.2,
    }
}  # fmt: skip


@pytest.fixture(scope="module")
def experiment():
    return load_experiment("examples/gelsight_ball", DOTS)


@pytest.fixture(scope="module")
def pressed(experiment):
    return press_smooth(experiment)


@pytest.fixture(scope="module")
def truth():
    row, col = np.indices(SHAPE, dtype=np.float32)
    x, y = (col - (SHAPE[1] - 1) / 2) * PIXEL_MM, ((SHAPE[0] - 1) / 2 - row) * PIXEL_MM
    points, zero = np.stack([x, y, 0 * x], axis=-1).astype(np.float32), np.zeros(SHAPE, np.float32)
    everywhere = np.ones(SHAPE, bool)
    return Truth(points, np.zeros_like(points), zero, zero, zero, everywhere, everywhere)


@pytest.fixture(scope="module")
def lattice_mm():
    i, j = np.meshgrid(np.arange(-4, 5), np.arange(-3, 4))
    return np.column_stack([i.ravel(), j.ravel()]) * PITCH_MM


@pytest.fixture(scope="module")
def displacement_mm(experiment, pressed, lattice_mm):
    """Displacements of the lattice, by triangles between the material points of the nodes."""
    X, Y = material_points(pressed, experiment.elastomer, experiment.press)
    x, y = np.meshgrid(pressed.face_x_mm, pressed.face_y_mm)
    moved = np.stack([x - X, y - Y], axis=-1).reshape(-1, 2)
    coarse = slice(None, None, 7)  # triangles of all nodes take seconds
    return griddata((X.ravel()[coarse], Y.ravel()[coarse]), moved[coarse], lattice_mm)


def motion_of(places_mm, moved_mm):
    """Return displacements in an image of flat gel, with errors of SIGMA_PX."""
    middle = np.array([(SHAPE[0] - 1) / 2, (SHAPE[1] - 1) / 2])
    places = middle + places_mm[:, ::-1] * (-1.0, 1.0) / PIXEL_MM
    noise = np.random.default_rng(1).normal(0.0, SIGMA_PX, places.shape)
    moved = moved_mm[:, ::-1] * (-1.0, 1.0) / PIXEL_MM + noise
    one = np.ones(len(places))
    dots = FittedDots(places, np.full(places.shape, 0.01), RADIUS_MM / PIXEL_MM * one, 0.8 * one)
    pattern = DotPattern(dots, RADIUS_MM / PIXEL_MM, 0.8, PITCH_MM.min() / PIXEL_MM)
    sigma = np.full(places.shape, SIGMA_PX)
    tracks = DotTracks(pattern, dots, moved, sigma, np.zeros(len(places), np.uint8))
    flat = np.zeros((4, *SHAPE), np.float32)
    return gel_motion(
        tracks, HeightMap(flat[0], flat[1:3], flat[3].astype(np.uint8), PIXEL_MM), 0.0
    )


def test_errors_are_those_of_the_centres(experiment, pressed, truth, lattice_mm, displacement_mm):
    """Setup: 63 dots that move with the material, up to 60 um, with errors of 0.02 px.

    Expected: true displacements by the triangles to 0.5 um; RMS error 0.02 px in mm within 15 %,
    error over sigma 1 within 15 %; all dots counted, none with a wrong partner.
    """
    motion = motion_of(lattice_mm, displacement_mm)
    dots = measured_dots(experiment, motion, truth, pressed)
    np.testing.assert_allclose(dots.true_mm, displacement_mm, atol=5e-4)
    assert 0.03 < np.hypot(*dots.true_mm.T).max() < 0.08
    figures = dots.figures
    error_um = figures["dots_displacement_error_rms_um"]
    assert error_um == pytest.approx(1e3 * SIGMA_PX * PIXEL_MM, rel=0.15)
    assert figures["dots_error_over_sigma"] == pytest.approx(1.0, abs=0.15)
    assert figures["dots_in_image"] == figures["dots_tracked"] == len(lattice_mm)
    assert figures["dots_assigned_wrongly"] == 0
    assert figures["dots_field_error_rms_um"] < 4.0 * error_um
    assert dots.warnings == ()


def test_wrong_partners_are_counted(experiment, pressed, truth, lattice_mm, displacement_mm):
    """Setup: two displacements are wrong by one pitch. Expected: 2; 1 if one of them is LOST."""
    wrong = displacement_mm.copy()
    wrong[[5, 40], 0] += PITCH_MM[0]
    motion = motion_of(lattice_mm, wrong)
    assert measured_dots(experiment, motion, truth, pressed).figures["dots_assigned_wrongly"] == 2
    motion.tracks.status[5] = DotStatus.LOST
    figures = measured_dots(experiment, motion, truth, pressed).figures
    assert figures["dots_assigned_wrongly"] == 1
    assert figures["dots_lost"] == 1


def test_dots_at_the_border_are_not_in_the_image(experiment, pressed, truth):
    """Setup: the image ends 0.2 mm beyond the last column of centres. Expected: 7 dots fewer."""
    cols = round((8.8 + 0.2) / PIXEL_MM + (SHAPE[1] - 1) / 2)
    cut = replace(truth, **{name: getattr(truth, name)[:, :cols] for name in vars(truth)})
    assert measured_dots(experiment, None, cut, pressed).in_image == 56


def test_a_background_without_dots(experiment, pressed, truth):
    """Expected: no pattern, a warning, and no figure of a displacement."""
    blank = np.full((*SHAPE, 3), 120.0, np.float32)
    assert sensor_dots(experiment, blank, 3) is None
    dots = measured_dots(experiment, None, truth, pressed)
    assert dots.warnings == (NO_DOTS,)
    assert dots.figures == {"dots_in_image": 63, "dots_tracked": 0}
