"""Colour maps and dots computed by hand: one term, one bin, one dot."""

import numpy as np
import pytest

from reconstruction.colour_maps import Samples
from reconstruction.photometric import PhotometricDecoder, PhotometricOptions
from reconstruction.photometric.images import find_markers
from reconstruction.photometric.maps.polynomial import COLOUR_TERMS, PLACE_TERMS, ColourPolynomial
from reconstruction.photometric.maps.table import BINS, ColourTable
from reconstruction.photometric.sensor import SensorCalibration


def polynomial(**terms):
    """Return a polynomial with single coefficients: out_colour_place = value."""
    coefficients = np.zeros((2, len(COLOUR_TERMS), len(PLACE_TERMS)))
    for name, value in terms.items():
        out, colour, place = (tuple(map(int, part)) for part in name[1:].split("_"))
        at = out[0], COLOUR_TERMS.index(colour), PLACE_TERMS.index(place)
        coefficients[at] = value
    return ColourPolynomial(coefficients, np.full(3, -1.0), np.full(3, 1.0))


def test_a_term_of_colour_and_place():
    """Level 150 on 100 is q = 0.5; at the left, middle and right column the place is -1, 0, 1.

    Tilt along rows 0.6 q = 0.3, a slope of 0.3 / sqrt(0.91); along columns 0.8 q^2 x = +-0.2.
    """
    bound = polynomial(t0_0_=0.6, t1_00_1=0.8).bound_to(np.full((3, 5, 3), 100.0, np.float32))
    levels = np.full((3, 5, 3), 100.0, np.float32)
    levels[..., 0] = 150.0
    slopes, known = bound.slopes(levels)
    assert known.all()
    for col, along in ((0, -0.2), (2, 0.0), (4, 0.2)):
        length = np.sqrt(1.0 - 0.09 - along**2)
        np.testing.assert_allclose(slopes[:, 1, col], [0.3 / length, along / length], atol=1e-6)


def test_rows_count_from_minus_one_at_the_top():
    bound = polynomial(t0_1_0=0.5).bound_to(np.full((5, 3, 3), 50.0, np.float32))
    levels = np.full((5, 3, 3), 50.0, np.float32)
    levels[..., 1] = 75.0
    tilts = np.array([-0.25, -0.125, 0.0, 0.125, 0.25])
    expected = tilts / np.sqrt(1.0 - tilts**2)
    np.testing.assert_allclose(bound.slopes(levels)[0][0, :, 1], expected, atol=1e-6)


def samples_of(q, tilt, background=100.0):
    count = len(q)
    places = np.random.default_rng(1).uniform(0.0, [239.0, 319.0], (count, 2))
    levels = (background * (1.0 + q)).astype(np.float32)
    slopes = tilt / np.sqrt(1.0 - np.sum(tilt**2, axis=1, keepdims=True))
    return Samples(levels, np.full((count, 3), background, np.float32), places, slopes)


def test_lamberts_law_is_linear_in_the_colour():
    """Tilts (0.5 r - 0.2 b, 0.3 g) of colours in -0.2 to 0.4 are fitted to 1e-3.

    The range of known colours is theirs plus 10 % of its width on either side: -0.26 to 0.46.
    """
    q = np.random.default_rng(2).uniform(-0.2, 0.4, (20_000, 3))
    tilt = np.column_stack([0.5 * q[:, 0] - 0.2 * q[:, 2], 0.3 * q[:, 1]])
    flat = np.full((240, 320, 3), 100.0, np.float32)
    fitted = ColourPolynomial.fit(samples_of(q, tilt), flat)
    np.testing.assert_allclose(fitted.lowest, -0.26, atol=2e-3)
    np.testing.assert_allclose(fitted.highest, 0.46, atol=2e-3)
    bound = fitted.bound_to(flat)
    levels = np.full((240, 320, 3), [130.0, 110.0, 90.0], np.float32)
    slopes, _ = bound.slopes(levels)
    length = np.sqrt(1 - 0.17**2 - 0.03**2)
    np.testing.assert_allclose(slopes[0], 0.17 / length, atol=2e-3)
    np.testing.assert_allclose(slopes[1], 0.03 / length, atol=2e-3)


