"""Projector coordinates at features: only from the phase of the white print."""

from types import SimpleNamespace

import numpy as np
import pytest

from reconstruction.calibration.plane_images import apply_homography, projector_points
from reconstruction.decoding.decode import DecodeOptions, decode
from reconstruction.errors import InputError

H = np.array([[0.9, 0.03, 150.0], [-0.02, 0.85, 120.0], [2e-5, -3e-5, 1.0]])
ROWS, COLS = 200, 260
FEATURES = np.array([[60.3, 50.7], [130.0, 100.2], [200.9, 150.4]])
REACH = 30.0


def projector_map(pixels):
    """Return a homography with a little radial distortion on top."""
    flat = apply_homography(H, pixels)
    offset = flat - [280.0, 220.0]
    r2 = np.sum(offset**2, axis=-1, keepdims=True)
    return flat + 2e-7 * r2 * offset


def coordinates():
    pixels = np.stack(np.meshgrid(np.arange(COLS), np.arange(ROWS)), axis=-1).reshape(-1, 2)
    return projector_map(pixels.astype(float)).reshape(ROWS, COLS, 2)


def dots():
    """Return the white pixels: dots of 8 px radius, with a margin, at the features are not."""
    x, y = np.meshgrid(np.arange(COLS), np.arange(ROWS))
    away = [np.hypot(x - a, y - b) > 11.0 for a, b in FEATURES]
    return np.logical_and.reduce(away)


def decoded_as(where, valid):
    column, row = (SimpleNamespace(coordinate_px=where[..., k]) for k in range(2))
    return SimpleNamespace(column=column, row=row, valid=valid)


def test_dark_dots_are_bridged_exactly():
    """Setup: exact coordinates, garbage inside the dots, distortion beyond a homography.

    Expected: value to 1e-5 px, slope to 1e-5: the distortion is a cubic.
    """
    where, white = coordinates(), dots()
    where[~white] = 7.0
    result = projector_points(decoded_as(where, white), white, FEATURES, REACH)
    assert result.located.all()
    np.testing.assert_allclose(result.pixels_px, projector_map(FEATURES), atol=1e-5)
    steps = [0.5 * np.eye(2)[k] for k in range(2)]
    slopes = [projector_map(FEATURES + s) - projector_map(FEATURES - s) for s in steps]
    np.testing.assert_allclose(result.slopes, np.stack(slopes, axis=-1), atol=1e-5)


def test_wrong_fringe_orders_are_ignored():
    """Setup: every 50th white pixel is one period (18 px) off. Expected: as without them."""
    where, white = coordinates(), dots()
    where.reshape(-1, 2)[::50, 0] += 18.0
    result = projector_points(decoded_as(where, white), white, FEATURES, REACH)
    np.testing.assert_allclose(result.pixels_px, projector_map(FEATURES), atol=1e-3)


def test_a_feature_without_surroundings_is_not_extrapolated():
    where, white = coordinates(), dots()
    white[:, :60] = False
    white[85:116, 115:146] = False
    white[90:111, 120:141] = False
    edge = np.array([[60.3, 50.7], [3.0, 100.0], [200.9, 150.4]])
    result = projector_points(decoded_as(where, white), white, edge, REACH)
    assert result.located.tolist() == [False, False, True]


def test_undecoded_board_is_explained():
    nothing = np.zeros((ROWS, COLS), dtype=bool)
    with pytest.raises(InputError, match="white pixels"):
        projector_points(decoded_as(coordinates(), nothing), ~nothing, FEATURES, REACH)


def test_phase_reaches_the_feature_through_the_decoder(patterns, quiet_sensor, synthesise):
    """Setup: ideal 8-bit-free frames with dark dots. Expected: 1e-3 px through the decoder."""
    where, white = coordinates(), dots()
    stack = synthesise(patterns, where[..., 0], where[..., 1])
    stack = (stack * np.where(white, 1.0, 0.05)).astype(np.float32)
    decoded = decode(stack, patterns, quiet_sensor, DecodeOptions(filter_taps=0))
    result = projector_points(decoded, white, FEATURES, REACH)
    np.testing.assert_allclose(result.pixels_px, projector_map(FEATURES), atol=1e-3)
