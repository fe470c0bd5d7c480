"""capture.toml of a real rig, and which image file holds which frame."""

import pytest

from reconstruction.capture.frame_set import FrameSet, frame_files, read_frame_set
from reconstruction.errors import CaptureError, InputError
from reconstruction.patterns import PatternSet
from reconstruction.rig.sensor import SensorNoise

SENSOR = SensorNoise(0.1, 5.0, 4.0, 255.0)
PATTERNS = PatternSet(1280, 720, steps=3)
TEXT = """
format = "fringe-frames"
version = 1
files = "{index:03d}_{name}.png"
bit_depth = 8

[sensor]
gain_dn_per_e = 0.1
read_noise_e = 5.0
black_level_dn = 4.0
saturation_dn = 255.0
"""


def frame_set(files, **keys):
    return FrameSet(sensor=SENSOR, files=files, bit_depth=8, **keys)


def touch(folder, names):
    for name in names:
        (folder / name).touch()


def test_description_is_read_with_defaults(tmp_path):
    path = tmp_path / "capture.toml"
    path.write_text(TEXT)
    expected = frame_set(
        "{index:03d}_{name}.png",
        patterns_file="patterns.toml",
        calibration_file="calibration.yaml",
    )
    assert read_frame_set(path) == expected


@pytest.mark.parametrize(
    ("find", "replace", "message"),
    [
        ("bit_depth = 8", "bit_depth = 7", "bit_depth is 7"),
        ("bit_depth = 8", "bits = 8", "unknown key bits"),
        ("saturation_dn = 255.0", "saturation_dn = 256.0", "8 bits end at 255"),
        ("{index:03d}_{name}", "{index:03d}_{colour}", "allowed are the fields index"),
        ("{index:03d}_{name}", "image", "the same name for all frames"),
        ("{index:03d}_{name}", "{index:q}", "allowed are the fields"),
        ("bit_depth = 8", "bit_depth = 8\nexposures_ms = [1.0, 4.0]", "{set} is the number"),
        ("bit_depth = 8", "bit_depth = 8\nexposures_ms = [0.0]", "exposures_ms is 0.0"),
        ("version = 1", "version = 2", "format and version"),
    ],
)
def test_mistakes_in_the_description_are_one_line(tmp_path, find, replace, message):
    path = tmp_path / "capture.toml"
    assert find in TEXT
    path.write_text(TEXT.replace(find, replace))
    with pytest.raises(CaptureError) as caught:
        read_frame_set(path)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_named_files_come_in_the_order_of_the_patterns(tmp_path):
    names = [f"{frame.name}.png" for frame in PATTERNS.frames]
    touch(tmp_path, names)
    result = frame_files(tmp_path, frame_set("{name}.png"), PATTERNS)
    assert [path.name for path in result[0]] == names


def test_missing_frames_are_named(tmp_path):
    names = [f"{frame.name}.png" for frame in PATTERNS.frames]
    touch(tmp_path, [name for name in names if name not in ("phase_row_01.png", "white.png")])
    with pytest.raises(CaptureError, match=r"2 of \d+ frames .* phase_row_01.png, white.png;"):
        frame_files(tmp_path, frame_set("{name}.png"), PATTERNS)


def test_counted_files_come_in_natural_order_without_the_dark_one(tmp_path):
    count = len(PATTERNS.frames)
    touch(tmp_path, [f"cam_{i}.png" for i in range(1, count + 1)] + ["cam_dark.png"])
    result = frame_files(tmp_path, frame_set("cam_*.png", dark_file="cam_dark.png"), PATTERNS)
    assert [path.name for path in result[0]] == [f"cam_{i}.png" for i in range(1, count + 1)]


def test_gap_in_the_running_numbers_is_named(tmp_path):
    numbers = [i for i in range(len(PATTERNS.frames)) if i != 7]
    touch(tmp_path, [f"cam_{i:02d}.png" for i in numbers])
    with pytest.raises(CaptureError, match=r"numbers jump from 6 to 8"):
        frame_files(tmp_path, frame_set("cam_*.png"), PATTERNS)


def test_each_exposure_has_its_files(tmp_path):
    for number in range(2):
        (tmp_path / f"{number}").mkdir()
        touch(tmp_path / f"{number}", [f"{frame.name}.tif" for frame in PATTERNS.frames])
    description = frame_set("{set}/{name}.tif", exposures_ms=(1.0, 4.0))
    result = frame_files(tmp_path, description, PATTERNS)
    assert [files[0].parent.name for files in result] == ["0", "1"]
    with pytest.raises(InputError, match="use both or neither"):
        frame_set("{name}.tif", exposures_ms=(1.0, 4.0))


@pytest.mark.parametrize(
    "files",
    [
        "{index:2000000000d}.png",
        "{index:100}.png",
        "{index:{number}d}.png",
        "{index!r}.png",
        "{index:_<9}.png",
        "{name:2000000000}.png",
        "{set:999999999}/*.png",
        "{index}" + "x{" * 1000,
    ],
)
def test_fields_are_narrow(files):
    """A width is memory: two digits are wide enough for any name."""
    with pytest.raises(InputError, match="allowed are the fields") as caught:
        frame_set(files)
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize("files", ["{index:03d}_{name}.png", "{number:2}.png", "{index:d}.png"])
def test_usual_fields_stay(files):
    assert frame_set(files).files == files
