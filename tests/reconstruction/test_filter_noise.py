"""The filter as a linear map, against the filter itself."""

import numpy as np
import pytest
from scipy.ndimage import minimum_filter

from reconstruction.compact import Half
from reconstruction.decoding import filter_noise as linear_map
from reconstruction.decoding._filter import Unfiltered, smooth
from reconstruction.decoding.filter_noise import filter_noise, without_edges

UNIT = 2.0**-6
GAUSS = {"taps": 8, "sigma_px": 1.5, "limit_px": 9.0}
SHAPE = (44, 52)


def relief(bend, shape=SHAPE):
    """A tilted plane with a bowl, px."""
    row, col = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    return 100.0 + 0.3 * col + 0.05 * row + bend * ((col - 25.0) ** 2 + (row - 20.0) ** 2)


def by_the_decoder(coordinate, sigma, reason):
    source = Unfiltered(
        coordinate.astype(np.float32)[None], Half.of(sigma, UNIT).bits[None], reason
    )
    return smooth(source, GAUSS["taps"], GAUSS["sigma_px"], GAUSS["limit_px"], UNIT)


def applied(result, value_px):
    """Return K x of coordinates or their noise, (row, col) px, with the map's shares."""
    lift = linear_map._lift(value_px, result._along, result._across)
    coarse = result._support * linear_map._smoothed(lift, result._gauss)
    return value_px + result._of_lift * lift + result._of_coarse * coarse


def sigmas():
    """Noise that increases over the image, px."""
    return 0.02 * (1.0 + np.linspace(0.0, 1.0, SHAPE[1]))[None, :] * np.ones((SHAPE[0], 1))


def holes():
    reason = np.zeros(SHAPE, np.uint8)
    reason[10:16, 30:40] = 1
    reason[:, 50:] = 1
    return reason


@pytest.mark.parametrize("bend", [0.0, 0.004, 0.05])
def test_the_map_is_the_decoders(bend):
    """Without noise, at the same shares: on a plane all is smoothed, on a bowl it is given back."""
    reason, coordinate = holes(), relief(bend)
    usable = without_edges(reason) == 0
    # So little noise that none of it is in the expected squares, as in a decoder without any.
    quiet = np.full(SHAPE, 1e-4)
    result = filter_noise(coordinate, quiet**2, usable, **GAUSS)
    decoded = by_the_decoder(coordinate, quiet, reason)
    np.testing.assert_array_equal(decoded.reason == 0, usable)
    difference = np.abs(applied(result, np.where(usable, coordinate, 0)) - decoded.coordinate_px[0])
    assert difference[usable].max() < 2e-4


def test_derivatives_are_those_of_the_map():
    """<s, K x> = <K^T s, x>, with holes, borders and shares that differ from block to block."""
    rng = np.random.default_rng(3)
    usable = without_edges(holes()) == 0
    result = filter_noise(relief(0.004), sigmas() ** 2, usable, **GAUSS)
    slope, value = rng.standard_normal((2, *SHAPE)) * usable
    forward = np.sum(slope * applied(result, value))
    assert np.sum(result.transposed(slope) * value) == pytest.approx(forward, rel=1e-9)


def test_noise_of_a_part_is_that_of_the_whole():
    """Only the surroundings of the fitted pixels are used."""
    usable = np.ones(SHAPE, bool)
    result = filter_noise(relief(0.004), sigmas() ** 2, usable, **GAUSS)
    slope = np.zeros(SHAPE)
    slope[18:24, 20:30] = 1.0
    whole = np.sqrt(np.sum(result.transposed(slope) ** 2 * sigmas() ** 2))
    assert result.noise(slope) == pytest.approx(whole, rel=1e-9)


@pytest.mark.parametrize("bend", [0.0, 0.001, 0.01])
def test_predicted_variance_is_the_spread_of_many(bend):
    """200 draws of noise through the decoder's own filter, on a plane, a weak and a strong bowl.

    Expected: the spread of each pixel (5 % by the number of draws, 2 % in the mean) and of a mean
    over a window, in which neighbours share errors, are the predicted ones. Within 8 px of a hole
    or the border the coarse part of a relief is made of fewer pixels than the variance allows for:
    15 % more in the mean, 30 to 70 % on the outermost pixels.
    """
    rng, reason, coordinate = np.random.default_rng(7), holes(), relief(bend)
    usable = without_edges(reason) == 0
    result = filter_noise(coordinate, sigmas() ** 2, usable, **GAUSS)
    window = np.zeros(SHAPE)
    window[24:36, 8:20] = 1 / 144
    draws = np.array([
        by_the_decoder(
            coordinate + sigmas() * rng.standard_normal(SHAPE), sigmas(), reason
        ).coordinate_px[0]
        for _ in range(200)
    ]).astype(np.float64)  # fmt: skip
    ratio = draws.std(axis=0)[usable] / np.sqrt(result.variance_px2[usable])
    assert abs(np.mean(ratio) - 1.0) < 0.15
    far = minimum_filter(usable, 17, mode="constant")[usable]
    assert abs(np.mean(ratio[far]) - 1.0) < 0.03
    assert np.std(ratio[far]) < 0.07
    of_window = np.tensordot(draws, window, 2).std()
    assert of_window == pytest.approx(result.noise(window), rel=0.1)
    # The value for pixels that share no error.
    alone = np.sqrt(np.sum(window**2 * result.variance_px2))
    assert of_window > 2.0 * alone
