"""Printed dots of a photometric sensor: masked, tracked, and converted to mm on the gel."""

import json
from dataclasses import replace

import imageio.v3 as imageio
import numpy as np
import pytest
import xarray
from scipy.ndimage import gaussian_filter

from reconstruction.errors import CaptureError, InputError
from reconstruction.markers import DotStatus
from reconstruction.photometric import (
    PhotometricReason,
    gel_motion,
    reconstruct_photometric,
    write_sensor_calibration,
)
from reconstruction.photometric.sensor import HeightMap
from twin.pipeline.colour_presses import reconstruct_presses

PITCH_MM, SHAPE = 0.0634, (240, 320)
PITCH_PX, RADIUS_PX = 35, 8.0
GAMMA = 1.5
HEADER = 'format = "photometric-press"\nversion = 1\n'


def printed(image, shift_px=(0.0, 0.0)):
    """Return an image with dots that reflect a fifth of the light, moved by `shift_px`."""
    row, col = np.indices(SHAPE, dtype=float)
    offset = [
        (at - shift - 17.0 + PITCH_PX / 2) % PITCH_PX - PITCH_PX / 2
        for at, shift in zip((row, col), shift_px, strict=True)
    ]
    ink = gaussian_filter((np.hypot(*offset) < RADIUS_PX).astype(float), 0.8)
    factor = (1.0 - 0.8 * ink[..., None]) ** (1.0 / GAMMA)
    return np.rint(image * factor).astype(np.uint8)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, ball_presses, background_frames, calibrations):
    """Stills and a press of a gel with dots that slip by 3 px down and 4 px to the left."""
    place = tmp_path_factory.mktemp("dots")
    for number, frame in enumerate(background_frames[:3]):
        imageio.imwrite(place / f"still_{number}.png", printed(frame))
    imageio.imwrite(place / "coin.png", printed(ball_presses[-1].image, (3.0, -4.0)))
    imageio.imwrite(place / "bare.png", ball_presses[-1].image)
    write_sensor_calibration(place / "mini.npz", calibrations["polynomial"])
    return place


def described(folder, name, dots="[dots]\ngamma = 1.5\n", image='image = "coin.png"'):
    path = folder / f"{name}.toml"
    lines = f'{image}\nbackground = ["still_*.png"]\ncalibration = "mini.npz"\n{dots}'
    path.write_text(HEADER + lines, encoding="utf-8")
    return path


def test_dots_make_no_relief(folder, make_surface, presses):
    """Setup: a synthetic press with dots that move. Expected: heights within 0.02 mm RMS of the
    surface, as without dots (0.01); without the table [dots] twice that or more.
    """
    true = make_surface(presses[-1])[0]
    with_dots = reconstruct_photometric(described(folder, "masked")).height_map
    without = reconstruct_photometric(described(folder, "plain", dots="")).height_map
    rms = [np.sqrt(np.mean((of.height_mm - true) ** 2)) for of in (with_dots, without)]
    assert rms[0] < 0.02
    assert rms[1] > 2.0 * rms[0]
    masked = np.mean(with_dots.mask_reason == PhotometricReason.MARKER)
    dots = np.pi * RADIUS_PX**2 / PITCH_PX**2
    assert dots < masked < 3.0 * dots


def test_a_slip_is_tracked_and_written(folder, tmp_path):
    """Expected: x = -4 px, y = -3 px in mm to 0.05 px RMS, all of 63 dots but those at the border
    that leave the image; the smooth field agrees within its sigma.
    """
    out = tmp_path / "out"
    figures = reconstruct_presses(described(folder, "slip"), out).figures
    slip_mm = PITCH_MM * np.array([-4.0, -3.0])
    assert figures["dots_tracked"] >= 50
    assert figures["dots_doubtful"] == 0
    assert figures["dots_mean_x_um"] == pytest.approx(1e3 * slip_mm[0], abs=2.0)
    assert figures["dots_mean_y_um"] == pytest.approx(1e3 * slip_mm[1], abs=2.0)
    assert abs(figures["dots_rotation_mrad"]) < 1.0
    assert figures["dot_spacing_um"] == pytest.approx(1e3 * PITCH_PX * PITCH_MM, rel=0.01)
    stored = json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert stored["metrics"] == figures
    assert imageio.imread(out / "markers.png").ndim == 3
    with xarray.open_dataset(out / "markers.nc", engine="h5netcdf") as data:
        tracked = data.status.values == DotStatus.TRACKED
        moved = np.stack([data.moved_x_mm.values, data.moved_y_mm.values], axis=-1)
        assert np.sqrt(np.mean((moved[tracked] - slip_mm) ** 2)) < 0.05 * PITCH_MM
        assert not moved[data.status.values == DotStatus.LOST].any()
        field = np.stack([data.field_x_mm.values, data.field_y_mm.values], axis=-1)
        sigma = np.stack([data.field_sigma_x_mm.values, data.field_sigma_y_mm.values], axis=-1)
        inner = (slice(10, 50), slice(10, 70))
        assert np.mean(np.abs(field - slip_mm)[inner] < 3.0 * sigma[inner]) > 0.9
        assert data.moved_row_px.attrs["units"] == "px"
        assert data.status.attrs["flag_meanings"].split() == ["TRACKED", "LOST", "DOUBTFUL"]


