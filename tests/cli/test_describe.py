"""twin describe: foreign folders are described so that twin decode reads them.

Oracle: a camera with the pixels of the projector, times a coat that varies by a factor of
four, plus ambient light and noise: coordinates are the pixels.
"""

import re
import shutil
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest

from reconstruction.capture.folder import read_capture
from reconstruction.capture.frame_list import read_listed
from reconstruction.decoding.decode import decode
from reconstruction.netcdf import read_arrays
from reconstruction.patterns import PatternSet
from twin.cli import run

EXAMPLE = Path(__file__).parents[2] / "docs" / "example_capture"
SIZE = {"width_px": 320, "height_px": 240}
COLUMN = {"axes": ("column",)}
BARE = {"uniform": False}
SETS = {
    "3 steps + Gray": PatternSet(**SIZE, period_px=32, steps=3, code="gray", **COLUMN, **BARE),
    "4 steps + half-period Gray": PatternSet(**SIZE, period_px=32, steps=4),
    "Gray and inverse": PatternSet(
        **SIZE, steps=0, period_px=4, code="gray", inverse=True, **COLUMN, **BARE
    ),
    "Gray, rows": PatternSet(**SIZE, steps=0, period_px=4, code="gray", axes=("row",)),
    "binary": PatternSet(**SIZE, steps=0, period_px=4, code="gray", word="binary", **COLUMN),
    "three frequencies": PatternSet(
        **SIZE, steps=5, period_px=20, code="hierarchical", further_periods_px=(80, 320),
        row_periods_px=(15, 60, 240), **BARE,
    ),
}  # fmt: skip


def camera_images(patterns, seed=0):
    """Return frames of a coat with an unlit margin, 12 to 200 DN, noise of 1 DN."""
    rng = np.random.default_rng(seed)
    row, col = np.mgrid[0 : patterns.height_px, 0 : patterns.width_px] / 320.0
    coat = 0.25 + 0.75 * np.cos(2.0 * (col - 0.4)) ** 2 * np.cos(row) ** 2
    coat[:, :6] = 0.0
    for frame in patterns.frames:
        light = 12.0 + 190.0 * coat * patterns.image(frame) / 255.0
        yield np.clip(np.rint(light + rng.normal(0.0, 1.0, light.shape)), 0, 255).astype(np.uint8)


def write_set(folder, patterns, order=None):
    """Write images img_1.bmp ... with names without information."""
    folder.mkdir()
    images = list(camera_images(patterns))
    for number, k in enumerate(order or range(len(images))):
        imageio.imwrite(folder / f"img_{number + 1}.bmp", images[k])
    return folder


def described(folder, patterns):
    return run(
        ["describe", str(folder), "--projector", str(patterns.width_px), str(patterns.height_px)]
    )


@pytest.mark.parametrize("name", SETS)
def test_described_sets_are_decoded(tmp_path, capsys, name):
    patterns = SETS[name]
    folder = write_set(tmp_path / "set", patterns)
    assert described(folder, patterns) == 0
    result = read_listed(folder / "capture.toml").recorded(folder).patterns
    assert (result.axes, result.steps, result.word) == (
        patterns.axes,
        patterns.steps,
        patterns.word,
    )
    assert (result.inverse, result.uniform) == (patterns.inverse, patterns.uniform)
    assert result.code == patterns.code
    for axis in patterns.axes:
        # Of several frequencies the ratio is measured: the coarsest is taken as the whole image.
        assert result.periods_along(axis) == pytest.approx(patterns.periods_along(axis), rel=0.01)
    text = (folder / "capture.toml").read_text()
    assert "# unsure" in text
    (tested,) = re.findall(r"^tested: (\d+)% of the lit pixels", capsys.readouterr().out, re.M)
    assert int(tested) > 90
    if name == "three frequencies":
        return  # periods to 1 % give no coordinates: they are to be corrected
    assert run(["decode", str(folder), "-o", str(tmp_path / "out"), "--filter-taps", "0"]) == 0
    maps = read_arrays(tmp_path / "out" / "decoded.nc")
    valid = np.asarray(maps["mask_reason"]) == 0
    assert valid[:, 10:].mean() > 0.8
    truth = dict(zip(("row", "column"), np.mgrid[0:240, 0:320], strict=True))
    for axis in patterns.axes:
        error = np.abs(np.asarray(maps[f"{axis}_px"]) - truth[axis])[valid]
        assert np.median(error) < 1.1
        assert np.mean(error > 3.0) < 0.01


