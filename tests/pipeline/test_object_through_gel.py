"""From object to object: pressed into a gel, seen through gel and window, compared with itself."""

import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from tests.letters import raised_text
from twin.config import load_experiment
from twin.pipeline import measure

SMALL = {
    "camera.binning": 4,
    "camera.width_px": 1280,
    "camera.height_px": 960,
    "press.relief_pitch_mm": 0.05,
    "press.solver_pitch_mm": 0.16,
    "decode.filter_taps": 0,
}
SMOOTH_DEG = 10.0
CASES = {
    "ball": ({"kind": "ball"}, 2.0, "radius_1"),
    "step": ({"kind": "step", "height_mm": 0.1, "edge_radius_mm": 0.02}, 20.0, "step_height"),
    "groove": ({"kind": "v_groove", "depth_mm": 0.1, "angle_deg": 160.0}, 20.0, "depth"),
    "text": ({"kind": "mesh"}, 20.0, "height"),
}
HEIGHT = {
    "name": "height",
    "quantity": "step_height",
    "nominal_mm": 0.2,
    "plus_minus_um": 10.0,
}


@pytest.fixture(scope="module")
def text(tmp_path_factory):
    """Raised letters of 0.2 mm as an STL."""
    file = tmp_path_factory.mktemp("text") / "text.stl"
    raised_text("HTL", 0.2, 0.5).export(file)
    return str(file)


def measured(name, text, **more):
    specimen, force_n, _ = CASES[name]
    if name == "text":
        specimen = specimen | {"file": text}
        more = {"measurand": [HEIGHT]} | more
    settings = SMALL | {"specimen": specimen, "press.force_n": force_n} | more
    return measure(load_experiment("examples/gel_on_window", settings))


@pytest.mark.parametrize("name", CASES)
def test_the_object_is_measured_as_well_as_the_gel_shows_it(mi, name, text):
    """Setup: 320 x 240 pixels, through 4 mm of gel and 3 mm of glass, without noise and filter.

    Expected: where the coat is smooth within two pixels, triangulation through the layers errs by
    less than 1 um RMS (it was 2.4 mm in air). The object deviates by at most 3 um more than the
    true coat does, and its dimension by at most 3 um more than the true coat's.
    """
    done = measured(name, text, **{"camera.noise": False})
    truth, points = done.truth, done.points
    flat = truth.normals_world[..., 2] >= np.cos(np.deg2rad(SMOOTH_DEG))
    if name == "ball":
        flat = truth.lit  # it bends, but never breaks
    smooth = binary_erosion(flat & truth.lit, iterations=2) & points.valid
    error_um = 1e3 * (points.world_mm - truth.points_world_mm)[smooth][:, 2]
    assert smooth.sum() > 10_000
    assert np.sqrt(np.mean(error_um**2)) < 1.0
    figures, limits = done.figures, CASES[name][2]
    own_um, coat_um = figures.known("object_rms_um"), figures.known("true_face_object_rms_um")
    assert own_um <= coat_um + 3.0
    assert figures.known(f"object_{limits}_mm") == pytest.approx(
        figures.known(f"object_{limits}_true_face_mm"), abs=3e-3
    )
    # And the gel itself shows these objects: the requested dimension is within 3 um of the drawing.
    assert abs(figures.known(f"object_{limits}_error_um")) < 3.0


def test_raised_text_gets_its_verdict(mi, text):
    """The same with the camera's noise: 0.2 mm within 10 um, as the verdict states."""
    done = measured("text", text)
    (height,) = done.object.quantities
    assert height.decision == "within tolerance"
    assert abs(height.error) + height.uncertainty.expanded < 10.0
    assert done.figures["least_margin_um"] == pytest.approx(height.margin)
    assert done.figures.known("object_coverage_share") > 0.8
