import numpy as np
import pytest

from reconstruction.errors import FitError, InputError
from reconstruction.photometric.calibration_ball import (
    BallPress,
    ContactCircle,
    SampleOptions,
    ball_slopes,
    find_contact_circle,
    sample_presses,
)
from reconstruction.photometric.images import mean_background, smoothed
from reconstruction.photometric.sensor import calibrate_sensor

PITCH_MM = 0.0634


@pytest.fixture(scope="module")
def background(background_frames):
    return mean_background(background_frames)


def test_circle_of_contact(ball_presses, presses, background):
    """Centres enter every slope, so they must be right to a fraction of a pixel.

    Smoothing rounds the drop of the colour beyond the edge: the radius is about one pixel too
    small, which the excluded rim covers.
    """
    circles = [find_contact_circle(smoothed(press.image, 3), background) for press in ball_presses]
    centre = [
        (f.row_px - p.row_px, f.col_px - p.col_px) for f, p in zip(circles, presses, strict=True)
    ]
    radius = [f.radius_px - p.contact_px for f, p in zip(circles, presses, strict=True)]
    assert np.abs(centre).max() < 0.3
    assert np.abs(np.mean(centre, axis=0)).max() < 0.05
    assert min(radius) > -1.6
    assert max(radius) < 0.0


def test_slopes_are_those_of_the_sphere():
    """Central differences of the sphere itself, with a step of 1e-4 px."""
    circle, radius_mm, step = ContactCircle(20.3, 30.8, 15.0), 3.0, 1e-4
    places = np.random.default_rng(3).uniform((10.0, 20.0), (30.0, 40.0), (50, 2))

    def height_mm(places_px):
        offset_mm = (places_px - (20.3, 30.8)) * PITCH_MM
        return np.sqrt(radius_mm**2 - np.sum(offset_mm**2, axis=1))

    expected = [
        (height_mm(places + step * axis) - height_mm(places - step * axis)) / (2 * step * PITCH_MM)
        for axis in np.eye(2)
    ]
    slopes = ball_slopes(circle, radius_mm, PITCH_MM, places)
    np.testing.assert_allclose(slopes.T, expected, atol=1e-8)


def test_samples_leave_out_dots(ball_presses, background):
    row, col = np.indices(background.shape[:2])
    dots = (row % 20 < 3) & (col % 20 < 3)
    image, reference = ball_presses[0].image.copy(), background.copy()
    image[dots], reference[dots] = 5, 5.0
    press = BallPress(image, ball_presses[0].ball_diameter_mm)
    plain = sample_presses([press], reference, PITCH_MM)
    without = sample_presses([press], reference, PITCH_MM, SampleOptions(marker_level=30))
    assert plain.background.min() < 30.0
    assert without.background.min() > 50.0
    assert 0 < len(without.slopes) < len(plain.slopes)


def test_undeformed_gel_is_no_contact(background_frames, background):
    press = BallPress(background_frames[0], 6.0)
    with pytest.raises(FitError, match=r"calibration image 0: no contact.*threshold 15"):
        sample_presses([press], background, PITCH_MM)


def test_ball_that_does_not_fit(ball_presses, background):
    press = BallPress(ball_presses[0].image, 1.0)
    with pytest.raises(FitError, match=r"does not fit a ball of radius 0\.5 mm"):
        sample_presses([press], background, PITCH_MM)


@pytest.mark.parametrize(("diameter_factor", "pitch_factor"), [(10.0, 1.0), (1.0, 1e-3)])
def test_a_ball_or_a_pitch_in_another_unit(ball_presses, background, diameter_factor, pitch_factor):
    """A diameter in units of 0.1 mm, a pitch in m: the samples would have slopes below 0.06."""
    press = BallPress(ball_presses[0].image, diameter_factor * ball_presses[0].ball_diameter_mm)
    with pytest.raises(FitError, match=r"allowed 0\.1 to 0\.9 times that; check the ball's"):
        sample_presses([press], background, pitch_factor * PITCH_MM)


def as_grey(images):
    """Return images as a camera without colours gives them, three equal channels."""
    return np.repeat(images.mean(axis=-1, keepdims=True), 3, axis=-1).astype(np.uint8)


def in_red_light(images):
    return images * np.array([1, 0, 0], np.uint8)


def overexposed(images):
    return np.clip(images.astype(int) * 5, 0, 255).astype(np.uint8)


MISTAKES = {
    "grey images": (as_grey, FitError, r"\d\d% remain \(RMS\), allowed 50%; give"),
    "one lamp": (in_red_light, InputError, r"green channel has a median of 0 levels, allowed 5"),
    "overexposed": (overexposed, InputError, r"red channel has a median of 255 levels.*exposure"),
}


@pytest.mark.parametrize("kind", ["polynomial", "table"])
@pytest.mark.parametrize("name", MISTAKES)
def test_images_that_do_not_determine_slopes(name, kind, ball_presses, background_frames):
    change, error, message = MISTAKES[name]
    presses = [BallPress(change(press.image), press.ball_diameter_mm) for press in ball_presses[:8]]
    with pytest.raises(error, match=message) as caught:
        calibrate_sensor(presses, change(background_frames), PITCH_MM, kind)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["polynomial", "table"])
def test_presses_without_shading_do_not_calibrate(kind, presses, background_frames, ball_presses):
    """Discs 40 levels brighter than the gel, as of a print: their edges look like contacts."""
    row, col = np.indices(background_frames.shape[1:3])
    printed = []
    for place, press in zip(presses[:8], ball_presses, strict=False):
        inside = np.hypot(row - place.row_px, col - place.col_px) < place.contact_px
        image = background_frames[0] + 40 * inside[..., np.newaxis].astype(np.uint8)
        printed.append(BallPress(image, press.ball_diameter_mm))
    with pytest.raises(FitError, match="colours do not determine the slopes"):
        calibrate_sensor(printed, background_frames, PITCH_MM, kind)


def test_bad_input_is_named(background):
    with pytest.raises(FitError, match="no calibration images"):
        sample_presses([], background, PITCH_MM)
    with pytest.raises(InputError, match="8-bit RGB"):
        BallPress(np.zeros((10, 10), np.uint8), 4.0)
    with pytest.raises(InputError, match="calibration image 0 has shape"):
        sample_presses([BallPress(np.zeros((9, 9, 3), np.uint8), 4.0)], background, PITCH_MM)
    with pytest.raises(InputError, match="odd"):
        SampleOptions(smoothing_px=4)


def test_unreadable_presses_may_be_excluded(ball_presses, background):
    """One image without a contact: excluded if allowed, otherwise named in the error."""
    still = BallPress(background.round().astype(np.uint8), 6.0)
    spoilt = [*ball_presses[:2], still, *ball_presses[2:]]
    lenient = SampleOptions(unreadable_share=1.5 / len(spoilt))
    samples = sample_presses(spoilt, background, PITCH_MM, lenient)
    expected = sample_presses(ball_presses, background, PITCH_MM)
    np.testing.assert_array_equal(samples.slopes, expected.slopes)
    with pytest.raises(FitError, match="calibration image 2"):
        sample_presses(spoilt, background, PITCH_MM)
    with pytest.raises(FitError, match="calibration image 0"):
        sample_presses([still, still, *ball_presses], background, PITCH_MM, lenient)
