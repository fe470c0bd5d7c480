"""Frames in image files: PNG, TIFF, EXR, dark frame, several exposures, and their errors."""

from dataclasses import asdict, replace

import imageio.v3 as imageio
import numpy as np
import OpenEXR
import pytest

from reconstruction.calibration.observation import pose_folders, read_board_capture
from reconstruction.capture.description import write_manifest, write_patterns, write_toml
from reconstruction.capture.folder import read_capture, write_capture
from reconstruction.capture.frame_set import FrameSet
from reconstruction.capture.image_files import read_image, subtract_dark
from reconstruction.errors import CaptureError, InputError
from reconstruction.patterns import PatternSet
from reconstruction.pipeline import reconstruct
from reconstruction.rig.calibration import write_calibration
from reconstruction.rig.sensor import SensorNoise

PATTERNS = PatternSet(1280, 720, steps=4)
SENSOR = SensorNoise(0.0625, 4.0, 4.0, 255.0)


@pytest.fixture(scope="module")
def points_mm(calibration, surface):
    return surface(calibration)


@pytest.fixture(scope="module")
def frames(calibration, points_mm, project, synthesise):
    """Return ideal 8-bit frames, (frame, row, col)."""
    observed = project(calibration, points_mm)
    exact = synthesise(PATTERNS, observed[..., 0], observed[..., 1], blur_px=0.7)
    return np.rint(exact).astype(np.uint8)


@pytest.fixture(scope="module")
def manifest(tmp_path_factory):
    folder = tmp_path_factory.mktemp("patterns")
    write_patterns(folder, PATTERNS)
    return (folder / "patterns.toml").read_bytes()


@pytest.fixture
def write_folder(tmp_path, calibration, manifest):
    """Return a function that lays out a capture folder without its images."""

    def write(sensor=SENSOR, **said):
        folder = tmp_path / "rig"
        folder.mkdir()
        values = {"format": "fringe-frames", "version": 1, "files": "{name}.png", "bit_depth": 8}
        write_toml(folder / "capture.toml", values | said, {"sensor": asdict(sensor)})
        (folder / "patterns.toml").write_bytes(manifest)
        write_calibration(folder / "calibration.yaml", calibration)
        return folder

    return write


def save(folder, stack, name="{name}.png"):
    for frame, image in zip(PATTERNS.frames, stack, strict=True):
        imageio.imwrite(folder / name.format(name=frame.name), image, plugin="pillow")


def z_error_um(capture, points_mm):
    points = reconstruct(capture).point_map
    assert points.valid.mean() > 0.8
    return 1e3 * np.abs(points.points_world_mm - points_mm)[points.valid][:, 2]


def test_png_frames_are_reconstructed(write_folder, frames, points_mm):
    """Expected: no more than 8-bit rounding: sigma_z of a pixel is about 5 um here."""
    folder = write_folder()
    save(folder, frames)
    capture = read_capture(folder)
    assert capture.stack.dtype == np.uint8
    np.testing.assert_array_equal(capture.stack, frames)
    sigma_um = 1e3 * np.median(reconstruct(capture).point_map.sigma_z_mm)
    assert np.median(z_error_um(capture, points_mm)) < 3.0 * sigma_um


def test_sixteen_bit_tiff_and_float_exr_hold_the_same_frames(write_folder, frames):
    sensor = SensorNoise(1.0, 4.0, 64.0, 4095.0)
    folder = write_folder(sensor, files="{name}.tif", bit_depth=12)
    wide = frames.astype(np.uint16) * 16
    save(folder, wide, "{name}.tif")
    np.testing.assert_array_equal(read_capture(folder).stack, wide)
    text = (folder / "capture.toml").read_text()
    (folder / "capture.toml").write_text(text.replace(".tif", ".exr"))
    for frame, image in zip(PATTERNS.frames, wide, strict=True):
        channels = {"Y": image.astype(np.float32)}
        OpenEXR.File({}, channels).write(str(folder / f"{frame.name}.exr"))
    result = read_capture(folder).stack
    assert result.dtype == np.float32
    np.testing.assert_array_equal(result, wide)


def test_calibration_reads_the_same_folders(write_folder, frames):
    """A board pose needs no calibration file yet."""
    folder = write_folder()
    save(folder, frames)
    (folder / "calibration.yaml").unlink()
    assert pose_folders(folder.parent) == [folder]
    result = read_board_capture(folder)
    np.testing.assert_array_equal(result.stack, frames)
    assert (result.patterns, result.sensor, result.scale) == (PATTERNS, SENSOR, None)


