import numpy as np
import pytest

from reconstruction.photometric.relighting import light_over_background
from reconstruction.photometric.sensor import PhotometricDecoder, PhotometricOptions

UNTOUCHED = 6.0


def quadratic(shape, coefficients):
    y, x = np.meshgrid(*(np.linspace(-1.0, 1.0, n) for n in shape), indexing="ij")
    terms = np.stack([np.ones(shape), x, y, x * x, x * y, y * y])
    return np.tensordot(np.asarray(coefficients), terms, 1)


@pytest.fixture
def drift():
    """Light of each channel over the background's: 0.5 to 2 %, as lamps of a real sensor drift."""
    shape = (240, 320)
    rng = np.random.default_rng(11)
    factors = [1.0 + quadratic(shape, rng.normal(0.0, 0.006, 6)) for _ in range(3)]
    return np.stack(factors, axis=-1)


def test_a_quadratic_change_of_light_is_taken_back_exactly(background_frames, drift):
    flat = background_frames.mean(axis=0).astype(np.float32)
    hidden = np.zeros(flat.shape[:2], bool)
    light = light_over_background((flat * drift).astype(np.float32), flat, hidden, UNTOUCHED)
    np.testing.assert_allclose(light, drift, rtol=2e-6)


def test_contact_has_no_effect(background_frames, drift):
    """A disc 40 levels brighter, with a fading skirt, has the same difference to 1.5 %."""
    flat = background_frames.mean(axis=0).astype(np.float32)
    row, col = np.indices(flat.shape[:2])
    r = np.hypot(row - 120, col - 160)
    touched = 40.0 * np.where(r < 26, 1.0, np.exp(-(r - 26) / 12.0))
    lit = (flat + touched[..., None]) * drift
    hidden = np.zeros(r.shape, bool)
    light = light_over_background(lit.astype(np.float32), flat, hidden, UNTOUCHED)
    np.testing.assert_allclose((lit / light - flat)[r < 26], 40.0, atol=0.6)


def test_no_light_without_undeformed_gel(background_frames):
    flat = background_frames.mean(axis=0).astype(np.float32)
    levels = flat + np.float32(20.0)
    hidden = np.zeros(flat.shape[:2], bool)
    assert light_over_background(levels, flat, hidden, UNTOUCHED) is None


def test_drift_of_undeformed_gel_is_halved(calibrations, background_frames, drift):
    """It is reduced more if the change of light is the quadratic that is fitted."""
    still = np.rint(background_frames[0] * drift).clip(0, 255).astype(np.uint8)
    rms_mm = {
        relighting: np.sqrt(
            np.mean(
                PhotometricDecoder(
                    calibrations["polynomial"], PhotometricOptions(relighting=relighting)
                )
                .decode(still)
                .height_mm.astype(float)
                ** 2
            )
        )
        for relighting in (False, True)
    }
    assert rms_mm[True] < 0.4 * rms_mm[False]


def test_the_vendors_forms_do_not_relight(calibrations, background_frames, drift):
    still = np.rint(background_frames[0] * drift).clip(0, 255).astype(np.uint8)
    height_maps = [
        PhotometricDecoder(
            calibrations["polynomial"], PhotometricOptions("sdk_2025", relighting=relighting)
        ).decode(still)
        for relighting in (False, True)
    ]
    np.testing.assert_array_equal(height_maps[0].height_mm, height_maps[1].height_mm)


def test_undeformed_gel_is_reported(calibrations, ball_presses, presses):
    decoder = PhotometricDecoder(calibrations["polynomial"])
    untouched = decoder.untouched(ball_presses[0].image).where
    row, col = np.indices(untouched.shape)
    r = np.hypot(row - presses[0].row_px, col - presses[0].col_px) / presses[0].contact_px
    assert not untouched[np.abs(r - 0.9) < 0.05].any()
    assert untouched[r > 3.0].mean() > 0.98
