import cv2
import numpy as np
import pytest

from reconstruction.arrays import PhotometricReason
from reconstruction.errors import InputError
from reconstruction.evaluate.fit import fit_sphere
from reconstruction.photometric.sensor import (
    PhotometricDecoder,
    PhotometricOptions,
    SensorCalibration,
)
from tests.work import lines_run

PITCH_MM, DIAMETER_MM, CONTACT_PX = 0.0634, 6.31, 26.0
# Cap height / true height, measured on 29 real presses of a 6.31 mm ball.
REAL_SCALE = {"corrected": (1.00, 0.03), "sdk_2025": (0.66, 0.04), "sdk_2024": (1.32, 0.08)}


def distance_px(press, shape):
    row, col = np.indices(shape)
    return np.hypot(row - press.row_px, col - press.col_px)


def cap_mm(height_mm, press):
    """Height of the centre above the ring at 0.8 contact radii, mm."""
    r = distance_px(press, height_mm.shape)
    ring = np.abs(r - 0.8 * press.contact_px) < 0.7
    return height_mm[r < 1.5].mean() - height_mm[ring].mean()


@pytest.fixture(scope="module", params=[(118.3, 161.7), (85.0, 200.0), (150.6, 110.2)])
def press(request, presses):
    return type(presses[0])(DIAMETER_MM, *request.param, CONTACT_PX)


@pytest.fixture(scope="module")
def surface(make_surface, press):
    return make_surface(press)


@pytest.fixture(scope="module")
def image(render, surface):
    return render(surface[1], 5000)


@pytest.mark.parametrize("integration", REAL_SCALE)
def test_height_of_a_ball(calibrations, image, surface, press, integration):
    """SYNTHETIC shading, calibrated on synthetic presses; the scale is that of real ones.

    The vendor's scale depends on the size of the contact: 26 px, as in the real presses.
    """
    decoder = PhotometricDecoder(calibrations["polynomial"], PhotometricOptions(integration))
    height_map = decoder.decode(image)
    expected, tolerance = REAL_SCALE[integration]
    ratio = cap_mm(height_map.height_mm, press) / cap_mm(surface[0], press)
    assert ratio == pytest.approx(expected, abs=tolerance)
    assert height_map.valid.all()


def test_heights_are_metric(calibrations, image, surface, press):
    """Zero is at undeformed gel; points on the contact fit a sphere of the ball's radius."""
    height_map = PhotometricDecoder(calibrations["polynomial"]).decode(image)
    error_mm = height_map.height_mm - surface[0]
    assert abs(np.median(error_mm)) < 0.001
    assert np.sqrt(np.mean(error_mm**2)) < 0.003
    inside = distance_px(press, error_mm.shape) < CONTACT_PX - 2.0
    points = height_map.points_mm()[inside.ravel()]
    fit = fit_sphere(points)
    assert fit.radius_mm == pytest.approx(DIAMETER_MM / 2.0, rel=0.01)
    assert fit.centre_mm[0] == pytest.approx((press.col_px - 159.5) * PITCH_MM, abs=0.02)
    assert fit.centre_mm[1] == pytest.approx((119.5 - press.row_px) * PITCH_MM, abs=0.02)
    assert fit.stats.rmse_mm < 0.003


def test_look_up_table_is_close(calibrations, image, surface, press):
    """The paper's own map: at most 4 % off, and less accurate than the polynomial."""
    scales = {
        kind: cap_mm(PhotometricDecoder(calibration).decode(image).height_mm, press)
        / cap_mm(surface[0], press)
        for kind, calibration in calibrations.items()
    }
    assert scales["table"] == pytest.approx(1.0, abs=0.04)
    assert abs(scales["polynomial"] - 1.0) < 0.01


def with_dots(levels):
    """Black dots of 4 px radius, 9 x 7 in the view as on the real gel."""
    row, col = np.indices(levels.shape[:2])
    dots = ((row % 34) - 17) ** 2 + ((col % 35) - 17) ** 2 <= 16
    marked = levels.copy()
    marked[dots] = 20
    return marked, dots


