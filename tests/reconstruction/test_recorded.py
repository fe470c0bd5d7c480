"""Every kind of capture.toml gives the same recorded frames: stack, manifest, list of frames."""

import numpy as np
import pytest

from reconstruction.capture.description import file_names
from reconstruction.capture.folder import Capture, find_recorded, read_capture, write_capture
from reconstruction.capture.frame_set import write_frame_set
from reconstruction.errors import InputError
from reconstruction.patterns import AXES, PatternSet
from reconstruction.rig.calibration import write_calibration
from reconstruction.rig.sensor import SensorNoise
from tests.reconstruction.conftest import LIST_HEAD

PATTERNS = PatternSet(160, 96, period_px=16.0, steps=4)
SENSOR = SensorNoise(0.1, 5.0, 4.0, 255.0)


@pytest.fixture
def stack(calibration):
    """Return unlit frames, (frame, row, col), all different: their order is not checked."""
    frames, camera = len(PATTERNS.frames), calibration.camera
    shape = frames, camera.height_px, camera.width_px
    return np.random.default_rng(0).integers(10, 13, shape).astype(np.uint8)


def as_stack(folder, stack, calibration):
    write_capture(folder, Capture(stack, PATTERNS, SENSOR, calibration, 8))


def as_manifest(folder, stack, calibration):
    write_frame_set(folder, stack, PATTERNS, SENSOR, 8)
    write_calibration(folder / "calibration.yaml", calibration)


def as_list(folder, stack, calibration):
    as_manifest(folder, stack, calibration)
    text = LIST_HEAD.format(top="")
    for kind in ("phase", "gray"):
        for axis in AXES:
            text += f'\n[[frames]]\nfiles = "*_{kind}_{axis}_*.png"\nkind = "{kind}"\n'
            text += f'axis = "{axis}"\n' + "period_px = 16.0\n" * (kind == "phase")
    for kind in ("white", "black"):
        text += f'\n[[frames]]\nfiles = "*_{kind}.png"\nkind = "{kind}"\n'
    (folder / "capture.toml").write_text(text)


@pytest.mark.parametrize("write", [as_stack, as_manifest, as_list])
def test_each_kind_of_description_gives_the_same_frames(tmp_path, stack, calibration, write):
    write(tmp_path, stack, calibration)
    recorded = find_recorded(tmp_path)
    names = [] if write is as_stack else [[tmp_path / name for name in file_names(PATTERNS)]]
    assert [list(files) for files in recorded.files] == names
    assert recorded.stack_file == (tmp_path / "stack.nc" if write is as_stack else None)
    assert (recorded.patterns, recorded.sensor, recorded.bit_depth) == (PATTERNS, SENSOR, 8)
    assert recorded.calibration_file == tmp_path / "calibration.yaml"
    capture = read_capture(tmp_path)
    np.testing.assert_array_equal(capture.stack, stack, strict=True)
    assert (capture.patterns, capture.scale) == (PATTERNS, None)


@pytest.mark.parametrize("key", ["dark_file", "calibration_file"])
def test_common_keys_are_checked_for_both_kinds_of_images(tmp_path, stack, calibration, key):
    for write in (as_manifest, as_list):
        folder = tmp_path / write.__name__
        folder.mkdir()
        write(folder, stack, calibration)
        path = folder / "capture.toml"
        text = path.read_text().replace('calibration_file = "calibration.yaml"\n', "")
        path.write_text(text.replace("version = 1\n", f"version = 1\n{key} = 1\n"))
        with pytest.raises(InputError, match=f"{key} is 1; give the name of a file"):
            find_recorded(folder)
