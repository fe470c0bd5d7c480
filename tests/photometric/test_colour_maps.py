import numpy as np
import pytest

from reconstruction.colour_maps import COLOUR_MAPS, maps_in_order
from reconstruction.errors import CaptureError, FitError, InputError
from reconstruction.photometric.images import smoothed
from reconstruction.photometric.maps.polynomial import ColourPolynomial
from reconstruction.photometric.press_description import Calibrate
from reconstruction.photometric.sensor import (
    SensorCalibration,
    calibrate_sensor,
    read_sensor_calibration,
    write_sensor_calibration,
)
from twin.config import load_experiment

PITCH_MM = 0.0634


def bound(calibration):
    return calibration.colour_map.bound_to(smoothed(calibration.background, 3))


def slope_rms(calibration, render, make_surface, press):
    """RMS error of the slope vector inside the contact, without the rim."""
    _, slopes = make_surface(press)
    measured, _ = bound(calibration).slopes(smoothed(render(slopes, 4000), 3))
    row, col = np.indices(slopes.shape[1:])
    inside = np.hypot(row - press.row_px, col - press.col_px) < press.contact_px - 4.0
    return np.sqrt(np.sum((measured - slopes) ** 2, axis=0)[inside].mean())


@pytest.mark.parametrize("number", [3, 17])
def test_slopes_inside_a_contact(calibrations, render, make_surface, presses, number):
    """One grey level of noise gives a slope error of 0.007; slopes are up to 0.6.

    The table does not depend on the place and has bins of two levels: its limit is larger.
    """
    errors = {
        kind: slope_rms(calibration, render, make_surface, presses[number])
        for kind, calibration in calibrations.items()
    }
    assert errors["polynomial"] < 0.012
    assert errors["polynomial"] < errors["table"] < 0.03


def test_undeformed_gel_is_flat(calibrations):
    """Exactly for the polynomial, which has no constant term; to the noise for the table."""
    for kind, limit in (("polynomial", 1e-6), ("table", 0.01)):
        calibration = calibrations[kind]
        slopes, known = bound(calibration).slopes(smoothed(calibration.background, 3))
        assert np.abs(slopes).max() < limit
        assert known.all()


@pytest.mark.parametrize("kind", COLOUR_MAPS.names())
def test_uncalibrated_colours_are_masked(calibrations, kind):
    calibration = calibrations[kind]
    levels = smoothed(calibration.background, 3)
    levels[100:110, 100:110] += (60.0, 60.0, 60.0)
    slopes, known = bound(calibration).slopes(levels)
    assert not known[100:110, 100:110].any()
    assert known.sum() == known.size - 100
    assert np.isfinite(slopes).all()


@pytest.mark.parametrize("kind", COLOUR_MAPS.names())
def test_file_is_reproduced(calibrations, tmp_path, kind):
    first, second = tmp_path / "a.npz", tmp_path / "b.npz"
    write_sensor_calibration(first, calibrations[kind])
    stored = read_sensor_calibration(first)
    write_sensor_calibration(second, stored)
    assert first.read_bytes() == second.read_bytes()
    for name, values in calibrations[kind].colour_map.arrays().items():
        np.testing.assert_array_equal(stored.colour_map.arrays()[name], values)
    assert (stored.pitch_mm, stored.smoothing_px) == (PITCH_MM, 3)


def test_same_presses_same_bytes(ball_presses, background_frames):
    maps = [
        calibrate_sensor(ball_presses[:6], background_frames[:2], PITCH_MM).colour_map
        for _ in range(2)
    ]
    assert maps[0].coefficients.tobytes() == maps[1].coefficients.tobytes()


