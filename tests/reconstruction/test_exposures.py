import numpy as np
import pytest

from reconstruction.capture.image_files import merge_exposures
from reconstruction.decoding.decode import DecodeOptions, decode
from reconstruction.errors import InputError
from reconstruction.patterns import PatternSet
from reconstruction.rig.sensor import SensorNoise

SENSOR = SensorNoise(0.2, 5.0, 20.0, 1023.0)
EXPOSURES_MS = (8.0, 1.0, 3.0)


def scene(synthesise):
    """Return patterns, truth and stacks of a surface that is 30 times brighter at the right."""
    patterns = PatternSet(1280, 720, steps=6)
    row, col = np.mgrid[0:200, 0:480].astype(float)
    column, lines = 20.0 + 0.21 * col + 0.02 * row, 30.0 + 0.17 * row
    shape = synthesise(patterns, column, lines, mean_dn=0.55, amplitude_dn=0.45)
    bright_dn_per_ms = 25.0 * 30.0 ** (col / 480.0)
    rng = np.random.default_rng(8)
    stacks = []
    for exposure_ms in EXPOSURES_MS:
        clean = 20.0 + exposure_ms * bright_dn_per_ms * shape
        noise = rng.normal(size=clean.shape) * np.sqrt(SENSOR.variance_dn2(clean) - 1.0 / 12.0)
        stacks.append(np.rint(np.clip(clean + noise, 0.0, 1023.0)).astype(np.uint16))
    return patterns, column, stacks


@pytest.mark.parametrize("taps", [0, 5])
def test_merged_exposures_reach_every_pixel_with_the_predicted_sigma(synthesise, taps):
    """Expected: all valid, and in every brightness zone sigma within 5 % of the spread."""
    patterns, column, stacks = scene(synthesise)
    merged = merge_exposures(stacks, EXPOSURES_MS, SENSOR)
    options = DecodeOptions(filter_taps=taps, max_phase_sigma_rad=0.2)
    decoded = decode(merged.stack, patterns, SENSOR, options, merged.scale)
    inner = decoded.valid[4:-4, 4:-4]
    assert inner.mean() > 0.999
    error = decoded.column.coordinate_px - column
    assert set(np.unique(merged.chosen)) == {0, 1, 2}
    for chosen in range(3):
        zone = decoded.valid & (merged.chosen == chosen)
        sigma = np.sqrt(np.mean(decoded.column.sigma_px[zone] ** 2))
        # A phasor filter over the border between two exposures mixes their noise.
        assert sigma == pytest.approx(np.std(error[zone]), rel=0.05)
    # The phasor filter weighs bright neighbours more: brightness slope ln 30 / 480 per px times the
    # filter's variance of 1.6 px^2 times 0.21 px per px.
    assert abs(np.mean(error[decoded.valid])) < (1e-3 if taps == 0 else 3e-3)


def test_a_single_exposure_does_not_reach_everywhere(synthesise):
    """Why: shows the use of merging."""
    patterns, _, stacks = scene(synthesise)
    merged = merge_exposures(stacks, EXPOSURES_MS, SENSOR)
    options = DecodeOptions(filter_taps=0, max_phase_sigma_rad=0.2)
    best = decode(merged.stack, patterns, SENSOR, options, merged.scale)
    for stack in stacks:
        alone = decode(stack, patterns, SENSOR, options)
        is_worse = alone.column.sigma_px > 1.3 * best.column.sigma_px
        assert np.mean(~alone.valid | is_worse) > 0.2


def test_brightest_unsaturated_exposure_of_the_whole_set():
    """Setup: one pixel per case, two frames. Expected: index of the exposure, scaled DN."""
    long = np.array([[[100, 1023, 1023, 500]], [[200, 300, 1023, 400]]], np.uint16)
    short = np.array([[[40, 270, 1023, 140]], [[65, 90, 400, 115]]], np.uint16)
    merged = merge_exposures([long, short], [4.0, 1.0], SENSOR)
    np.testing.assert_array_equal(merged.chosen, [[0, 1, 1, 0]])
    np.testing.assert_array_equal(merged.scale, [[1.0, 4.0, 4.0, 1.0]])
    np.testing.assert_array_equal(merged.stack[1], [[200.0, 20.0 + 4 * 70.0, 1540.0, 400.0]])
    assert merged.exposure_ms == 4.0


def test_pixels_saturated_in_all_exposures_lose_single_frames(synthesise):
    patterns = PatternSet(1280, 720, steps=12)
    column, row = np.full((9, 9), 365.0), np.full((9, 9), 185.0)
    light = synthesise(patterns, column, row, mean_dn=650.0, amplitude_dn=600.0)
    stacks = [np.clip(20.0 + t * light, 0.0, 1023.0).astype(np.float32) for t in (1.0, 4.0)]
    merged = merge_exposures(stacks, [1.0, 4.0], SENSOR)
    options = DecodeOptions(filter_taps=0)
    decoded = decode(merged.stack, patterns, SENSOR, options, merged.scale)
    assert decoded.valid.all()
    np.testing.assert_allclose(decoded.column.coordinate_px, 365.0, atol=1e-3)


@pytest.mark.parametrize(
    ("stacks", "exposures_ms", "message"),
    [
        ([], [], "0 stacks"),
        ([np.zeros((2, 1, 1))], [1.0, 2.0], "2 exposures"),
        ([np.zeros((2, 1, 1))] * 2, [1.0, 1.0], "once"),
        ([np.zeros((2, 1, 1))], [0.0], "exposures_ms"),
        ([np.zeros((2, 1, 1)), np.zeros((2, 1, 2))], [1.0, 2.0], "shapes"),
    ],
)
def test_stacks_that_do_not_fit_are_rejected(stacks, exposures_ms, message):
    with pytest.raises(InputError, match=message):
        merge_exposures(stacks, exposures_ms, SENSOR)


def test_scale_of_another_shape_is_rejected(patterns, quiet_sensor):
    stack = np.zeros((53, 8, 8), np.uint16)
    with pytest.raises(InputError, match="scale"):
        decode(stack, patterns, quiet_sensor, scale=np.ones((8, 9), np.float32))
