"""Faces and recordings shared by the accuracy tests."""

from dataclasses import replace

import numpy as np
import pytest

from tests.pipeline.reference import FREE
from twin.config import Experiment, load_experiment
from twin.mechanics import PressedElastomer
from twin.pipeline import press_specimen

# The middle of the field at the demo's resolution (2 x 2 binning): 320 x 240 of 968 x 732 pixels.
CENTRE = {"camera.binning": 2, "camera.width_px": 640, "camera.height_px": 480}
IDEAL = {"camera.noise": False, "decode.filter_taps": 0}


@pytest.fixture(scope="session")
def base() -> Experiment:
    """Return an experiment with small images and a coarse face."""
    return load_experiment("examples/slab_balls", FREE)


@pytest.fixture(scope="session")
def pressed() -> PressedElastomer:
    """Return the default press: two balls."""
    return press_specimen(load_experiment("examples/slab_balls"))


@pytest.fixture(scope="session")
def ball_cap(pressed) -> PressedElastomer:
    """Return an ideal 4 mm ball cap, 1 mm high, on a flat face, in place of the relief."""
    x_mm = np.arange(-8.0, 8.01, 0.02)
    r2 = x_mm[None, :] ** 2 + x_mm[:, None] ** 2
    cap_mm = np.sqrt(np.maximum(16.0 - r2, 0.0)) - 3.0
    return replace(
        pressed, face_x_mm=x_mm, face_y_mm=x_mm, face_z_mm=np.where(cap_mm > 0, cap_mm, 0.0)
    )
