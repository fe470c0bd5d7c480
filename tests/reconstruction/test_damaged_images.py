"""Image files that are damaged or not from a sensor: one line of error each."""

import random
import struct
import zlib

import numpy as np
import pytest

from benchmarks.damage import damaged_bytes
from reconstruction.capture.image_files import read_image
from reconstruction.errors import CaptureError, InputError
from reconstruction.photometric.press_files import read_rgb
from reconstruction.reading import read_arrays, read_pixels
from reconstruction.writing import write_exr_channels

ROWS = b"".join(b"\0" + bytes(4) for _ in range(4))


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(colour: int, width: int = 4, height: int = 4, data: bytes = zlib.compress(ROWS)) -> bytes:
    head = struct.pack(">IIBBBBB", width, height, 8, colour, 0, 0, 0)
    parts = chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + parts


GREY, PALETTE = 0, 3


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (png(PALETTE), "a part is missing, such as its palette"),
        (png(GREY, 60_000, 60_000, b"x"), "3600000000 pixels.* exceeds limit"),
        (png(GREY, 0, 0), "can not read"),
        (png(GREY)[:-30], "can not read"),
        (png(GREY).replace(b"IDAT", b"IDAX"), "can not read"),
        (b"", "can not read"),
    ],
    ids=["palette", "bomb", "empty", "no data", "no checksum", "nothing"],
)
def test_a_damaged_png_is_rejected_in_one_line(tmp_path, content, message):
    path = tmp_path / "x.png"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        read_pixels(path)
    assert str(caught.value).startswith(f"{path}: is no complete image (")
    assert "\n" not in str(caught.value)
    with pytest.raises(CaptureError, match=message):
        read_image(path)
    with pytest.raises(CaptureError, match=r"x\.png"):
        read_rgb(path)


def test_a_sound_png_is_read(tmp_path):
    (tmp_path / "x.png").write_bytes(png(GREY))
    np.testing.assert_array_equal(read_image(tmp_path / "x.png"), np.zeros((4, 4), np.uint8))


def test_a_cut_exr_is_rejected_in_one_line(tmp_path):
    path = tmp_path / "x.exr"
    write_exr_channels(path, {"Y": np.random.default_rng(1).random((24, 16), np.float32)})
    whole = path.read_bytes()
    for size in (0, 4, 100, 400, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:size])
        with pytest.raises(CaptureError, match="is no complete image") as caught:
            read_image(path)
        assert "\n" not in str(caught.value)


def _refusals(path, read):
    """Yield the errors of a file that is damaged in 150 ways."""
    whole = path.read_bytes()
    for seed in range(150):
        path.write_bytes(damaged_bytes(whole, random.Random(seed))[0])
        try:
            read(path)
        except InputError as error:
            yield str(error)


def test_a_damaged_exr_is_read_or_rejected(tmp_path):
    path = tmp_path / "x.exr"
    write_exr_channels(path, {"Y": np.random.default_rng(1).random((24, 16), np.float32)})
    messages = list(_refusals(path, read_image))
    assert len(messages) > 50
    assert not any("\n" in line for line in messages)


def test_a_damaged_archive_is_rejected_in_one_line(tmp_path):
    path = tmp_path / "x.npz"
    numbers = np.random.default_rng(1).random(100)
    np.savez_compressed(path, a=numbers, b=np.arange(4))
    np.testing.assert_array_equal(read_arrays(path)["a"], numbers)
    messages = list(_refusals(path, read_arrays))
    assert len(messages) > 50
    assert all(line.startswith(f"{path}: is no complete npz file (") for line in messages)
    assert not any("\n" in line for line in messages)


def test_an_archive_of_objects_is_not_unpacked(tmp_path):
    path = tmp_path / "x.npz"
    np.savez(path, a=np.array([{"a": 1}], object))
    with pytest.raises(InputError, match=r"no complete npz file .*[Oo]bject arrays"):
        read_arrays(path)