def rewritten(path, target, **changes):
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    arrays |= changes
    np.savez(target, **{name: part for name, part in arrays.items() if part is not None})
    return target


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"version": np.array(9)}, "this program reads"),
        ({"kind": np.array("forest")}, "forest"),
        ({"pitch_mm": None}, "pitch_mm.*missing"),
        ({"map_lowest": None}, "lowest.*missing"),
        ({"map_coefficients": np.zeros((2, 3, 4))}, "it needs"),
        ({"map_highest": np.full(3, np.nan)}, "not finite"),
        ({"background": np.zeros((4, 4), np.float32)}, "background"),
        ({"smoothing_px": np.array(2)}, "odd"),
    ],
)
def test_wrong_files_are_refused(calibrations, tmp_path, changes, message):
    write_sensor_calibration(tmp_path / "a.npz", calibrations["polynomial"])
    path = rewritten(tmp_path / "a.npz", tmp_path / "b.npz", **changes)
    with pytest.raises(CaptureError, match=message) as caught:
        read_sensor_calibration(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_damaged_files_are_refused(calibrations, tmp_path):
    path = tmp_path / "a.npz"
    with pytest.raises(CaptureError, match="photometric calibration"):
        read_sensor_calibration(path)
    write_sensor_calibration(path, calibrations["polynomial"])
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(CaptureError, match="photometric calibration"):
        read_sensor_calibration(path)
    path.write_bytes(b"no archive")
    with pytest.raises(CaptureError, match="photometric calibration"):
        read_sensor_calibration(path)


def test_stored_objects_are_not_loaded(tmp_path):
    """A pickle in the archive must not be run."""
    path = tmp_path / "a.npz"
    np.savez(path, format=np.array([{"a": 1}], dtype=object))
    with pytest.raises(CaptureError, match="photometric calibration"):
        read_sensor_calibration(path)


def test_maps_in_the_order_of_tables():
    assert [kind.name for kind in maps_in_order()] == ["polynomial", "table"]
    assert all(kind.title and kind.summary for kind in maps_in_order())


def test_unknown_map_is_named_with_the_allowed_ones():
    """In an experiment and in the description of real presses."""
    with pytest.raises(InputError, match="did you mean 'table'") as caught:
        load_experiment("examples/gelsight_ball", {"photometric.colour_map": "tabel"})
    message = str(caught.value)
    assert "photometric.colour_map: found 'tabel', allowed: polynomial, table" in message
    assert "\n" not in message
    with pytest.raises(InputError, match=r"map is 'tabel'; give one of polynomial, table$"):
        Calibrate(0.06, (), map="tabel")


def test_bad_input_is_named(calibrations, ball_presses, background_frames):
    with pytest.raises(InputError, match="polynomial, table"):
        calibrate_sensor(ball_presses[:1], background_frames, PITCH_MM, "net")
    with pytest.raises(InputError, match="background"):
        calibrate_sensor(ball_presses[:1], background_frames[0], PITCH_MM)
    good = calibrations["polynomial"]
    with pytest.raises(InputError, match="0 to 255"):
        SensorCalibration(good.colour_map, good.background * 3.0, PITCH_MM)
    with pytest.raises(CaptureError, match="empty range"):
        ColourPolynomial(good.colour_map.coefficients, np.ones(3), np.zeros(3))


def test_too_few_pixels(ball_presses, background_frames):
    """A tiny contact gives fewer pixels than the polynomial has coefficients."""
    small = min(ball_presses, key=lambda press: press.ball_diameter_mm)
    cut = slice(60, 180)
    frames = background_frames[:, cut, cut]
    assert small.image[cut, cut].shape == frames[0].shape
    press = type(small)(_pasted(small, frames[0]), small.ball_diameter_mm)
    with pytest.raises(FitError, match="calibration pixels for"):
        calibrate_sensor([press], frames, PITCH_MM)


def _pasted(press, flat):
    """A contact of 10 px radius: dark and bright sides of a small disc on undeformed gel."""
    image = flat.astype(float)
    row, col = np.indices(flat.shape[:2]) - 60.0
    inside = np.hypot(row, col) < 10.0
    image[inside] += 4.0 * np.stack([-row, col, row], axis=-1)[inside]
    return np.clip(image, 0, 255).astype(np.uint8)
