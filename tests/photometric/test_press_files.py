import json
import subprocess
import sys
from dataclasses import replace
from functools import partial

import imageio.v3 as imageio
import numpy as np
import pytest
import trimesh
import xarray

from reconstruction.errors import CaptureError
from reconstruction.photometric import (
    PhotometricDecoder,
    PhotometricReason,
    described_presses,
    read_height_map,
    read_sensor_calibration,
    reconstruct_photometric,
    write_height_map,
    write_height_points,
    write_sensor_calibration,
)
from reconstruction.photometric.press_description import Framing
from reconstruction.photometric.press_files import framed, read_rgb
from twin.pipeline.colour_presses import reconstruct_presses
from twin.report.presses import write_presses_page

BALLS = 6
HEADER = 'format = "photometric-press"\nversion = 1\n'


@pytest.fixture(scope="module")
def folder(tmp_path_factory, ball_presses, background_frames):
    """A user's folder: stills, presses of balls, a measurement."""
    place = tmp_path_factory.mktemp("press")
    for number, frame in enumerate(background_frames[:3]):
        imageio.imwrite(place / f"still_{number}.png", frame)
    for number, press in enumerate(ball_presses[:BALLS]):
        imageio.imwrite(place / f"ball_{number}.png", press.image)
    imageio.imwrite(place / "coin.png", ball_presses[-1].image)
    return place


def description(ball_presses, **changes):
    balls = "".join(
        f"[[calibrate.balls]]\ndiameter_mm = {press.ball_diameter_mm!r}\n"
        f'images = ["ball_{number}.png"]\n'
        for number, press in enumerate(ball_presses[:BALLS])
    )
    lines = {
        "image": 'image = "coin.png"\n',
        "background": 'background = ["still_0.png", "still_1.png", "still_2.png"]\n',
        "calibrate": f"[calibrate]\npitch_mm = 0.0634\n{balls}",
        "options": '[options]\nintegration = "corrected"\n',
    }
    return HEADER + "".join((lines | changes).values())


def test_from_files_to_height_and_back(folder, tmp_path, ball_presses, make_surface, presses):
    path = folder / "press.toml"
    path.write_text(description(ball_presses), encoding="utf-8")
    result = reconstruct_photometric(path)
    error_mm = result.height_map.height_mm - make_surface(presses[-1])[0]
    assert np.sqrt(np.mean(error_mm**2)) < 0.01
    write_height_map(tmp_path / "height.nc", result.height_map)
    stored = read_height_map(tmp_path / "height.nc")
    for name in ("height_mm", "slopes", "mask_reason"):
        before, after = getattr(result.height_map, name), getattr(stored, name)
        np.testing.assert_array_equal(after, before)
        assert after.dtype == before.dtype
    assert stored.pitch_mm == 0.0634
    with xarray.open_dataset(tmp_path / "height.nc", engine="h5netcdf") as data:
        assert data.height_mm.attrs["units"] == "mm"
        assert len(data.mask_reason.attrs["flag_meanings"].split()) == len(PhotometricReason)
    write_height_points(tmp_path / "points.ply", result.height_map)
    cloud = trimesh.load(tmp_path / "points.ply")
    np.testing.assert_allclose(cloud.vertices, result.height_map.points_mm(), atol=1e-6)


def test_stored_calibration_with_a_new_background(folder, calibrations, ball_presses):
    write_sensor_calibration(folder / "mini.npz", calibrations["polynomial"])
    path = folder / "stored.toml"
    lines = 'image = "coin.png"\ncalibration = "mini.npz"\n'
    path.write_text(HEADER + lines, encoding="utf-8")
    stored = reconstruct_photometric(path).height_map
    expected = PhotometricDecoder(calibrations["polynomial"]).decode(ball_presses[-1].image)
    np.testing.assert_array_equal(stored.height_mm, expected.height_mm)
    path.write_text(HEADER + lines + 'background = "still_0.png"\n', encoding="utf-8")
    result = reconstruct_photometric(path)
    still = imageio.imread(folder / "still_0.png")
    np.testing.assert_array_equal(result.calibration.background, still)


def test_red_is_first_and_frames_are_cut(tmp_path):
    """A pure red pixel stays in channel 0; cropping 15 % per side of 40 x 60 gives 28 x 42."""
    image = np.zeros((40, 60, 3), np.uint8)
    image[6:34, 9:51, 0] = 200
    imageio.imwrite(tmp_path / "red.png", image)
    cut = read_rgb(tmp_path / "red.png", Framing(crop_share=0.15))
    assert cut.shape == (28, 42, 3)
    assert np.all(cut == (200, 0, 0))
    assert framed(image, Framing(0.15, 21, 14)).shape == (14, 21, 3)


