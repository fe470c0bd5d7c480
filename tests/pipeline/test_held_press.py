"""A held press through the pipeline: cached stages, and the force from the measured coat."""

import numpy as np
import pytest

from reconstruction.errors import InputError
from reconstruction.triangulation import PointMap
from twin.config import load_experiment, vary
from twin.config.sensor_layer import sensor_layer_of
from twin.pipeline import Memory
from twin.pipeline.compensation import compensate_points
from twin.pipeline.press import force_waiting_time, press, press_specimen, waiting_time

GEL = {
    "press.solver_pitch_mm": 0.2,
    "press.relief_pitch_mm": 0.05,
    "elastomer.relaxation": {"shares": [0.2, 0.1], "times_s": [1.0, 20.0]},
}
TO_DEPTH = {"press.control": "depth", "press.force_n": "absent", "press.depth_mm": 0.5}


@pytest.fixture(scope="module")
def to_depth():
    return load_experiment("examples/gel_on_window", GEL | TO_DEPTH)


def test_times_and_moduli_share_one_contact(to_depth):
    """Setup: presses to one depth, at four times and moduli, with a ramp and a slide.

    Expected: only ramp and slide are solved again; each result is that of a separate press.
    """
    memory, slide = Memory(), {"press.slide_x_mm": 0.1, "elastomer.friction_coefficient": 0.4}
    changes = [
        {},
        {"press.hold_s": 3.0},
        {"press.hold_s": 30.0, "elastomer.young_modulus_kpa": 300.0},
        {"press.hold_s": 3.0, "press.ramp_s": 1.0},
        {"press.hold_s": 3.0} | slide,
    ]
    for change in changes:
        experiment = vary(to_depth, change)
        cached, separate = press(experiment, memory).pressed, press_specimen(experiment)
        assert cached.force_n == separate.force_n
        assert cached.initial_force_n == separate.initial_force_n
        assert cached.face_z_mm.tobytes() == separate.face_z_mm.tobytes()
        assert (cached.shear is None) == ("press.slide_x_mm" not in change)
    solved = {name: times for name, times, _, _ in memory.stages()}
    assert solved["shape"] == 3


def test_the_force_from_the_coat_is_that_of_the_relaxed_gel(to_depth):
    """Setup: exact points of the coat of a held press. Expected: its force within 2 %."""
    experiment = vary(to_depth, {"press.hold_s": 10.0})
    pressed = press_specimen(experiment)
    rows, cols = (
        np.flatnonzero(np.abs(nodes) < 3.2)[::2] for nodes in (pressed.face_y_mm, pressed.face_x_mm)
    )
    x, y = np.meshgrid(pressed.face_x_mm[cols], pressed.face_y_mm[rows])
    z = pressed.face_z_mm[np.ix_(rows, cols)]
    points = np.stack((x, y, z), axis=-1).astype(np.float32)
    sigma = np.full_like(points, 1e-3)
    coat = PointMap(points, sigma, np.zeros(x.shape, np.uint8), np.eye(4))
    compensated = compensate_points(coat, sensor_layer_of(experiment))
    assert pressed.force_n < 0.8 * pressed.initial_force_n
    assert compensated.force_n == pytest.approx(pressed.force_n, rel=0.02)


def test_waiting_time_of_an_experiment(to_depth):
    """Expected: 0 at a given depth, and one line for a change that is not positive."""
    assert waiting_time(to_depth, 1.0) == 0.0
    with pytest.raises(InputError, match="wait-um: found 0, allowed more than 0"):
        waiting_time(to_depth, 0.0)


def test_the_force_of_a_moving_press_is_that_of_its_duration(to_depth):
    """Setup: 0.5 mm at rates of 1 m/s, 0.25 mm/s and 1 nm/s; shares 0.2 and 0.1 of the modulus.

    Expected: the elastic force F0 at once, that of a ramp of 2 s, and 0.7 F0 after a long time.
    """
    elastic = press_specimen(to_depth).force_n
    ramp = press_specimen(vary(to_depth, {"press.ramp_s": 2.0})).force_n
    forces = [
        press_specimen(vary(to_depth, {"motion.z_mm_s": rate})).force_n
        for rate in (1e3, 0.25, 1e-6)
    ]
    assert forces == pytest.approx([elastic, ramp, 0.7 * elastic], rel=1e-3)


def test_waiting_time_of_the_force_in_closed_form(to_depth):
    """One term g: the force is 1 % above its end when g exp(-t / tau) = 0.01 (1 - g).

    After a ramp, g exp(-t / tau) (1 - exp(-ramp / tau)) tau / ramp if the force is proportional to
    time. The contact of a ball grows with the travel, so that its later steps count more.
    """
    one = {"elastomer.relaxation": {"shares": [0.2], "times_s": [3.0]}}
    expected_s = 3.0 * np.log(0.2 / (0.01 * 0.8))
    assert force_waiting_time(vary(to_depth, one), 1.0) == pytest.approx(expected_s, rel=1e-3)
    ramp = vary(to_depth, one | {"press.ramp_s": 2.0})
    linear_s = expected_s + 3.0 * np.log(1.5 * (1 - np.exp(-2.0 / 3.0)))
    assert linear_s < force_waiting_time(ramp, 1.0) < expected_s
    by_force = {"press.control": "force", "press.depth_mm": "absent", "press.force_n": 1.0}
    assert force_waiting_time(vary(to_depth, one | by_force), 1.0) == 0.0
    assert force_waiting_time(vary(to_depth, one), 26.0) == 0.0
    with pytest.raises(InputError, match="wait-percent: found 0, allowed more than 0"):
        force_waiting_time(to_depth, 0.0)