def test_dots_of_a_gel_without_dots_are_an_error(folder, background_frames):
    imageio.imwrite(folder / "clean.png", background_frames[0])
    path = described(folder, "clean")
    path.write_text(path.read_text().replace("still_*.png", "clean.png"), encoding="utf-8")
    with pytest.raises(InputError, match=r"remove \[dots\]"):
        reconstruct_photometric(path)


def test_a_press_without_dots_loses_all(folder):
    path = described(folder, "bare", image='image = "bare.png"')
    motion = reconstruct_photometric(path).motion
    assert motion is not None
    assert (motion.tracks.status == DotStatus.LOST).all()


@pytest.mark.parametrize("line", ["gamma = 0.1", "view_distance_mm = -1", "spacing = 3"])
def test_mistakes_in_the_table(folder, line):
    with pytest.raises(CaptureError, match=line.split()[0]):
        reconstruct_photometric(described(folder, "wrong", dots=f"[dots]\n{line}\n"))


class Tracks:
    """Two dots: one raised by the press, which moves it outwards in the image, one at rest."""

    places_px = np.array([[119.5, 219.5], [19.5, 159.5]])
    moved_px = np.array([[0.0, 1.5], [0.0, 0.0]])
    sigma_px = np.full((2, 2), 0.02)


def test_the_height_of_a_dot_moves_it_in_the_image():
    """Setup: a pinhole 41 mm above the gel, a dot 10 mm from the axis raised by 1 mm: it appears
    at 10 * 41 / 40 = 10.25 mm. Expected: no displacement; without the distance, 0.25 mm.
    """
    height = np.zeros(SHAPE, np.float32)
    height[:, 200:] = 1.0
    slopes, reasons = np.zeros((2, *SHAPE), np.float32), np.zeros(SHAPE, np.uint8)
    flat = HeightMap(height, slopes, reasons, 1.0 / 6.0)
    tracks = Tracks()
    moved = gel_motion(tracks, flat, 41.0).moved_mm
    np.testing.assert_allclose(moved, 0.0, atol=1e-9)
    np.testing.assert_allclose(gel_motion(tracks, flat, 0.0).moved_mm[0], [0.25, 0.0], atol=1e-9)
    # Height 0.05 mm uncertain: 10 mm * 0.05 / 41; across, only the centre's 0.02 px.
    sigma_mm = gel_motion(tracks, flat, 41.0, 0.05).sigma_mm[0]
    centre_mm = 0.02 / 6.0
    expected = [np.hypot(centre_mm, 10.0 * 0.05 / 41.0), centre_mm]
    np.testing.assert_allclose(sigma_mm, expected, rtol=1e-6)


class Slipped:
    """A lattice of 63 dots that moves by a smooth field, with errors of 0.02 px of the centres."""

    def __init__(self, pitch_mm, rng):
        i, j = np.meshgrid(np.arange(-4.0, 5.0), np.arange(-3.0, 4.0))
        self.places_mm = np.column_stack([2.2 * i.ravel(), 2.0 * j.ravel()])
        middle = (np.array(SHAPE) - 1.0) / 2.0
        to_px = np.array([-1.0, 1.0]) / pitch_mm
        self.places_px = middle + self.places_mm[:, ::-1] * to_px
        noise = rng.normal(0.0, 0.02, self.places_px.shape)
        self.moved_px = slip_mm(self.places_mm)[:, ::-1] * to_px + noise
        self.sigma_px = np.full(self.places_px.shape, 0.02)
        self.tracked = np.ones(len(self.places_px), bool)


def slip_mm(places_mm):
    x, y = np.moveaxis(places_mm, -1, 0)
    near = 0.05 * np.exp(-(x**2 + y**2) / 30.0)
    return np.stack([0.01 + near, 0.002 * x - 0.5 * near], axis=-1)


def test_the_field_is_beside_its_uncertainty_under_errors_of_the_height():
    """Setup: heights with smooth errors of 25 um (Gaussian correlation, 4.5 mm), view from 41 mm.

    Expected: over 4 presses, RMS error of the field over sigma 0.8 to 1.25. Without the error that
    the dots around a point share, it is 1.5 or more.
    """
    rng, over, alone = np.random.default_rng(4), [], []
    for _ in range(4):
        error = gaussian_filter(rng.normal(size=SHAPE), 3.2 / PITCH_MM, mode="reflect")
        height = (0.025 * error / error.std()).astype(np.float32)
        slopes, reasons = np.zeros((2, *SHAPE), np.float32), np.zeros(SHAPE, np.uint8)
        heights = HeightMap(height, slopes, reasons, PITCH_MM)
        motion = gel_motion(Slipped(PITCH_MM, rng), heights, 41.0, 0.025)
        for of, errors in ((motion, over), (replace(motion, height_sigma_mm=0.0), alone)):
            field = of.field()
            errors.append((field.moved_mm - slip_mm(field.places_mm)) / field.sigma_mm)
    assert 0.8 < np.sqrt(np.mean(np.square(over))) < 1.25
    assert np.sqrt(np.mean(np.square(alone))) > 1.5