def test_jpeg_is_read(folder, tmp_path):
    image = imageio.imread(folder / "coin.png")
    imageio.imwrite(tmp_path / "coin.jpg", image, quality=95)
    assert np.abs(read_rgb(tmp_path / "coin.jpg").astype(int) - image).mean() < 3.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"image": 'image = "none.png"\n'}, r"none\.png: cannot be read"),
        ({"image": 'image = "press.toml"\n'}, r"press\.toml: (cannot be read|holds no image)"),
        ({"image": ""}, "either the key image"),
        ({"background": ""}, "background is empty"),
        ({"background": "background = 3\n"}, "background is 3"),
        ({"calibrate": ""}, r"either the key calibration .* or the table \[calibrate\]"),
        ({"calibrate": "[calibrate]\npitch_mm = 0.0634\n"}, "calibrate.balls.* is missing"),
        ({"options": '[options]\nintegration = "sdk"\n'}, "sdk_2024"),
        ({"options": "[options]\nborder = 1\n"}, "unknown key border"),
        ({"options": "[frame]\ncrop_share = 0.6\n"}, "crop_share"),
        ({"options": "[frame]\nwidth_px = 320\n"}, "both or neither"),
    ],
)
def test_mistakes_are_named_in_a_single_line(folder, ball_presses, changes, message):
    path = folder / "wrong.toml"
    (folder / "press.toml").touch()
    path.write_text(description(ball_presses, **changes), encoding="utf-8")
    with pytest.raises(CaptureError, match=message) as caught:
        reconstruct_photometric(path)
    assert "\n" not in str(caught.value)


def test_grey_images_are_refused(folder, tmp_path):
    imageio.imwrite(tmp_path / "grey.png", np.zeros((8, 8), np.uint8))
    with pytest.raises(CaptureError, match="8-bit colour image"):
        read_rgb(tmp_path / "grey.png")


def test_image_of_another_size(folder, calibrations):
    write_sensor_calibration(folder / "mini.npz", calibrations["polynomial"])
    imageio.imwrite(folder / "small.png", np.zeros((24, 32, 3), np.uint8))
    path = folder / "small.toml"
    path.write_text(HEADER + 'image = "small.png"\ncalibration = "mini.npz"\n', encoding="utf-8")
    with pytest.raises(CaptureError, match=r"small\.png: image has shape \(24, 32, 3\)"):
        reconstruct_photometric(path)
    lines = 'image = "coin.png"\nbackground = "small.png"\ncalibration = "mini.npz"\n'
    path.write_text(HEADER + lines, encoding="utf-8")
    with pytest.raises(CaptureError, match="the calibration was made with"):
        reconstruct_photometric(path)


def test_damaged_height_map(tmp_path):
    path = tmp_path / "height.nc"
    path.write_bytes(b"nothing")
    with pytest.raises(CaptureError, match="netCDF-4"):
        read_height_map(path)