@pytest.mark.parametrize("code", ["gray", "complementary_gray"])
@pytest.mark.parametrize("is_mirrored", [False, True])
def test_bits_determine_the_first_shift_and_the_sign(tmp_path, code, is_mirrored):
    """Setup: steps from -120 degrees on, seen by a camera that may look through a mirror.

    Expected: the pixels come back, through a mirror from the other side.
    """
    patterns = PatternSet(**SIZE, period_px=32, steps=3, code=code, first_shifts_deg=(-120.0,),
                          **COLUMN, **BARE)  # fmt: skip
    folder = write_set(tmp_path / "set", patterns)
    for path in folder.glob("*.bmp") if is_mirrored else ():
        imageio.imwrite(path, imageio.imread(path)[:, ::-1])
    assert described(folder, patterns) == 0
    result = read_listed(folder / "capture.toml").recorded(folder)
    assert result.patterns.period_px == 32.0
    assert f"sign = {-1 if is_mirrored else 1}\n" in (folder / "capture.toml").read_text()
    assert run(["decode", str(folder), "-o", str(tmp_path / "out"), "--filter-taps", "0"]) == 0
    maps = read_arrays(tmp_path / "out" / "decoded.nc")
    valid = np.asarray(maps["mask_reason"]) == 0
    assert valid.mean() > 0.7
    truth = np.arange(320)[::-1] if is_mirrored else np.arange(320)
    error = np.abs(np.asarray(maps["column_px"]) - truth)[valid]
    assert np.mean(error > 1.5) < 0.002


def test_steps_in_another_order_are_detected_by_their_phase(tmp_path):
    """Recorded backwards from the third: shifts are listed with the files, correct by the bits."""
    patterns = PatternSet(**SIZE, period_px=32, steps=4, code="gray", **COLUMN, **BARE)
    order = [2, 1, 0, 3, *range(4, len(patterns.frames))]
    folder = write_set(tmp_path / "set", patterns, order)
    assert described(folder, patterns) == 0
    assert "shift_deg = [180.0, 90.0, 0.0, 270.0]" in (folder / "capture.toml").read_text()


def test_an_encoding_that_is_not_recognised_is_written_by_the_test(tmp_path, capsys):
    """XOR code words look like reflected ones; decoding the images shows the encoding.

    Expected: the encoding is written with a mark; with the width of a word, which images do not
    show, the coordinates are the pixels.
    """
    patterns = PatternSet(**SIZE, steps=0, period_px=4, code="gray", word="xor_02", **COLUMN)
    folder = write_set(tmp_path / "set", patterns)
    assert described(folder, patterns) == 0
    printed = capsys.readouterr().out
    assert re.search(r"^tested: (?:9\d|100)% of the lit", printed, re.M)
    assert 'unsure: word = "xor_02" follows from the test; with "reflected"' in printed
    text = (folder / "capture.toml").read_text()
    assert '\nword = "xor_02"\n' in text
    (folder / "capture.toml").write_text(text.replace("= 2.5 ", "= 4.0 "))
    assert run(["decode", str(folder), "-o", str(tmp_path / "out"), "--filter-taps", "0"]) == 0
    maps = read_arrays(tmp_path / "out" / "decoded.nc")
    valid = np.asarray(maps["mask_reason"]) == 0
    error = np.abs(np.asarray(maps["column_px"]) - np.arange(320))[valid]
    assert np.mean(error > 2.0) < 0.01


