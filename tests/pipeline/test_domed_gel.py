"""Undeformed coat of a domed pad from CAD under a photometric sensor."""

import numpy as np
import pytest

from reconstruction.errors import InputError
from twin.config import load_experiment
from twin.optics.colour_trace import ColourScene
from twin.pipeline.reference_presses import bare_face, rest_surface, undeformed

RADIUS_MM = 16.0
"""Radius of scenes/examples/dome.stl, whose facets have edges of 1 mm."""
PAD = {
    "mechanics.model": "fem",
    "mechanics.pad": {"file": "scenes/examples/dome.stl"},
    "elastomer.thickness_mm": 4.0,
    "elastomer.length_x_mm": 14.0,
    "elastomer.length_y_mm": 11.0,
    "layers.window.thickness_mm": 5.25,
    "press.solver_pitch_mm": 0.25,
    "photometric.width_px": 64,
    "photometric.height_px": 48,
}


@pytest.fixture(scope="module")
def experiment():
    return load_experiment("examples/gelsight_ball", PAD)


@pytest.fixture(scope="module")
def coat(experiment):
    return undeformed(experiment)


def test_the_undeformed_coat_is_the_dome(coat):
    """Expected: a cap of 16 mm within 3 um RMS, though the facets are up to 10 um inside it."""
    x_mm, y_mm = np.meshgrid(coat.face_x_mm, coat.face_y_mm)
    off_mm = coat.face_z_mm - RADIUS_MM + np.sqrt(RADIUS_MM**2 - x_mm**2 - y_mm**2)
    assert np.sqrt(np.mean(off_mm**2)) < 0.003
    assert not coat.contact.any()


def test_pixels_image_the_dome_along_their_lines_of_sight(mi, experiment, coat):
    """Expected: points and slopes of the cap; lines that spread by 1 / (index x distance)."""
    rest = rest_surface(experiment, ColourScene(experiment, bare_face(experiment, coat)), coat)
    x_mm, y_mm, z_mm = np.moveaxis(rest.points_mm.astype(float), -1, 0)
    inner = np.hypot(x_mm, y_mm) < 5.0
    depth_mm = np.sqrt(RADIUS_MM**2 - x_mm**2 - y_mm**2)
    assert np.abs(z_mm - RADIUS_MM + depth_mm)[inner].max() < 0.006
    for slope, along_mm in zip(rest.slopes, (-y_mm, x_mm), strict=True):
        assert np.abs(slope - along_mm / depth_mm)[inner].max() < 0.03
    level_mm = x_mm - z_mm * rest.sight[1]
    spread = np.polyfit(level_mm[inner], rest.sight[1][inner], 1)[0]
    layers = experiment.layers.values()
    raised_mm = sum(layer.thickness_mm * (1.0 - 1.0 / layer.ior) for layer in layers)
    distance_mm = experiment.camera.pose.standoff_mm - raised_mm
    assert spread == pytest.approx(-1.0 / (experiment.layers["gel"].ior * distance_mm), rel=0.05)


def test_a_lamp_beside_the_flank_of_a_dome_is_refused(experiment):
    low = load_experiment("examples/gelsight_ball", PAD | {"lamps.blue_1.height_mm": 2.0})
    with pytest.raises(
        InputError, match=r"lamps\.blue_1: its lower edge is at 1 mm, allowed above"
    ):
        undeformed(low)
