import shutil
from pathlib import Path

import h5netcdf
import h5py
import numpy as np
import pytest
import xarray

from reconstruction.capture.folder import Capture, read_capture, write_capture
from reconstruction.capture.stack_file import write_stack
from reconstruction.errors import CaptureError, InputError
from reconstruction.patterns import PatternSet
from reconstruction.rig.sensor import SensorNoise


@pytest.fixture(scope="module")
def capture(calibration, surface, project, synthesise):
    patterns = PatternSet(1280, 720)
    observed = project(calibration, surface(calibration))
    frames = 64.0 + 15.0 * synthesise(patterns, observed[..., 0], observed[..., 1])
    noise = np.random.default_rng(1).normal(0.0, 10.0, frames.shape)
    stack = np.rint(frames + noise).astype(np.uint16)
    return Capture(stack, patterns, SensorNoise(0.17, 6.2, 64, 4095.0), calibration, 12)


@pytest.fixture
def folder(tmp_path, capture):
    target = tmp_path / "capture"
    target.mkdir()
    write_capture(target, capture)
    return target


def test_capture_round_trip(folder, capture):
    for place in (folder, folder.parent, str(folder)):
        result = read_capture(place)
        np.testing.assert_array_equal(result.stack, capture.stack)
        assert result.stack.dtype == np.uint16
        assert (result.patterns, result.sensor, result.bit_depth) == (
            capture.patterns,
            capture.sensor,
            12,
        )
        assert result.calibration.camera == capture.calibration.camera


def test_stack_is_plain_netcdf(folder, capture):
    with xarray.open_dataset(folder / "stack.nc", engine="h5netcdf") as data:
        assert data["stack"].dims == ("frame", "row", "col")
        assert data["stack"].attrs["units"] == "DN"
        assert str(data["frame_name"].values[3]) == "phase_column_03"
        np.testing.assert_array_equal(data["stack"].values, capture.stack)


def test_frames_lie_one_after_the_other_uncompressed(folder, capture):
    """Any frame is a single read, and only the stack occupies the file."""
    with h5py.File(folder / "stack.nc", "r") as file:
        assert file["stack"].chunks is None
        assert file["stack"].id.get_storage_size() == capture.stack.nbytes
    assert (folder / "stack.nc").stat().st_size < capture.stack.nbytes + 50_000


def test_a_full_disk_is_an_ordinary_error(capture):
    with pytest.raises(OSError, match="No space left on device"):
        write_stack(Path("/dev/full"), capture.stack, capture.patterns)


def test_only_an_existing_empty_folder_is_written(folder, capture, tmp_path):
    for target in (folder, tmp_path / "missing"):
        with pytest.raises(CaptureError, match="existing empty folder"):
            write_capture(target, capture)


def edit(file, find, replace):
    def damage(folder):
        text = (folder / file).read_text()
        assert find in text
        (folder / file).write_text(text.replace(find, replace))

    return damage


def remove(file):
    return lambda folder: (folder / file).unlink()


def truncate(file, keep):
    def damage(folder):
        data = (folder / file).read_bytes()
        (folder / file).write_bytes(data[: int(keep * len(data))])

    return damage


def exchanged(stack):
    """Exchange two frames, as a camera does that misses a trigger."""
    order = [*range(3), 4, 3, *range(5, len(stack))]
    return stack[order]


def restack(change=lambda stack: stack, names=lambda names: names, variable="stack", order=None):
    def damage(folder):
        with h5netcdf.File(folder / "stack.nc", "r") as file:
            stack = change(np.asarray(file["stack"][...]))
            result = names([str(name, "utf-8") for name in file["frame_name"][...]])
        with h5netcdf.File(folder / "stack.nc", "w") as file:
            dims = order or ("frame", "row", "col")
            file.dimensions = dict(zip(dims, stack.shape, strict=True))
            file.create_variable(variable, dims, data=stack)
            file.dimensions["name"] = len(result)
            made = file.create_variable("frame_name", ("name",), dtype=h5py.string_dtype())
            made[...] = np.array(result, dtype=object)

    return damage


