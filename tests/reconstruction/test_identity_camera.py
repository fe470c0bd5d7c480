"""Every sequence is decoded correctly by a camera with the pixels of the projector.

Oracle: the coordinate of camera pixel (row, col) is (col, row), exactly; with noise the error in
units of the predicted sigma has the variance 1. Words without phase are steps: their error is at
most half a word, and its mean square is (w^2 - 1) / 12 over whole pixels.
"""

import numpy as np
import pytest

from reconstruction.decoding.decode import DecodeOptions, decode
from reconstruction.errors import InputError
from reconstruction.patterns import PatternSet
from reconstruction.rig.sensor import SensorNoise

SIZE = {"width_px": 160, "height_px": 96}
LEVELS = {"low_level": 30, "high_level": 220}
READ_NOISE_DN = 4.0
QUIET = SensorNoise(0.0, 0.0, 0.0, 255.0)
NOISY = SensorNoise(1e-6, 1e6 * READ_NOISE_DN, 0.0, 255.0)  # no shot noise, as there is none
UNFILTERED = DecodeOptions(filter_taps=0)
ROW_PERIOD = {"row_periods_px": (12.0,)}
BARE = {"uniform": False}
ONE_AXIS = ({}, {"axes": ("column",)}, {"axes": ("row",)})
SHIFTED = {"axes": ("column",), "first_shifts_deg": (90.0,)}
PHASE = [
    {"code": code, "steps": steps, "period_px": 16.0} | axes | extra
    for code in ("gray", "complementary_gray", "shifted_gray")
    for steps, axes, extra in (
        (3, {}, {}),
        (4, ONE_AXIS[1], {}),
        (5, ONE_AXIS[2], BARE),
        (8, {}, ROW_PERIOD),
        (3, {}, BARE | {"inverse": True}),
        (3, SHIFTED, {}),
        (4, {}, {"first_shifts_deg": (180.0, -90.0)} | ROW_PERIOD),
    )
]
PHASE += [
    {"code": "gray", "steps": 4, "period_px": 10.0, "word": word, "inverse": inverse} | BARE
    for word in ("binary", "xor_02", "xor_04")
    for inverse in (False, True)
]
SEVERAL = [
    {"code": code, "steps": steps} | periods | axes | extra
    for code, periods in (
        ("hierarchical", {"period_px": 16.0, "further_periods_px": (64.0, 200.0)}),
        ("hierarchical", {"period_px": 200.0}),
        ("heterodyne", {"period_px": 14.0, "further_periods_px": (15.0,)}),
        ("micro", {"period_px": 14.0, "further_periods_px": (12.1, 13.0, 15.9, 16.4)}),
    )
    for steps, axes, extra in ((3, {}, BARE), (4, ONE_AXIS[1], {}), (6, ONE_AXIS[2], BARE))
]
SEVERAL.append({
    "code": "hierarchical", "steps": 4, "period_px": 16.0, "further_periods_px": (170.0,),
    "row_periods_px": (12.0, 100.0), "first_shifts_deg": (10.0, 20.0, 30.0, 40.0),
})  # fmt: skip
WORDS = [
    {"code": "gray", "steps": 0, "word": word, "period_px": width, "inverse": inverse} | axes | bare
    for word in ("reflected", "binary", "xor_02", "xor_04")
    for width, inverse, axes, bare in (
        (1.0, False, {}, {}),
        (4.0, True, ONE_AXIS[1], BARE),
        (2.5, True, ONE_AXIS[2], {}),
        (8.0, True, {}, BARE | {"row_periods_px": (3.0,)}),
    )
]


def observed(patterns, noise_dn=0.0, seed=0):
    """Return the projected images recorded by a camera of the same pixels."""
    stack = np.stack([patterns.image(frame) for frame in patterns.frames])
    rng = np.random.default_rng(seed)
    return np.rint(stack + rng.normal(0.0, noise_dn, stack.shape)).astype(np.uint8)


def errors_px(decoded, axis):
    rows, cols = decoded.mask_reason.shape
    row, col = np.mgrid[0:rows, 0:cols].astype(float)
    single = decoded.column if axis == "column" else decoded.row
    return single.coordinate_px - (col if axis == "column" else row), single.sigma_px


def case_name(case):
    return "-".join(str(value) for value in case.values())


@pytest.mark.parametrize("case", PHASE + SEVERAL, ids=case_name)
def test_phase_shifting_gives_each_pixel_itself(case):
    """8-bit rounding of the pattern is the only error: sigma 0.29 levels of 95."""
    patterns = PatternSet(**SIZE, **LEVELS, **case)
    decoded = decode(observed(patterns), patterns, QUIET, UNFILTERED)
    # Where a fringe wraps, plain words and coarse levels may be in doubt.
    assert np.mean(decoded.valid) > 0.85
    for axis in patterns.axes:
        error_px, _ = errors_px(decoded, axis)
        coarsest_px = max(patterns.period_along(axis), 16.0)
        assert np.max(np.abs(error_px[decoded.valid])) < 0.002 * coarsest_px
    unused = {"column", "row"} - set(patterns.axes)
    for axis in unused:
        single = decoded.column if axis == "column" else decoded.row
        assert not single.coordinate_px.any()
        assert not single.sigma_px.any()


