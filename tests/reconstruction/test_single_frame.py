"""Phase of one fringe image by Fourier transform: Bessel series, carrier, direction, noise."""

import numpy as np
import pytest
from scipy.special import jv

from reconstruction.decoding import PhaseReference
from reconstruction.decoding.decode import DecodeOptions, decode
from reconstruction.errors import InputError
from reconstruction.patterns import PatternSet
from reconstruction.reduction.fourier import FLAT, Carrier, _window, find_carrier, side_lobe
from reconstruction.rig.sensor import SensorNoise
from tests.reconstruction.moving import moving_frames, ramp

INSIDE = np.s_[25:-25, 25:-25]


def single(**change):
    return PatternSet(1280, 720, steps=1, stepping="single", axes=("column",), **change)


@pytest.mark.parametrize(("modulation", "cycles"), [(1.0, 0.02), (2.0, 0.02), (1.0, 0.05)])
def test_side_lobe_of_a_modulated_phase_is_its_bessel_series(modulation, cycles):
    """Expected: cos(2 pi f x + a sin(2 pi g x)) passes as sum J_n(a) H(f_n) exp(2 pi i f_n x).

    The frequencies are f_n = +-(f + n g), H is the window. The series is exact without borders.
    """
    x, frequency = np.arange(400.0), 0.1
    phase = 2.0 * np.pi * frequency * x + modulation * np.sin(2.0 * np.pi * cycles * x)
    image = np.cos(phase)[np.newaxis, :] * np.ones((120, 1))
    lobe = 2.0 * side_lobe(image, Carrier(frequency, 0.0))
    expected = sum(
        jv(n, modulation)
        * _window(np.array([abs(sign * (frequency + n * cycles) / frequency - 1.0)]))
        * np.exp(2j * np.pi * sign * (frequency + n * cycles) * x)
        for n in range(-20, 21)
        for sign in (-1, 1)
    )
    difference = np.angle(lobe[60] * np.conj(expected))[60:-60]
    assert np.abs(difference).max() < 2e-3


def test_error_falls_with_the_ratio_of_carrier_and_relief():
    """Setup: relief of 40 camera px, 3 px of the projector. Expected: RMS of the phase error falls.

    Expected limit: with a carrier ten times the relief's frequency the error is below 1 mrad.
    """
    row, col = np.mgrid[0:120, 0:400].astype(float)
    columns = 200.0 + 1.8 * col + 0.2 * row + 3.0 * np.sin(2.0 * np.pi * col / 100.0)
    errors = []
    for period_px in (36.0, 18.0, 9.0):
        patterns = single(period_px=period_px)
        stack = moving_frames(patterns, columns, 0.0)
        decoded = decode(stack, patterns, SensorNoise(0.0, 0.0, 0.0, 255.0))
        error = (decoded.column.coordinate_px - columns)[INSIDE] * 2.0 * np.pi / period_px
        assert decoded.valid[INSIDE].all()
        errors.append(float(np.sqrt(np.mean(error**2))))
    assert errors[0] > 5.0 * errors[1] > 25.0 * errors[2]
    assert errors[2] < 1e-3


@pytest.mark.parametrize("axis", ["column", "row"])
def test_direction_follows_from_the_words(quiet_sensor, axis):
    """Setup: image as it is, and mirrored. Expected: the same coordinates, mirrored."""
    patterns = PatternSet(1280, 720, period_px=12.0, steps=1, stepping="single", axes=(axis,))
    x_px = ramp(120, 160) if axis == "column" else ramp(160, 120).T
    stack = moving_frames(patterns, x_px, 0.0)
    for flipped in (False, True):
        shown = stack[:, ::-1, ::-1] if flipped else stack
        decoded = decode(np.ascontiguousarray(shown), patterns, quiet_sensor)
        coordinate_px = (decoded.column if axis == "column" else decoded.row).coordinate_px
        expected = x_px[::-1, ::-1] if flipped else x_px
        assert decoded.valid[INSIDE].all()
        assert np.abs(coordinate_px - expected)[INSIDE].max() < 0.05


def test_sigma_is_the_spread_of_noisy_coordinates():
    """Setup: 12 noisy images. Expected: spread over sigma 1 within 5 %, without the filter."""
    patterns, columns = single(), ramp(100, 200)
    frames, sensor = moving_frames(patterns, columns, 0.0), SensorNoise(0.5, 5.0, 0.0, 1e5)
    rng, normalised = np.random.default_rng(7), []
    for _ in range(12):
        noisy = frames + rng.normal(0.0, 1.0, frames.shape) * np.sqrt(0.5 * frames + 6.25)
        axis = decode(noisy.astype(np.float32), patterns, sensor).column
        normalised.append(((axis.coordinate_px - columns) / axis.sigma_px)[INSIDE])
    assert np.std(normalised) == pytest.approx(1.0, abs=0.05)


def test_spatial_unwrapping_of_one_frame_without_any_other(quiet_sensor):
    """Setup: a single fringe image is the whole capture; one marked pixel. Expected: < 0.1 px."""
    patterns = single(code="spatial", uniform=False)
    assert len(patterns.frames) == 1
    columns = ramp(100, 200)
    stack = moving_frames(patterns, columns, 0.0)
    reference = PhaseReference(pixels=((100.0, 50.0, columns[50, 100]),))
    options = DecodeOptions(reference=reference)
    decoded = decode(stack, patterns, quiet_sensor, options)
    assert decoded.valid[INSIDE].mean() > 0.99
    error_px = (decoded.column.coordinate_px - columns)[INSIDE][decoded.valid[INSIDE]]
    assert np.abs(error_px).max() < 0.1


def test_no_carrier_is_an_error(quiet_sensor):
    patterns = single(period_px=400.0)
    stack = moving_frames(patterns, ramp(60, 100), 0.0)
    with pytest.raises(InputError, match=r"allowed more than 4 fringes and less than 0.4"):
        decode(stack, patterns, quiet_sensor)


def test_carrier_is_the_mean_frequency():
    row, col = np.mgrid[0:120, 0:300].astype(float)
    image = np.cos(2.0 * np.pi * (0.081 * col - 0.013 * row))
    carrier = find_carrier(image, "column")
    assert carrier.column == pytest.approx(0.081, abs=5e-4)
    assert carrier.row == pytest.approx(-0.013, abs=5e-4)
    assert 0.0 < FLAT < 1.0


def test_three_fringes_along_the_shorter_side_are_too_few():
    """Why: the limit is a number of fringes in the image, along either of its sides."""
    row = np.arange(120)[:, np.newaxis] * np.ones(160)
    with pytest.raises(InputError, match=r"found 3\.\d* fringes in the image"):
        find_carrier(100.0 * np.cos(2.0 * np.pi * 3.3 / 120 * row), "row")
    assert find_carrier(100.0 * np.cos(2.0 * np.pi * 8 / 120 * row), "row").row > 0.0
