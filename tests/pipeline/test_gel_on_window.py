"""Through a gel from press to score: rays refracted by the decoder, or a decoder for air."""

import numpy as np
import pytest

from reconstruction.errors import InputError
from twin.config import load_experiment
from twin.pipeline import measure, press_specimen, record

TINY = {
    "camera.width_px": 160,
    "camera.height_px": 120,
    "camera.pixel_pitch_um": {"value": 54.0, "source": "test"},
    "projector.width_px": 320,
    "projector.height_px": 180,
    "patterns.steps": 4,
    "press.solver_pitch_mm": 0.2,
    "press.relief_pitch_mm": 0.05,
    "decode.filter_taps": 0,
}


def test_a_gel_measured_in_air_looks_thinner(mi):
    """Setup: the shipped example at low resolution; the camera looks straight down.

    Expected: the camera's ray is hardly bent, the projector's intersects it higher up, by
    sum d_i (1 - tan i' / tan i) at the incidence i of the image's centre: within 3 %, the angle
    changes over the field.
    Why: the score states the error that refraction makes in a sensor that does not correct it.
    """
    in_air = TINY | {"decode.through_layers": False}
    done = measure(load_experiment("examples/gel_on_window", in_air))
    assert any("takes the layers for air" in line for line in done.warnings)
    incidence = np.deg2rad(25.0)
    raised_mm = sum(
        d_mm * (1 - np.tan(np.arcsin(np.sin(incidence) / n)) / np.tan(incidence))
        for d_mm, n in ((4.0, 1.41), (3.0, 1.52))
    )
    assert done.score.against_truth.z_bias_um == pytest.approx(1e3 * raised_mm, rel=0.03)
    assert done.score.against_truth.wrong_order_pixels == 0
    assert done.score.against_truth.completeness > 0.9


def test_a_decoder_that_knows_the_layers_measures_the_coat(mi):
    """Setup: 160 x 120 pixels of 60 um, without noise and filter; 2.4 mm off when taken for air.

    Expected: the coat within 0.2 um RMS, which is how the ball bends within a pixel; its radius
    within 0.1 % of the true coat's.
    """
    shown = {"camera.width_px": 640, "camera.height_px": 480, "camera.binning": 4}
    press = {"press.solver_pitch_mm": 0.16, "press.relief_pitch_mm": 0.05}
    exact = {"camera.noise": False, "decode.filter_taps": 0}
    done = measure(load_experiment("examples/gel_on_window", shown | press | exact))
    truth, sphere = done.score.against_truth, done.score.spheres[0]
    assert truth.z_rmse_um < 0.2
    assert truth.completeness > 0.9
    assert sphere.measured.radius_mm == pytest.approx(sphere.true_face.radius_mm, rel=1e-3)
    assert not any("air" in line for line in done.warnings)


def test_a_gel_that_nobody_describes_is_refused():
    experiment = load_experiment(
        "examples/slab_balls",
        {
            "elastomer.layout": "contact_face",
            "press.solver_pitch_mm": 0.4,
            "press.depth_mm": 0.2,
            "press.back_pressure_kpa": 0.0,
        },
    )
    with pytest.raises(InputError, match=r"layers: found none.*add \[layers.gel\]"):
        record(experiment, press_specimen(experiment))