def test_needs_neither_twin_nor_renderer():
    forbidden = {"twin", "mitsuba", "drjit", "trimesh", "skfem"}
    program = (
        "import sys, reconstruction.photometric\n"
        f"print(sorted({forbidden} & {{name.partition('.')[0] for name in sys.modules}}))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stderr


def test_result_folder(folder, tmp_path, ball_presses):
    """Files of `twin reconstruct --photometric`; their calibration gives the same heights."""
    path = folder / "whole.toml"
    path.write_text(description(ball_presses), encoding="utf-8")
    figures = reconstruct_presses(path, tmp_path / "out").figures
    stored = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    assert stored["metrics"] == figures
    assert figures["points"] + figures["masked_uncalibrated"] == 240 * 320
    assert 0.1 < figures["highest_mm"] < 2.0
    assert (tmp_path / "out" / "points.ply").is_file()
    calibration = read_sensor_calibration(tmp_path / "out" / "sensor_calibration.npz")
    decoded = PhotometricDecoder(calibration).decode(ball_presses[-1].image)
    before = read_height_map(tmp_path / "out" / "height.nc")
    np.testing.assert_array_equal(decoded.height_mm, before.height_mm)


def test_a_folder_of_presses(folder, tmp_path, ball_presses, presses):
    """All images that match a pattern, under one calibration; a damaged one affects no other."""
    for number in (7, 8, 9):
        imageio.imwrite(folder / f"unknown_{number}.png", ball_presses[number].image)
    (folder / "unknown_damaged.png").write_bytes(b"nothing")
    path = folder / "many.toml"
    path.write_text(
        description(ball_presses, image='images = ["unknown_*.png"]\n'), encoding="utf-8"
    )
    outcome = reconstruct_presses(path, tmp_path / "out")
    assert outcome.figures["presses"] == 3
    assert outcome.figures["presses_refused"] == 1
    assert any("unknown_damaged.png: " in doubt for doubt in outcome.doubts)
    rows = (tmp_path / "out" / "presses.csv").read_text(encoding="utf-8").splitlines()
    assert [row.split(",")[0] for row in rows[1:]] == [
        "000_unknown_7", "001_unknown_8", "002_unknown_9", "003_unknown_damaged",
    ]  # fmt: skip
    single = described_presses(path).measure(folder / "unknown_8.png").height_map
    stored = read_height_map(tmp_path / "out" / "presses" / "001_unknown_8" / "height.nc")
    np.testing.assert_array_equal(stored.height_mm, single.height_mm)
    assert imageio.imread(tmp_path / "out" / "heights.png").shape[2] >= 3


@pytest.mark.parametrize("name", ["cut.png", "cut.jpg", "small.png", "grey.png", "gone.png"])
def test_one_bad_image_costs_that_image(folder, tmp_path, calibrations, capfd, name):
    """Truncated, of another size, without colours, missing: named with the reason, in the result
    and on the page; the other press is measured. The library prints nothing by itself.
    """
    place, image = folder / name, imageio.imread(folder / "coin.png")
    if name.startswith("cut"):
        imageio.imwrite(place, image)
        place.write_bytes(place.read_bytes()[:-200])
    elif name != "gone.png":
        imageio.imwrite(place, image[::2, ::2] if name == "small.png" else image[..., 0])
    path = folder / "one_bad.toml"
    write_sensor_calibration(folder / "mini.npz", calibrations["polynomial"])
    lines = f'images = ["coin.png", "{name}"]\ncalibration = "mini.npz"\n'
    path.write_text(HEADER + lines, encoding="utf-8")
    outcome = reconstruct_presses(
        path, tmp_path / "out", draw=partial(write_presses_page, name="one_bad")
    )
    assert outcome.figures["presses"] == 1
    (refused,) = outcome.figures["refused"]
    assert f"{name}: " in refused
    assert "\n" not in refused
    stored = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    assert stored["metrics"]["refused"] == [refused]
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert page.count(name) >= 2
    assert capfd.readouterr().err == ""


def test_bad_calibration_images_are_left_out(folder, tmp_path, ball_presses):
    """One image of a ball is cut: the result is that without this ball, with a warning."""
    cut, whole = folder / "ball_cut.png", folder / "ball_0.png"
    cut.write_bytes(whole.read_bytes()[:-500])
    path = folder / "five.toml"
    text = description(ball_presses)
    first = text.index("[[calibrate.balls]]")
    second = text.index("[[calibrate.balls]]", first + 1)
    path.write_text(text[:first] + text[second:], encoding="utf-8")
    without = reconstruct_photometric(path)
    path.write_text(text.replace("ball_0.png", "ball_cut.png"), encoding="utf-8")
    result = reconstruct_photometric(path)
    np.testing.assert_array_equal(result.height_map.height_mm, without.height_map.height_mm)
    assert result.doubts[0].startswith(f"calibration without {cut}: ")
    assert without.doubts == ()


def test_a_bad_background_is_an_error(folder, ball_presses):
    (folder / "still_cut.png").write_bytes((folder / "still_0.png").read_bytes()[:-500])
    path = folder / "no_flat.toml"
    lines = 'background = ["still_0.png", "still_cut.png"]\n'
    path.write_text(description(ball_presses, background=lines), encoding="utf-8")
    with pytest.raises(CaptureError, match=r"still_cut\.png: holds no image"):
        described_presses(path)


def test_only_damaged_presses_are_an_error(folder, tmp_path, ball_presses):
    for number in (1, 2):
        (folder / f"bad_{number}.png").write_bytes(b"nothing")
    path = folder / "bad.toml"
    path.write_text(description(ball_presses, image='images = ["bad_*.png"]\n'), encoding="utf-8")
    with pytest.raises(CaptureError, match="no press can be measured"):
        reconstruct_presses(path, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("names", "message"),
    [('"none_*.png"', "matches no file"), ('"/*"', "no pattern of file names")],
)
def test_patterns_without_files(folder, ball_presses, names, message):
    path = folder / "nowhere.toml"
    path.write_text(description(ball_presses, image=f"images = [{names}]\n"), encoding="utf-8")
    with pytest.raises(CaptureError, match=message):
        described_presses(path)


def test_another_units_calibration_is_doubted(folder, calibrations, ball_presses):
    """A background 15 % off, as between two units; and, without one, no undeformed gel.

    The same unit's own background and presses raise no doubt.
    """
    write_sensor_calibration(folder / "mini.npz", calibrations["polynomial"])
    own = calibrations["polynomial"]
    shade = np.linspace(0.8, 1.1, own.background.shape[1])[None, :, None]
    second_unit = replace(own, background=(own.background * shade).clip(0, 255).astype(np.float32))
    write_sensor_calibration(folder / "other.npz", second_unit)
    path = folder / "unit.toml"
    doubts = {}
    for name in ("mini", "other"):
        lines = f'image = "coin.png"\ncalibration = "{name}.npz"\n'
        path.write_text(HEADER + lines, encoding="utf-8")
        doubts[name] = reconstruct_photometric(path).doubts
        path.write_text(HEADER + lines + 'background = "still_0.png"\n', encoding="utf-8")
        doubts[name + " and a background"] = reconstruct_photometric(path).doubts
    assert doubts["mini"] == doubts["mini and a background"] == ()
    assert "another unit" in doubts["other and a background"][0]
    assert doubts["other"] != ()
