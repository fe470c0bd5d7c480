"""Random numbers of a frame: known words, normal and Poisson laws computed and counted."""

import numba
import numpy as np
import pytest
from scipy import stats

from twin.camera.noise import (
    FROM_NORMAL,
    Sensor,
    count_of_normal,
    exp_of_small,
    normal_pair,
    record_frame,
    small_counts,
    threefry,
)

# One count per electron, without dark current, read noise or a full well.
COUNTER = Sensor(*(np.float32(value) for value in (1, 0, np.inf, 0, 1, 0, 65535)))
KEY = tuple(np.array([11, 22, 33, 44], np.uint32))
PI = (
    0x243F6A88,
    0x85A308D3,
    0x13198A2E,
    0x03707344,
    0xA4093822,
    0x299F31D0,
    0x082EFA98,
    0xEC4E6C89,
)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ((0,) * 8, "9c6ca96a e17eae66 fc10ecd4 5256a7d8"),
        ((0xFFFFFFFF,) * 8, "2a881696 57012287 f6c7446e a16a6732"),
        (PI, "59cd1dbb b8879579 86b5d00c ac8b6d84"),
    ],
)
def test_words_are_those_of_threefry(words, expected):
    """Known answers of Random123, the authors' own library, for Threefry 4x32-20."""
    words = tuple(np.uint32(word) for word in words)
    random_words = threefry(words[:4], words[4:])
    assert " ".join(f"{word:08x}" for word in random_words) == expected


@numba.njit
def _pairs(words):
    numbers = np.zeros(words.shape, np.float32)
    for i in range(len(words)):
        numbers[i] = normal_pair(words[i, 0], words[i, 1])
    return numbers


def test_pairs_are_the_transform_of_box_and_muller():
    """Setup: words that are the ends of every quarter turn and of the radius, and random ones.

    Expected: radius and angle as in float64, to single precision.
    """
    rng = np.random.default_rng(2)
    ends = [0, 1, 2**29, 2**30 - 1, 2**30, 2**31 - 1, 2**31, 3 * 2**30, 2**32 - 1]
    pairs = [(a, b) for a in ends for b in ends]
    words = np.array(pairs + rng.integers(0, 2**32, (5000, 2)).tolist(), np.uint32)
    radius = np.sqrt(-2.0 * np.log((words[:, 0] + 0.5) / 2.0**32))
    # The two highest bits select the quarter turn, which starts 1/8 turn before its axis.
    within = (words[:, 1] & 0x3FFFFFFF).astype(float)
    within -= np.where(within >= 2**29, 2**30, 0)
    angle = np.pi / 2 * ((words[:, 1] >> 30) + within / 2**30)
    expected = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    # Near 1 a float32 has steps of 2^-24; those of the square of a small radius are twice as large.
    limit = np.where(radius > 0.1, 4e-6, 3e-4)[:, None]
    assert (np.abs(_pairs(words) - expected) < limit).all()


def test_normal_numbers_follow_the_normal_law():
    """Chi-square over classes of equal probability, jointly for both numbers of a pair."""
    words = np.random.default_rng(4).integers(0, 2**32, (1_000_000, 2), np.uint32)
    classes = np.floor(16 * stats.norm.cdf(_pairs(words))).astype(int)
    counts = np.bincount(16 * classes[:, 0] + classes[:, 1], minlength=256)
    assert stats.chisquare(counts).pvalue > 1e-3


def _counts(mean, normal):
    return np.vectorize(count_of_normal, otypes=[float])(mean, normal)


@pytest.mark.parametrize(("mean", "limit"), [(FROM_NORMAL, 2e-5), (1000.0, 1e-6), (40000.0, 1e-7)])
def test_all_probabilities_are_the_poisson_ones(mean, limit):
    """Setup: the normal number at which each count starts, by bisection in float64.

    Expected: total variation from the Poisson law below the limit; the counts never decrease.
    """
    low, high = (int(stats.poisson.ppf(share, mean)) for share in (1e-12, 1.0 - 1e-12))
    count = np.arange(low, high)
    left, right = np.full(count.shape, -9.0), np.full(count.shape, 9.0)
    for _ in range(60):
        middle = (left + right) / 2
        above = _counts(float(mean), middle) > count
        left, right = np.where(above, left, middle), np.where(above, middle, right)
    probabilities = np.diff(stats.norm.cdf(left))
    assert (np.diff(left) > 0).all()
    assert 0.5 * np.abs(probabilities - stats.poisson.pmf(count[1:], mean)).sum() < limit


def test_single_precision_moves_few_counts():
    """float32 rounds a mean of 40000 to 0.004: about as many counts fall on another number."""
    normal = np.random.default_rng(3).standard_normal(100_000)
    exact = _counts(40000.0, normal)
    single = _counts(np.full(normal.shape, 40000.0, np.float32), normal.astype(np.float32))
    assert np.abs(single - exact).max() <= 1
    assert (single != exact).mean() < 0.01


