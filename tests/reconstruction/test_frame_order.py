"""Frames in a wrong order: each mistake is named, and honest captures pass."""

import numpy as np
import pytest

from reconstruction.capture.frame_order import check_order
from reconstruction.errors import CaptureError
from reconstruction.patterns import PatternSet
from reconstruction.rig.sensor import SensorNoise

STEPS = 8
SENSOR = SensorNoise(0.0625, 4.0, 4.0, 255.0)


@pytest.fixture(scope="module")
def rig(calibration):
    return calibration


@pytest.fixture(scope="module")
def observed(rig, surface, project):
    """Return the projector coordinates behind every camera pixel."""
    return project(rig, surface(rig))


def noisy(frames, rng):
    sigma = np.sqrt(SENSOR.variance_dn2(frames))
    return np.clip(np.rint(rng.normal(frames, sigma)), 0, 255).astype(np.uint8)


def record(synthesise, observed, code="complementary_gray", steps=STEPS, **light):
    patterns = PatternSet(1280, 720, steps=steps, code=code)
    frames = synthesise(patterns, observed[..., 0], observed[..., 1], blur_px=0.7, **light)
    return noisy(frames, np.random.default_rng(5)), patterns


def order_of(patterns, **changed):
    """Return frame numbers, with those of named slices replaced."""
    order = np.arange(len(patterns.frames))
    for name, change in changed.items():
        kind, axis = name.split("_")
        block = patterns.index(kind, axis)
        order[block] = change(order[block])
    return order


def exchange(first, second):
    def change(order, names):
        i, j = names.index(first), names.index(second)
        order[[i, j]] = order[[j, i]]
        return order

    return change


EXCHANGES = (
    ("phase_column_03", "phase_column_04"),
    ("gray_column_06", "gray_column_07"),
    ("gray_row_05", "gray_row_06"),
)


@pytest.mark.parametrize("code", ["complementary_gray", "shifted_gray", "gray"])
def test_honest_frames_pass(synthesise, observed, rig, code):
    stack, patterns = record(synthesise, observed, code)
    check_order(stack, patterns, SENSOR, rig)
    check_order(stack, patterns, SENSOR)


@pytest.mark.parametrize("steps", [3, 4, 5])
def test_few_steps_pass(synthesise, observed, rig, steps):
    check_order(*record(synthesise, observed, steps=steps), SENSOR, rig)


def test_several_periods_pass_and_exchanged_frames_are_named(synthesise, observed, rig):
    """Setup: three periods of five steps, no Gray code; each set of five is checked by itself."""
    patterns = PatternSet(
        1280, 720, 18.0, 5, code="hierarchical", further_periods_px=(150.0, 1400.0)
    )
    frames = noisy(
        synthesise(patterns, observed[..., 0], observed[..., 1]), np.random.default_rng(6)
    )
    check_order(frames, patterns, SENSOR, rig)
    frames[[6, 8]] = frames[[8, 6]]
    with pytest.raises(CaptureError, match=r"frames 6 .* and 8 .* look exchanged"):
        check_order(frames, patterns, SENSOR, rig)


def test_clipped_dark_and_nonlinear_frames_pass(synthesise, observed, rig):
    """Setup: a third of the field clipped, a third dark, and a projector of gamma 2.2."""
    stack, patterns = record(synthesise, observed)
    damaged = stack.astype(np.float64)
    damaged[:, :, :40] *= 2.5
    damaged[:, :, 80:] *= 0.02
    damaged = np.clip(np.rint(damaged), 0, 255).astype(np.uint8)
    check_order(damaged, patterns, SENSOR, rig)
    curved = np.rint(255.0 * (stack / 255.0) ** 2.2).astype(np.uint8)
    check_order(curved, patterns, SENSOR, rig)


def test_dark_frames_pass(rig):
    patterns = PatternSet(1280, 720, steps=STEPS)
    stack = np.full((len(patterns.frames), 90, 120), 7, np.uint8)
    check_order(stack, patterns, SENSOR, rig)


@pytest.mark.parametrize(("first", "second"), EXCHANGES)
def test_exchanged_frames_are_named(synthesise, observed, rig, first, second):
    stack, patterns = record(synthesise, observed)
    names = [frame.name for frame in patterns.frames]
    order = exchange(first, second)(np.arange(len(names)), names)
    with pytest.raises(CaptureError, match=f"{first}.*{second}.* look exchanged") as caught:
        check_order(stack[order], patterns, SENSOR, rig)
    assert "\n" not in str(caught.value)


def reverse(block):
    return block[::-1]


MISTAKES = {
    "one too many": (lambda p: np.roll(order_of(p), 1), "too many at the start"),
    "first missing": (lambda p: np.roll(order_of(p), -1), "first 1 frame.* missing"),
    "backwards": (lambda p: order_of(p)[::-1], "backwards"),
    "white, black": (lambda p: np.r_[order_of(p)[:-2], order_of(p)[:-3:-1]], "white and black"),
    "columns backwards": (lambda p: order_of(p, phase_column=reverse), "column.* backwards"),
    "both backwards": (
        lambda p: order_of(p, phase_column=reverse, phase_row=reverse),
        "column and row look recorded backwards",
    ),
    "columns shifted": (
        lambda p: order_of(p, phase_column=lambda b: np.roll(b, -1)),
        "along column .* shifted by 1",
    ),
    "phases exchanged": (
        lambda p: order_of(p, phase_column=lambda b: b + p.steps, phase_row=lambda b: b - p.steps),
        "phase frames of columns and rows look exchanged",
    ),
    "axes exchanged": (
        lambda p: np.r_[
            np.arange(p.steps, 2 * p.steps),
            np.arange(p.steps),
            order_of(p)[p.index("gray", "row")],
            order_of(p)[p.index("gray", "column")],
            order_of(p)[-2:],
        ],
        "rows and columns look exchanged",
    ),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_mistake_of_a_whole_set_is_named(synthesise, observed, rig, name):
    stack, patterns = record(synthesise, observed)
    order_for, message = MISTAKES[name]
    with pytest.raises(CaptureError, match=message):
        check_order(stack[order_for(patterns)], patterns, SENSOR, rig)


def test_frame_of_another_exposure_and_strange_frame_are_named(synthesise, observed, rig):
    stack, patterns = record(synthesise, observed)
    brighter = stack.copy()
    brighter[5] = np.clip(brighter[5] * 0.6, 0, 255)
    with pytest.raises(CaptureError, match=r"mixed exposures: frame 5 \(phase_column_05\) is 0\.6"):
        check_order(brighter, patterns, SENSOR, rig)
    twice = stack.copy()
    twice[5] = twice[1]
    with pytest.raises(CaptureError, match=r"frame 5 \(phase_column_05\) does not belong"):
        check_order(twice, patterns, SENSOR, rig)