@pytest.mark.parametrize("steps", [4, 6])
@pytest.mark.parametrize(("gain", "word"), [(2.0, "tested"), (8.0, "unsure")])
def test_the_assumed_noise_is_compared_with_the_images(tmp_path, capsys, gain, word, steps):
    """Setup: noise of `gain` DN; assumed at 70 DN: sqrt(1 + 70 * 255 / 10,000 + 1/12) = 1.7 DN."""
    patterns = PatternSet(**SIZE, period_px=20, steps=steps, code="gray", **COLUMN)
    folder = tmp_path / "set"
    folder.mkdir()
    rng = np.random.default_rng(3)
    for number, image in enumerate(camera_images(patterns)):
        noisy = image + rng.normal(0.0, np.sqrt(gain**2 - 1.0), image.shape)
        noisy = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        imageio.imwrite(folder / f"img_{number + 1:02d}.bmp", noisy)
    assert described(folder, patterns) == 0
    lines = re.findall(
        r"^(\w+): \[sensor\]: the phase frames scatter by ([\d.]+)", capsys.readouterr().out, re.M
    )
    ((state, ratio),) = lines
    assert state == word
    assert float(ratio) == pytest.approx(gain / 1.7, rel=0.1)


def test_contradicting_names_and_other_sizes_are_reported(tmp_path, capsys):
    folder = write_set(tmp_path / "set", SETS["4 steps + half-period Gray"])
    (folder / "img_1.bmp").rename(folder / "row_1.bmp")
    imageio.imwrite(folder / "scene.png", np.zeros((20, 30), np.uint8))
    assert described(folder, SETS["4 steps + half-period Gray"]) == 0
    out = capsys.readouterr().out
    assert "row_1.bmp: looks like column, its name says row" in out
    assert "scene.png: has another size, left out" in out
    assert "white: 1 image" in out
    # An existing description is somebody's work.
    assert described(folder, SETS["4 steps + half-period Gray"]) == 2
    assert "exists already" in capsys.readouterr().err


@pytest.mark.parametrize("is_renamed", [False, True])
def test_a_camera_that_sees_a_part_of_the_projector(tmp_path, is_renamed):
    """Setup: the documents' example, with coarse bits that do not change within the view.

    Expected: all frames are identified, by names or by their order; with the correct period, which
    images do not contain, the coordinates are those of its own description.
    """
    folder = tmp_path / "set"
    folder.mkdir()
    for number, path in enumerate(sorted(EXAMPLE.glob("*.png"))):
        shutil.copy(path, folder / (f"{number + 1}.png" if is_renamed else path.name))
    own = read_capture(EXAMPLE)
    assert described(folder, own.patterns) == 0
    text = (folder / "capture.toml").read_text()
    assert text.count("period_px = 16 ") == 2
    (folder / "capture.toml").write_text(text.replace("period_px = 16 ", "period_px = 18 "))
    assert read_listed(folder / "capture.toml").recorded(folder).patterns == own.patterns
    assert run(["decode", str(folder), "-o", str(tmp_path / "out")]) == 0
    column_px = np.asarray(read_arrays(tmp_path / "out" / "decoded.nc")["column_px"])
    expected = decode(own.stack, own.patterns, own.sensor).column.coordinate_px
    assert np.max(np.abs(column_px - expected)) < 0.05  # the filter weighs another noise


def test_folders_that_hold_no_patterns_are_one_line(tmp_path, capsys):
    for images, message in (
        ([], "holds 0 images"),
        ([np.full((40, 50), 9, np.uint8)] * 3, "all images are the same"),
        ([np.full((40, 50), k, np.uint8) for k in (9, 90, 200)], "no image shows stripes"),
    ):
        for k, image in enumerate(images):
            imageio.imwrite(tmp_path / f"{k}.png", image)
        assert run(["describe", str(tmp_path)]) == 2
        error = capsys.readouterr().err.strip().splitlines()
        error = [line for line in error if not line.startswith("describe")]  # its progress
        assert len(error) == 1
        assert message in error[0]
        assert not (tmp_path / "capture.toml").exists()