def test_tables_of_small_counts_are_the_poisson_law():
    """Total variation of every table from the Poisson law of its mean: rounding to 32 bits."""
    shares = np.diff(small_counts().ends.astype(float), axis=1, prepend=0.0) / 2.0**32
    steps, counts = shares.shape
    mean = np.linspace(0.0, FROM_NORMAL, steps)[:, None]
    variation = 0.5 * np.abs(shares - stats.poisson.pmf(np.arange(counts), mean)).sum(axis=1)
    assert variation.max() < 5e-8


def poisson_counts(mean, key, frame=0):
    """Return the counts that a sensor records of frames with these means, at most 65535."""
    response, offset_e = np.ones_like(mean), np.zeros_like(mean)
    recorded = np.zeros(mean.shape, np.uint16)
    record_frame(mean, response, offset_e, COUNTER, (key, frame), recorded)
    return recorded.astype(np.float32)


def _drawn(mean, count=200_000):
    return poisson_counts(np.full((count // 400, 400), mean, np.float32), KEY).ravel()


@pytest.mark.parametrize("mean", [0.0, 0.06, 0.3, 1.9, 5.0, 20.0, 98.93, 101.0, 5000.0])
def test_drawn_counts_follow_the_poisson_law(mean):
    """Chi-square over up to twenty classes of about equal probability, at a fixed key."""
    drawn = _drawn(mean)
    assert (drawn == np.rint(drawn)).all()
    if mean == 0.0:
        assert not drawn.any()
        return
    ends = np.unique(stats.poisson.ppf(np.linspace(0.05, 0.95, 19), mean))
    expected = np.diff(np.r_[0.0, stats.poisson.cdf(ends, mean), 1.0]) * drawn.size
    frequencies = np.diff(np.r_[0, np.searchsorted(np.sort(drawn), ends, side="right"), drawn.size])
    assert stats.chisquare(frequencies, expected).pvalue > 1e-3


def test_five_electrons_are_as_skewed_as_poisson_numbers_are():
    """Skewness 1 / sqrt(5), excess kurtosis 1 / 5: not those of a normal number, rounded."""
    drawn = _drawn(5.0, 2_000_000)
    assert drawn.mean() == pytest.approx(5.0, abs=4 * np.sqrt(5.0 / drawn.size))
    assert stats.skew(drawn) == pytest.approx(5.0**-0.5, abs=0.01)
    assert stats.kurtosis(drawn) == pytest.approx(0.2, abs=0.03)


@pytest.mark.parametrize("cols", [1, 2, 129, 300])
def test_a_count_does_not_depend_on_the_other_pixels(cols):
    """Setup: small means everywhere, and in every third column only.

    The random words of small means are computed for the groups of columns that need them.
    """
    ones, zeros = np.ones((3, cols), np.float32), np.zeros((3, cols), np.float32)
    few, all_small = (np.full((3, cols), mean, np.float32) for mean in (5000.0, 20.3))
    few[:, ::3] = 20.3
    frames = [np.zeros((3, cols), np.uint16) for _ in range(2)]
    for mean, frame in zip((few, all_small), frames, strict=True):
        record_frame(mean, ones, zeros, COUNTER, (KEY, 5), frame)
    np.testing.assert_array_equal(frames[0][:, ::3], frames[1][:, ::3])
    assert len(np.unique(frames[1])) >= min(cols, 5)


def test_the_series_of_an_exponential_is_exact():
    x = np.linspace(-0.125, 0.0, 4001)
    np.testing.assert_allclose([exp_of_small(value) for value in x], np.exp(x), rtol=3e-16)


def test_both_regimes_live_in_one_frame():
    mean = np.array([[0.0, 5.0, 12.06], [99.9, 100.1, 6e4]], np.float32)
    drawn = np.stack([poisson_counts(mean, KEY, frame) for frame in range(4000)])
    assert drawn.mean(axis=0) == pytest.approx(mean, rel=0.02)
    assert drawn.var(axis=0) == pytest.approx(mean, rel=0.1)


@pytest.mark.parametrize("mean", [5.0, 5000.0])
def test_pixels_are_independent(mean):
    """Correlation between neighbours, between columns that share a block, and between rows, frames
    and keys: none beyond four standard errors.
    """
    shape, another_key = (300, 401), tuple(np.array([11, 22, 33, 45], np.uint32))
    means = np.full(shape, mean, np.float32)
    deviations = poisson_counts(means, KEY) - mean
    next_frame, other_key = (
        poisson_counts(means, *which) - mean for which in ((KEY, 1), (another_key,))
    )
    pairs = [
        (deviations[:, 1:], deviations[:, :-1]),
        (deviations[1:], deviations[:-1]),
        (deviations[:, 201:], deviations[:, :200]),
        (deviations, next_frame),
        (deviations[1:], next_frame[:-1]),
        (deviations, other_key),
    ]
    for a, b in pairs:
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 4 / np.sqrt(a.size)