def test_bins_are_two_levels_wide():
    """Differences of 0, 1.9 and 2 levels are the bins 45, 45 and 46; -90 is the first, 89.9 the
    last, and values beyond either end belong to it. The bin's number gives the colour.
    """
    slopes = np.zeros((BINS, BINS, BINS, 2), np.float32)
    slopes[..., 0] = np.arange(BINS)[:, None, None]
    slopes[..., 1] = np.arange(BINS)[None, :, None] + 0.01 * np.arange(BINS)
    table = ColourTable(slopes, np.ones((BINS,) * 3, bool))
    background = np.full((1, 7, 3), 120.0, np.float32)
    red = np.array([0.0, 1.9, 2.0, -90.0, 89.9, -120.0, 130.0])
    levels = background + np.stack([red, 0 * red + 20.0, 0 * red - 40.0], axis=-1)[None]
    measured, _ = table.bound_to(background).slopes(levels.astype(np.float32))
    assert measured[0, 0].tolist() == [45, 45, 46, 0, 89, 0, 89]
    np.testing.assert_allclose(measured[1], 55.25, rtol=1e-6)  # green 55, blue 25


def test_a_dim_corner_is_amplified():
    """Typical 100: differences count 3 times on 50, once on 100, 0.25 times on 200 (bounded)."""
    slopes = np.zeros((BINS, BINS, BINS, 2), np.float32)
    slopes[..., 0] = np.arange(BINS)[:, None, None]
    background = np.full((3, 5, 3), 100.0, np.float32)
    background[0, 0], background[0, 1], background[0, 2] = 50.0, 200.0, 10.0
    table = ColourTable(slopes, np.ones((BINS,) * 3, bool))
    measured, _ = table.bound_to(background).slopes(background + np.float32(10.5))
    # 31.5, 2.6, 42 (bounded by 4) and 10.5 levels above the middle of the table.
    assert measured[0, 0, :4].tolist() == [60, 46, 66, 50]


def test_a_bin_holds_the_mean_and_its_surroundings_the_nearest():
    """Two pixels of one colour, slopes 0.15 and 0.25: 0.2 there, and in bins up to sqrt(20) off."""
    levels = np.full((2, 3), [121.0, 141.0, 81.0], np.float32)
    background = np.full((8, 8, 3), [120.0, 120.0, 120.0], np.float32)
    slopes = np.array([[0.15, -0.15], [0.25, -0.05]])
    samples = Samples(levels, np.full((2, 3), 120.0, np.float32), np.full((2, 2), 3.0), slopes)
    table = ColourTable.fit(samples, background)
    np.testing.assert_allclose(table.slopes[45, 55, 25], [0.2, -0.1], atol=1e-7)
    np.testing.assert_allclose(table.slopes[0, 0, 0], [0.2, -0.1], atol=1e-7)
    assert table.known[49, 57, 25]
    assert not table.known[49, 58, 25]
    assert not table.known[50, 55, 25]


@pytest.mark.parametrize(("scheme", "side"), [("sdk_2025", 7), ("sdk_2024", 11)])
def test_a_dot_is_grown_by_its_scheme(scheme, side):
    """A dark square of 7 x 7 pixels: the vendor's later form hides it, the former 2 px more."""
    colours = polynomial(t0_0_=0.5)
    calibration = SensorCalibration(
        colours, np.full((40, 50, 3), 100.0, np.float32), 0.1, smoothing_px=1, marker_level=30
    )
    image = np.full((40, 50, 3), 100, np.uint8)
    image[10:17, 20:27] = 20
    height_map = PhotometricDecoder(calibration, PhotometricOptions(integration=scheme)).decode(
        image
    )
    rows, cols = np.nonzero(height_map.mask_reason == 1)
    assert len(rows) == side**2
    assert (rows.mean(), cols.mean()) == (13.0, 23.0)


def test_grey_of_a_colour():
    """0.299 R + 0.587 G + 0.114 B: (100, 0, 0) is 29.9, (0, 100, 0) 58.7, (0, 0, 100) 11.4."""
    levels = np.zeros((1, 3, 3), np.float32)
    levels[0, np.arange(3), np.arange(3)] = 100.0
    for limit, dark in ((11.0, [0, 0, 0]), (12.0, [0, 0, 1]), (30.0, [1, 0, 1]), (59.0, [1, 1, 1])):
        assert find_markers(levels, limit, 0)[0].tolist() == [bool(is_dark) for is_dark in dark]