@pytest.mark.parametrize("weight", [1.0, 0.1])
def test_dots_are_filled(calibrations, image, surface, press, weight):
    plain = calibrations["polynomial"]
    background, dots = with_dots(plain.background)
    calibration = SensorCalibration(plain.colour_map, background, PITCH_MM, marker_level=40)
    decoder = PhotometricDecoder(calibration, PhotometricOptions(doubtful_weight=weight))
    height_map = decoder.decode(with_dots(image)[0])
    assert np.all(height_map.mask_reason[dots] == PhotometricReason.MARKER)
    assert np.isfinite(height_map.height_mm).all()
    error_mm = height_map.height_mm - surface[0]
    inside = distance_px(press, error_mm.shape) < CONTACT_PX
    assert np.sqrt(np.mean(error_mm[inside] ** 2)) < 0.01
    assert cap_mm(height_map.height_mm, press) / cap_mm(surface[0], press) == pytest.approx(
        1.0, abs=0.02
    )


def test_dark_corners_are_no_dots(calibrations):
    """Setup: dots on undeformed gel with half of its level in the corners, darker than a dot.

    Expected: `corrected` hides only the dots and their rims; the vendor's forms hide the corners
    as well, like their programs.
    """
    plain = calibrations["polynomial"]
    row, col = np.indices(plain.background.shape[:2])
    far = ((row - 119.5) / 120) ** 2 + ((col - 159.5) / 160) ** 2
    falloff = (1.0 - far / 4.0)[..., np.newaxis].astype(np.float32)
    background, dots = with_dots(plain.background * falloff)
    calibration = SensorCalibration(plain.colour_map, background, PITCH_MM, marker_level=70)
    hidden = {}
    for integration in ("corrected", "sdk_2025"):
        decoder = PhotometricDecoder(calibration, PhotometricOptions(integration))
        height_map = decoder.decode(background.astype(np.uint8))
        hidden[integration] = height_map.mask_reason == PhotometricReason.MARKER
        assert hidden[integration][dots].all()
    near_dots = cv2.dilate(dots.astype(np.uint8), np.ones((7, 7), np.uint8)).astype(bool)
    assert not hidden["corrected"][~near_dots].any()
    assert hidden["sdk_2025"][~near_dots].mean() > 0.01


def test_unmasked_dots_distort_the_map(calibrations, image, surface, press):
    """Without masking the moving dots are read as slopes: the masking has an effect."""
    shifted = image.copy()
    shifted[with_dots(image)[1]] = 20
    height_map = PhotometricDecoder(calibrations["polynomial"]).decode(shifted)
    assert np.sqrt(np.mean((height_map.height_mm - surface[0]) ** 2)) > 0.02


def test_reasons(calibrations, image):
    damaged = image.copy()
    damaged[5:8, 5:9] = (255, 128, 128)
    damaged[20:29, 30:39] = (90, 250, 90)
    height_map = PhotometricDecoder(calibrations["polynomial"]).decode(damaged)
    assert np.all(height_map.mask_reason[5:8, 5:9] == PhotometricReason.CLIPPED)
    assert np.all(height_map.mask_reason[21:28, 31:38] == PhotometricReason.UNCALIBRATED)
    assert height_map.valid.sum() >= image[..., 0].size - 5 * 6 - 11 * 11
    assert np.isfinite(height_map.slopes).all()


def test_held_border(calibrations, image, surface):
    options = PhotometricOptions(boundary="dirichlet")
    height_map = PhotometricDecoder(calibrations["polynomial"], options).decode(image)
    assert not height_map.height_mm[0].any()
    assert np.sqrt(np.mean((height_map.height_mm - surface[0]) ** 2)) < 0.005


@pytest.mark.parametrize("kind", ["polynomial", "table"])
def test_an_image_is_decoded_without_a_loop_over_pixels(calibrations, image, kind):
    """Some 700 lines of Python for 76,800 pixels; `./run bench gelsight` has the 20 ms."""
    decoder = PhotometricDecoder(calibrations[kind])
    assert lines_run(lambda: decoder.decode(image)) < 5_000


def test_bad_input_is_named(calibrations, image):
    decoder = PhotometricDecoder(calibrations["polynomial"])
    with pytest.raises(InputError, match="8-bit RGB"):
        decoder.decode(image.astype(float))
    with pytest.raises(InputError, match="the background has"):
        decoder.decode(image[:100])
    with pytest.raises(InputError, match="sdk_2024"):
        PhotometricOptions(integration="sdk")
    with pytest.raises(InputError, match="doubtful_weight"):
        PhotometricOptions(doubtful_weight=0.0)