DAMAGES = {
    "no description": (remove("capture.toml"), "no capture.toml"),
    "no calibration": (
        remove("calibration.yaml"),
        r"calibration\.yaml: cannot be read: No such file",
    ),
    "no stack": (remove("stack.nc"), "missing"),
    "truncated stack": (truncate("stack.nc", 0.6), "no complete netCDF-4"),
    "stack of few bytes": (truncate("stack.nc", 1e-4), "no complete netCDF-4"),
    "empty stack": (truncate("stack.nc", 0.0), "no complete netCDF-4"),
    "truncated description": (truncate("capture.toml", 0.7), "capture.toml"),
    "truncated calibration": (truncate("calibration.yaml", 0.7), "calibration.yaml"),
    "missing frame": (
        restack(lambda s: s[:-1], lambda n: n[:-1]),
        "52 frames, the pattern set has 53; missing: black",
    ),
    "frames in another order": (restack(names=lambda n: n[::-1]), "order of the pattern set"),
    "frames exchanged": (restack(exchanged), r"frames 3 \(.*\) and 4 \(.*\) look exchanged"),
    "unknown frame": (restack(names=lambda n: ["dark", *n[1:]]), "not expected: dark"),
    "more images than names": (restack(lambda s: s[:-1]), "shape"),
    "wrong type": (restack(lambda s: s.astype(np.int64)), "int64"),
    "wrong size": (restack(lambda s: s[:, :-1]), r"\(53, 89, 120\)"),
    "wrong axes": (restack(order=("row", "frame", "col")), "'row', 'frame', 'col'"),
    "wrong variable": (restack(variable="images"), "variables stack and frame_name"),
    "values beyond the bit depth": (restack(lambda s: s * 2), "12 bits end at 4095"),
    "unknown key": (
        edit("capture.toml", "read_noise_e", "read_noise"),
        "unknown key read_noise in sensor; did you mean read_noise_e",
    ),
    "missing key": (edit("capture.toml", "width_px = 1280\n", ""), "missing in patterns: width_px"),
    "missing table": (edit("capture.toml", "[sensor]", "[camera]"), r"table \[sensor\]"),
    "wrong value": (edit("capture.toml", "steps = 18", "steps = 2"), "steps is 2"),
    "wrong kind of value": (edit("capture.toml", "bit_depth = 12", "bit_depth = '12'"), "'12'"),
    "file elsewhere": (edit("capture.toml", '"stack.nc"', '"../stack.nc"'), "in this folder"),
    "other format": (edit("capture.toml", "version = 1", "version = 2"), "fringe-capture"),
    "no TOML": (edit("capture.toml", "format =", "format"), "TOML"),
    "other patterns": (edit("capture.toml", "steps = 18", "steps = 17"), "51"),
    "other image size": (edit("capture.toml", "height_px = 90", "height_px = 91"), "91"),
    "other camera": (edit("calibration.yaml", "image_width: 120", "image_width: 121"), "121"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_explained_in_one_line(folder, name):
    damage, message = DAMAGES[name]
    damage(folder)
    with pytest.raises(CaptureError, match=message) as caught:
        read_capture(folder)
    assert "\n" not in str(caught.value)
    assert str(folder) in str(caught.value)


def test_missing_folder_is_explained(tmp_path):
    with pytest.raises(CaptureError, match="give the folder of a capture"):
        read_capture(tmp_path / "nothing")


def test_parts_must_fit(capture):
    with pytest.raises(CaptureError, match="float64"):
        Capture(np.zeros((53, 90, 120)), capture.patterns, capture.sensor, capture.calibration, 12)
    with pytest.raises(InputError, match="bit_depth"):
        Capture(capture.stack, capture.patterns, capture.sensor, capture.calibration, 17)


def test_noise_free_frames_come_back_as_floats(tmp_path, capture):
    stack = capture.stack.astype(np.float32) + np.float32(0.25)
    parts = (capture.patterns, capture.sensor, capture.calibration, 12)
    write_capture(tmp_path, Capture(stack, *parts))
    result = read_capture(tmp_path).stack
    assert result.dtype == np.float32
    np.testing.assert_array_equal(result, stack)
    stack[0, 0, 0] = np.nan
    with pytest.raises(CaptureError, match="holds the value nan"):
        Capture(stack, *parts)


def test_copied_capture_reads_alike(folder, tmp_path, capture):
    shutil.copytree(folder, tmp_path / "copy")
    np.testing.assert_array_equal(read_capture(tmp_path / "copy").stack, capture.stack)