def test_a_board_pose_without_white_and_black_is_read(write_folder, frames):
    """Expected: the same frames without the last two; along one axis only, one line of error."""
    folder = write_folder(files="{name}.png")
    save(folder, frames, "{name}.png")
    write_manifest(folder / "patterns.toml", replace(PATTERNS, uniform=False))
    np.testing.assert_array_equal(read_board_capture(folder).stack, frames[:-2])
    write_manifest(folder / "patterns.toml", replace(PATTERNS, axes=("column",)))
    with pytest.raises(CaptureError, match="fringes along both axes"):
        read_board_capture(folder)


def test_dark_frame_is_taken_off(write_folder, frames):
    """Setup: a pattern of 0 to 20 DN over all frames; expected: it is gone, at the black level."""
    folder = write_folder(dark_file="dark.png")
    dark = np.add.outer(np.arange(90) % 3, np.arange(120) % 8).astype(np.uint8)
    dimmed = np.rint(0.8 * frames).astype(np.uint8)
    save(folder, dimmed + dark)
    imageio.imwrite(folder / "dark.png", dark)
    np.testing.assert_array_equal(read_capture(folder).stack, dimmed + np.float32(4.0))


def test_clipped_and_lost_pixels_survive_the_dark_frame():
    stack = np.array([[[255, 0, 250, 100]]], np.uint8)
    dark = np.array([[9, 9, 0, 9]], np.uint8)
    result = subtract_dark(stack, dark, SENSOR)
    np.testing.assert_array_equal(result, [[[255.0, 0.0, 254.0, 95.0]]])
    # 253 may be a full pixel with read noise: unchanged; 252 is lifted.
    lifted = subtract_dark(np.array([[[253, 252]]], np.uint8), np.array([[0, 0]], np.uint8), SENSOR)
    np.testing.assert_array_equal(lifted, [[[253.0, 255.0]]])


def exposed(frames, factor):
    light = factor * (frames.astype(np.float64) - SENSOR.black_level_dn)
    return np.clip(np.rint(SENSOR.black_level_dn + light), 0, 255).astype(np.uint8)


@pytest.fixture
def two_exposures(write_folder, frames):
    """Return a folder with exposures of 2 and 5 ms of a scene with a bright left half."""
    folder = write_folder(files="{set}/{name}.png", exposures_ms=[2.0, 5.0])
    scene = 0.3 * frames.astype(np.float64)
    scene[:, :, :60] *= 3.0
    for number, factor in enumerate((1.0, 2.5)):
        (folder / str(number)).mkdir()
        save(folder / str(number), exposed(scene, factor))
    return folder


def test_exposures_are_merged_and_scaled(two_exposures, points_mm):
    """Expected: bright pixels come from the short set, times 5 / 2; both halves are measured."""
    capture = read_capture(two_exposures)
    assert set(np.unique(capture.scale[:, :50])) == {2.5}
    assert set(np.unique(capture.scale[:, 65:])) == {1.0}
    assert capture.stack.max() > 255.0
    error_um = z_error_um(capture, points_mm)
    assert np.median(error_um) < 3e3 * np.median(reconstruct(capture).point_map.sigma_z_mm)
    with pytest.raises(CaptureError, match="merged exposures"):
        write_capture(two_exposures, capture)


def test_exchanged_exposures_are_noticed(two_exposures):
    text = (two_exposures / "capture.toml").read_text()
    (two_exposures / "capture.toml").write_text(text.replace("[2.0, 5.0]", "[5.0, 2.0]"))
    with pytest.raises(CaptureError, match=r"exposures_ms give 0.4; .* look exchanged"):
        read_capture(two_exposures)


def replace_image(name, change):
    def damage(folder):
        image = imageio.imread(folder / name)
        imageio.imwrite(folder / name, change(image))

    return damage


def swap(first, second):
    def damage(folder):
        (folder / first).rename(folder / "held.png")
        (folder / second).rename(folder / first)
        (folder / "held.png").rename(folder / second)

    return damage


def edit(find, replace):
    def damage(folder):
        text = (folder / "capture.toml").read_text()
        assert find in text
        (folder / "capture.toml").write_text(text.replace(find, replace))

    return damage