@pytest.mark.parametrize("case", PHASE + SEVERAL, ids=case_name)
def test_noise_of_phase_shifting_is_as_predicted(case):
    """Chi-square per pixel of 1 within 5 %: more than 10,000 values with a spread of 1.4 %."""
    patterns = PatternSet(**SIZE, **LEVELS, **case)
    stack = observed(patterns, READ_NOISE_DN, seed=1)
    decoded = decode(stack, patterns, NOISY, UNFILTERED)
    assert np.mean(decoded.valid) > 0.75
    for axis in patterns.axes:
        error_px, sigma_px = errors_px(decoded, axis)
        ratio = error_px[decoded.valid] / sigma_px[decoded.valid]
        assert np.mean(np.square(ratio)) == pytest.approx(1.0, abs=0.08)


@pytest.mark.parametrize("noise_dn", [0.0, READ_NOISE_DN])
@pytest.mark.parametrize("case", WORDS, ids=case_name)
def test_words_without_phase_give_the_middle_of_their_stripe(case, noise_dn):
    patterns = PatternSet(**SIZE, **LEVELS, **case)
    decoded = decode(observed(patterns, noise_dn), patterns, NOISY)
    assert decoded.valid.all()
    for axis in patterns.axes:
        error_px, sigma_px = errors_px(decoded, axis)
        width_px = patterns.period_along(axis)
        assert np.max(np.abs(error_px)) <= 0.5 * width_px
        assert sigma_px.min() == pytest.approx(width_px / np.sqrt(12.0), rel=1e-3)
        if width_px == int(width_px):
            mean_square = (width_px**2 - 1.0) / 12.0
            assert np.mean(np.square(error_px)) == pytest.approx(mean_square, rel=0.01, abs=1e-9)


def test_words_without_light_have_no_coordinate():
    """Expected: DARK where neither a pair nor white and black differ by more than their noise."""
    for extra in ({"inverse": True, "uniform": False}, {}):
        patterns = PatternSet(**SIZE, **LEVELS, steps=0, code="gray", period_px=2.0, **extra)
        stack = observed(patterns, READ_NOISE_DN)
        rng = np.random.default_rng(3)
        stack[:, :20, :30] = np.rint(rng.normal(40.0, READ_NOISE_DN, stack[:, :20, :30].shape))
        decoded = decode(stack, patterns, NOISY)
        assert np.all(decoded.mask_reason[:20, :30] == 1)
        assert decoded.valid[20:].all()


def test_a_bit_at_its_threshold_matters_only_if_the_word_changes_by_more_than_one():
    """Reflected words at a border: either neighbour is right. A binary word is lost there."""
    for word, is_kept in (("reflected", True), ("binary", False)):
        patterns = PatternSet(**SIZE, **LEVELS, steps=0, code="gray", period_px=8.0, word=word,
                              axes=("column",), inverse=True, uniform=False)  # fmt: skip
        stack = observed(patterns)
        # Word 7 to 8: all bits of a binary one. The middle of the levels is a whole number.
        stack[:, :, 63] = (stack[:, :, 63] // 2) + (stack[:, :, 64] // 2)
        decoded = decode(stack, patterns, NOISY)
        assert decoded.valid[:, 63].all() == is_kept
        assert decoded.valid[:, 63].any() == is_kept


@pytest.mark.parametrize(
    ("case", "message"),
    [
        ({"steps": 0, "code": "complementary_gray"}, "use code 'gray'"),
        ({"steps": 0, "code": "gray", "uniform": False}, "nothing to compare"),
        ({"steps": 0, "code": "gray", "period_px": 400.0}, "width of a word"),
        ({"code": "shifted_gray", "word": "binary"}, "use code 'gray'"),
        ({"word": "octal"}, "allowed are binary, reflected"),
        ({"axes": ("row", "column")}, "allowed are"),
        ({"axes": 3}, "allowed are"),
        ({"first_shifts_deg": (0.0,)}, "give 2 numbers"),
        ({"first_shifts_deg": (0.0, 999.0)}, "at most 360"),
        ({"row_periods_px": (8.0, 9.0)}, "as many periods"),
        ({"row_periods_px": (3.0,)}, "at least 4"),
        ({"inverse": 1}, "true or false"),
        ({"code": "hierarchical", "further_periods_px": (300.0,), "inverse": True}, "has no bits"),
        ({"steps": False}, "steps is False"),
        (
            {"code": "hierarchical", "further_periods_px": (300.0,), "row_periods_px": (8.0, 90.0)},
            "unambiguous over 90",
        ),
    ],
)
def test_impossible_sequences_are_rejected_in_one_line(case, message):
    with pytest.raises(InputError, match=message) as caught:
        PatternSet(**SIZE, **case)
    assert "\n" not in str(caught.value)
