import numpy as np
import pytest

from reconstruction.errors import InputError
from reconstruction.patterns import PatternSet


def test_the_papers_projector_needs_53_frames_and_7_and_6_bits(patterns):
    assert len(patterns.frames) == 18 + 18 + 8 + 7 + 1 + 1
    assert (patterns.gray_bits("column"), patterns.gray_bits("row")) == (7, 6)
    assert [patterns.frames[i].name for i in (3, 18, 36, 44, 51, 52)] == [
        "phase_column_03",
        "phase_row_00",
        "gray_column_00",
        "gray_row_00",
        "white",
        "black",
    ]
    assert patterns.index("gray", "row") == slice(44, 51)


def test_first_phase_frame_is_brightest_at_pixel_zero_and_every_period(patterns):
    profile = patterns.profile(patterns.frames[0])
    assert profile.shape == (1280,)
    assert profile[0] == profile[18] == 255
    assert profile[9] == 0


def test_next_phase_frame_moves_against_the_coordinate(patterns):
    """Expected: cos(phi + 2 pi n / N) has its peak one step (1 px here) further left."""
    assert np.argmax(patterns.profile(patterns.frames[1])[9:27]) + 9 == 17


@pytest.mark.parametrize("axis", ["column", "row"])
def test_gray_word_counts_half_periods(patterns, axis):
    frames = [patterns.frames[i] for i in range(53)][patterns.index("gray", axis)]
    bits = np.array([patterns.profile(frame) > 0 for frame in frames], dtype=int)
    word = np.cumsum(bits, axis=0) % 2  # Gray to binary, most significant bit first
    index = np.sum(word << np.arange(len(frames))[::-1, None], axis=0)
    np.testing.assert_array_equal(index, np.arange(index.size) // 9)
    assert patterns.word_count(axis) == index.max() + 1
    assert np.all(np.sum(np.abs(np.diff(bits)), axis=0) <= 1)


def test_plain_gray_counts_periods():
    patterns = PatternSet(100, 60, code="gray")
    assert len(patterns.frames) == 36 + 3 + 2 + 2
    finest = patterns.frames[patterns.index("gray", "column")][-1]
    expected = np.isin(np.arange(100) // 18, [1, 2, 5])
    np.testing.assert_array_equal(patterns.profile(finest) > 0, expected)


def test_images_vary_along_their_axis_only(patterns):
    column, row = patterns.image(patterns.frames[5]), patterns.image(patterns.frames[25])
    assert column.shape == row.shape == (720, 1280)
    assert np.all(column == column[:1])
    assert np.all(row == row[:, :1])
    assert np.ptp(column[0].astype(int)) == np.ptp(row[:, 0].astype(int)) == 255


def test_levels_bound_all_frames():
    patterns = PatternSet(64, 36, low_level=10, high_level=200)
    for frame in patterns.frames:
        assert patterns.profile(frame).min() >= 10
        assert patterns.profile(frame).max() <= 200
    assert np.all(patterns.image(patterns.frames[-2]) == 200)
    assert np.all(patterns.image(patterns.frames[-1]) == 10)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width_px": 0}, "width_px"),
        ({"height_px": 7.5}, "height_px"),
        ({"period_px": 3.9}, "period_px"),
        ({"period_px": float("nan")}, "period_px"),
        ({"steps": 2}, "steps"),
        ({"steps": True}, "steps"),
        ({"low_level": 255}, "low_level"),
        ({"low_level": 90, "high_level": 90}, "high_level"),
        ({"period_px": "18"}, "period_px"),
    ],
)
def test_bad_arguments_are_named(change, message):
    with pytest.raises(InputError, match=message):
        PatternSet(**({"width_px": 1280, "height_px": 720} | change))


def test_unknown_axis_kind_and_frame_are_rejected(patterns):
    with pytest.raises(InputError, match="axis"):
        patterns.gray_bits("diagonal")
    with pytest.raises(InputError, match="no 'phase' frames"):
        patterns.index("phase")
    with pytest.raises(InputError, match="no frame"):
        PatternSet(1280, 720, steps=4).profile(patterns.frames[17])


def test_shifted_stripes_change_in_the_middle_of_the_periods():
    """Period 18.2 px: the shifted word rises at 9.1, 27.3 and 45.5, first shown at 10, 28 and 46.

    135 pixels of 18 px end at 7.94 shifted periods, 3 bits; pixel 135 starts the eighth.
    """
    patterns = PatternSet(100, 60, period_px=18.2, code="shifted_gray")
    frames = patterns.frames[patterns.index("gray", "column")][patterns.gray_bits("column") :]
    bits = np.array([patterns.profile(frame) > 0 for frame in frames], dtype=int)
    word = np.cumsum(bits, axis=0) % 2
    index = np.sum(word << np.arange(len(frames))[::-1, None], axis=0)
    assert np.flatnonzero(np.diff(index)).tolist() == [9, 27, 45, 63, 81]
    assert index.tolist()[:11] == [0] * 10 + [1]
    for width_px, bits in ((135, 3), (136, 4)):
        words = PatternSet(width_px, 60, code="shifted_gray").words("column")
        assert words[1].bits == bits