DAMAGES = {
    "missing": (lambda f: (f / "gray_row_02.png").unlink(), "missing: gray_row_02.png"),
    "size": (
        replace_image("white.png", lambda i: i[:-1]),
        "white.png: is 120 x 89 px of uint8, phase_column_00.png is 120 x 90 px",
    ),
    "type": (replace_image("white.png", lambda i: i.astype(np.uint16)), "px of uint16, phase"),
    "colour": (
        replace_image("white.png", lambda i: np.stack([i, i // 2, i], -1)),
        "white.png: is 120 x 90 px of uint8 with 3 channels; record grey images",
    ),
    "truncated": (
        lambda f: (f / "gray_row_06.png").write_bytes((f / "gray_row_06.png").read_bytes()[:150]),
        "gray_row_06.png: is no complete image",
    ),
    "too few bits": (edit("bit_depth = 8", "bit_depth = 10"), "holds 8 bits, capture.toml has"),
    "other camera": (
        lambda f: [replace_image(p.name, lambda i: i[:-1])(f) for p in f.glob("*.png")],
        r"\(34, 90, 120\)|need .* 90, 120",
    ),
    "exchanged": (
        swap("gray_column_06.png", "gray_column_07.png"),
        r"\(gray_column_06\) and \d+ \(gray_column_07\) look exchanged",
    ),
    "white and black": (swap("white.png", "black.png"), "white and black look exchanged"),
    "no manifest": (lambda f: (f / "patterns.toml").unlink(), "patterns.toml: cannot be read"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_explained_in_one_line(write_folder, frames, name):
    folder = write_folder()
    save(folder, frames)
    damage, message = DAMAGES[name]
    damage(folder)
    with pytest.raises(CaptureError, match=message) as caught:
        read_capture(folder)
    assert "\n" not in str(caught.value)
    assert str(folder) in str(caught.value)


@pytest.mark.parametrize(
    "files",
    ["/etc/*", "../../**", "**/*.png", "a**b", "../{index}.png", "/{name}.png", "x/../*", "~/*"],
)
def test_files_outside_of_the_folder_are_not_looked_for(files):
    with pytest.raises(InputError, match="give names in the folder of"):
        FrameSet(sensor=SensorNoise(1.0, 4.0, 0.0, 255.0), files=files, bit_depth=8)


def test_values_beyond_the_bit_depth_tell_left_aligned_bits(write_folder, frames):
    folder = write_folder(SensorNoise(1.0, 4.0, 64.0, 4095.0), files="{name}.tif", bit_depth=12)
    save(folder, frames.astype(np.uint16) * 256, "{name}.tif")
    with pytest.raises(CaptureError, match="12 bits end at 4095; all values are multiples of 256"):
        read_capture(folder)


@pytest.mark.parametrize(
    ("head", "message"),
    [
        (b"P3\n3 2\n255\n", "no header of a PGM"),
        (b"P2\n3 2\n255\n1 2 3 4 5 #", "5 numbers, 3 x 2 px with values up to 255 need 6"),
        (b"P2\n3 2\n9\n1 2 3 4 5 10 #", "a value is not within 0 to 9"),
        (b"P2\n3 1\n9\n1 x 3 #", "invalid literal"),
        (b"P5\n# made by hand\n3 2\n65536\n", "values up to 65536"),
        (b"P5\n30 2\n255\n", "need 72"),
    ],
)
def test_damaged_grey_maps_are_rejected(tmp_path, head, message):
    path = tmp_path / "image.pgm"
    path.write_bytes(head + bytes(range(12)))
    with pytest.raises(CaptureError, match=message):
        read_image(path)


def test_grey_maps_and_arrays_have_the_stored_values(tmp_path):
    """A largest value of 4095 is not stretched, and there are comments between the numbers."""
    path = tmp_path / "image.pgm"
    path.write_bytes(b"P5 # 12 bits\n3 2 # columns rows\n4095\n" + bytes(range(12)))
    expected = np.array([[1, 515, 1029], [1543, 2057, 2571]], np.uint16)
    np.testing.assert_array_equal(read_image(path), expected)
    np.save(tmp_path / "image.npy", expected.astype(np.float32))
    np.testing.assert_array_equal(read_image(tmp_path / "image.npy"), expected)
    for refused in (np.array([{}]), np.zeros((0, 3), np.uint8)):
        np.save(tmp_path / "image.npy", refused, allow_pickle=True)
        with pytest.raises(CaptureError, match="no complete image"):
            read_image(tmp_path / "image.npy")


@pytest.mark.parametrize(("largest", "kind"), [(255, np.uint8), (4095, np.uint16)])
def test_text_pgm_holds_its_numbers(tmp_path, largest, kind):
    path = tmp_path / "a.pgm"
    path.write_bytes(b"P2 # by hand\n3 2\n%d\n0 1 2 # a row\n3 4 %d\n" % (largest, largest))
    image = read_image(path)
    assert image.dtype == kind
    assert image.tolist() == [[0, 1, 2], [3, 4, largest]]


def test_transparency_of_a_grey_image_is_ignored(tmp_path):
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4)
    imageio.imwrite(tmp_path / "a.png", np.stack([grey, np.full_like(grey, 128)], axis=-1))
    assert np.array_equal(read_image(tmp_path / "a.png"), grey)
