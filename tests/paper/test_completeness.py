"""Completeness against relief and specimen, on a press with a known coat."""

import numpy as np
import pytest

from twin.config import load_experiment
from twin.optics.stack import Truth
from twin.paper.completeness import completeness_of, specimen_height_mm
from twin.pipeline.press import press_specimen

PITCH_MM = 0.05


@pytest.fixture(scope="module")
def scene():
    """An 8 mm ball 0.5 mm deep in a coat that touches it, imaged by 241 x 241 pixels."""
    experiment = load_experiment(
        "examples/slab_ball",
        {
            "elastomer.layout": "contact_face",
            "press.back_pressure_kpa": 0.0,
            "press.depth_mm": 0.5,
            "press.solver_pitch_mm": 0.1,
        },
    )
    pressed = press_specimen(experiment)
    line = np.arange(-120, 121) * PITCH_MM
    x, y = np.meshgrid(line, line)
    col = np.interp(line, pressed.face_x_mm, np.arange(pressed.face_x_mm.size)).round().astype(int)
    row = np.interp(line, pressed.face_y_mm, np.arange(pressed.face_y_mm.size)).round().astype(int)
    points = np.stack([x, y, pressed.face_z_mm[np.ix_(row, col)]], axis=-1)
    blank, everywhere = np.zeros(x.shape, np.float32), np.ones(x.shape, bool)
    truth = Truth(
        points.astype(np.float32), np.zeros_like(points, np.float32), *[blank] * 3,
        lit=everywhere, measured=everywhere,
    )  # fmt: skip
    return experiment, pressed, truth, points


def test_perfect_points_cover_the_whole_contact(scene):
    experiment, pressed, truth, points = scene
    measured = completeness_of(experiment, truth, points, truth.lit, pressed)
    assert measured.contact == measured.contact_points == measured.specimen_points == 1.0


def test_missing_and_wrong_points_reduce_the_shares(scene):
    """No points on x < 0: 50 % of a round contact. All points with 60 um error: none within 50."""
    experiment, pressed, truth, points = scene
    right = truth.lit & (points[..., 0] > 0)
    half = completeness_of(experiment, truth, points, right, pressed)
    assert half.contact == pytest.approx(0.5, abs=0.03)
    assert half.missing == pytest.approx(0.5, abs=0.01)
    off = points + np.array([0.0, 0.0, 0.06])
    wrong = completeness_of(experiment, truth, off, truth.lit, pressed)
    assert wrong.contact == 0.0
    assert wrong.contact_points == 1.0


def test_share_of_the_specimen_is_that_of_its_contact(scene):
    """Inside the contact the coat coincides with the ball: share = (contact + rim) / outline.

    In the rim the distance of coat and ball is less than 50 um. The contact's radius a is that of
    the pressure; a rim of at most 0.25 a bounds the share from above.
    """
    experiment, pressed, truth, points = scene
    measured = completeness_of(experiment, truth, points, truth.lit, pressed)
    cell = float(np.diff(pressed.x_mm)[0]) ** 2
    contact = pressed.contact.sum() * cell / (np.pi * 4.0**2)
    assert contact * 0.97 < measured.specimen < contact * 1.25**2


def test_the_specimens_face_is_the_ball(scene):
    experiment, pressed, _, points = scene
    z_mm = specimen_height_mm(experiment, pressed.depth_mm, points)
    r = np.hypot(points[..., 0], points[..., 1])
    near = r < 3.0
    ball = 0.5 - (4.0 - np.sqrt(16.0 - r[near] ** 2))
    np.testing.assert_allclose(z_mm[near], ball, atol=0.02)
    assert not np.isfinite(z_mm[r > 4.2]).any()


def test_direct_is_compared_with_the_specimen_only(scene):
    experiment, _, truth, points = scene
    measured = completeness_of(experiment, truth, points, truth.lit, None)
    assert measured.contact is None
    assert measured.specimen == 1.0
