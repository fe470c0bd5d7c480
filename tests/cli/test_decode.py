"""twin patterns, a camera with the pixels of the projector, twin decode on foreign files.

Oracle: the coordinate of camera pixel (row, col) is (col, row).
"""

import shutil
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest

from reconstruction.capture.description import read_manifest
from reconstruction.netcdf import read_arrays
from reconstruction.reading import read_json
from twin.cli import run

EXAMPLE = Path(__file__).parents[2] / "docs" / "example_capture"
SEQUENCE = """
format = "fringe-patterns"
version = 1
[patterns]
width_px = 160
height_px = 96
low_level = 30
high_level = 220
"""
CAPTURE = """
format = "fringe-frames"
version = 1
bit_depth = {depth}
{top}
[projector]
width_px = 160
height_px = 96
[sensor]
gain_dn_per_e = 0.001
read_noise_e = {noise_e}
black_level_dn = 0.0
saturation_dn = {saturation}
"""
PHASE = 'kind = "phase"\naxis = "{axis}"\nperiod_px = {period}\n'
GRAY = 'kind = "gray"\naxis = "{axis}"\n'
# Keys of [patterns], and for each kind of frames the group that lists them.
COLUMNS = 'axes = ["column"]\nsteps = 3\nperiod_px = 16\nuniform = false\n'
SETS = {
    "3 steps + plain Gray, columns": (
        COLUMNS + 'code = "gray"\n',
        ["phase_column", "gray_column"],
        [PHASE.format(axis="column", period=16), GRAY.format(axis="column")],
    ),
    "inverse pairs, no fringes": (
        'steps = 0\nperiod_px = 1\ncode = "gray"\ninverse = true\nuniform = false\n',
        ["gray_column", "inverse_column", "gray_row", "inverse_row"],
        [
            f'kind = "{kind}"\naxis = "{axis}"\nperiod_px = 1\n'
            for axis in ("column", "row")
            for kind in ("gray", "inverse")
        ],
    ),
    "two frequencies, a period per axis": (
        'steps = 4\nperiod_px = 16\ncode = "hierarchical"\nfurther_periods_px = [160]\n'
        "row_periods_px = [12, 96]\nuniform = false\n",
        ["phase_column_0[0-3]", "phase_column_0[4-7]", "phase_row_0[0-3]", "phase_row_0[4-7]"],
        [
            PHASE.format(axis="column", period=16),
            PHASE.format(axis="column", period=160),
            PHASE.format(axis="row", period=12),
            PHASE.format(axis="row", period=96),
        ],
    ),
}


def project(tmp_path, keys):
    """Return the images that `twin patterns` writes, by name."""
    (tmp_path / "sequence.toml").write_text(SEQUENCE + keys)
    shown = tmp_path / "shown"
    assert run(["patterns", str(tmp_path / "sequence.toml"), "-o", str(shown)]) == 0
    assert read_manifest(shown).width_px == 160
    return sorted(shown.glob("*.png"))


def record(tmp_path, images, kinds, groups, write, *, extra="", top="", depth=8):
    """Write a capture of foreign names, DN times 2^(depth - 8)."""
    folder = tmp_path / "capture"
    folder.mkdir()
    largest, scale = 2**depth - 1, 2 ** (depth - 8)
    text = CAPTURE.format(depth=depth, top=top, saturation=float(largest), noise_e=500.0 * scale)
    number = 0
    for kind, group in zip(kinds, groups, strict=True):
        names = []
        for path in sorted(p for p in images if p.match(f"???_{kind}*")):
            names.append(write(folder / f"img{number}", imageio.imread(path), scale))
            number += 1
        assert names
        text += f"\n[[frames]]\nfiles = {names}\n{group}{extra}".replace("'", '"')
    assert number == len(images)
    (folder / "capture.toml").write_text(text)
    return folder


def write_png(path, image, scale):
    imageio.imwrite(path.with_suffix(".png"), image)
    return f"{path.name}.png"


def write_bmp(path, image, scale):
    imageio.imwrite(path.with_suffix(".bmp"), image)
    return f"{path.name}.bmp"


def write_tiff(path, image, scale):
    imageio.imwrite(path.with_suffix(".tiff"), image.astype(np.uint16) * scale, plugin="pillow")
    return f"{path.name}.tiff"


def write_pgm(path, image, scale):
    wide = (image.astype(np.uint16) * scale).astype(">u2")
    head = f"P5\n{image.shape[1]} {image.shape[0]}\n{256 * scale - 1}\n".encode()
    path.with_suffix(".pgm").write_bytes(head + wide.tobytes())
    return f"{path.name}.pgm"


def write_npy(path, image, scale):
    np.save(path.with_suffix(".npy"), image.astype(np.float32) * scale)
    return f"{path.name}.npy"


def write_colour(path, image, scale):
    """The green channel has the image, red and blue must not be read."""
    imageio.imwrite(path.with_suffix(".png"), np.stack([image // 2, image, 255 - image], axis=-1))
    return f"{path.name}.png"


def coordinates(out):
    result = read_arrays(out / "decoded.nc")
    return {name: np.asarray(result[name]) for name in result.variables}


@pytest.mark.parametrize(
    ("name", "write", "more"),
    [
        ("3 steps + plain Gray, columns", write_bmp, {}),
        ("3 steps + plain Gray, columns", write_colour, {"top": 'channel = "green"'}),
        ("3 steps + plain Gray, columns", write_tiff, {"depth": 12}),
        ("3 steps + plain Gray, columns", write_npy, {"depth": 10}),
        ("inverse pairs, no fringes", write_png, {}),
        ("inverse pairs, no fringes", write_pgm, {"depth": 16}),
        ("two frequencies, a period per axis", write_png, {}),
        ("two frequencies, a period per axis", write_pgm, {"depth": 14}),
    ],
)
def test_foreign_sets_are_decoded_without_renaming(tmp_path, capsys, name, write, more):
    keys, kinds, groups = SETS[name]
    images = project(tmp_path, keys)
    folder = record(tmp_path, images, kinds, groups, write, **more)
    out = tmp_path / "out"
    assert run(["decode", str(folder), "-o", str(out), "--filter-taps", "0"]) == 0
    maps = coordinates(out)
    valid = maps["mask_reason"] == 0
    assert valid.mean() > 0.85
    row, col = np.mgrid[0:96, 0:160].astype(float)
    for axis, truth in (("column", col), ("row", row)):
        if f"{axis}_px" in maps:
            assert np.max(np.abs(maps[f"{axis}_px"] - truth)[valid]) < 0.35
            assert maps[f"sigma_{axis}_px"][valid].min() > 0.0
    assert ("row_px" in maps) == ("columns" not in name)
    figures = read_json(out / "result.json")["metrics"]
    assert figures["pixels"] == valid.sum()
    assert (out / "decoded.png").stat().st_size > 1000
    assert "valid_share" in capsys.readouterr().out


def refused(tmp_path, capsys, folder):
    out = tmp_path / "out"
    assert run(["decode", str(folder), "-o", str(out)]) == 2
    error = capsys.readouterr().err.strip().splitlines()
    assert not out.exists()
    assert len(error[-1]) < 400
    return error[-1]


def plain(tmp_path, groups=None, order=None, steps=3):
    """Return a capture of `steps` steps and plain Gray along columns, with a given mistake."""
    keys, kinds, stated = SETS["3 steps + plain Gray, columns"]
    images = project(tmp_path, keys.replace("steps = 3", f"steps = {steps}"))
    folder = record(tmp_path, images, kinds, groups or stated, write_png)
    held = [(folder / f"img{k}.png").read_bytes() for k in range(len(images))]
    for place, taken in (order or {}).items():
        (folder / f"img{place}.png").write_bytes(held[taken])
    return folder


PHASE_16, GRAY_16 = SETS["3 steps + plain Gray, columns"][2]


def test_inverted_shift_is_noticed(tmp_path, capsys):
    folder = plain(tmp_path, [PHASE_16 + "sign = -1\n", GRAY_16])
    message = refused(tmp_path, capsys, folder)
    assert "the phase decreases with the Gray word; correct their order, or the sign" in message


def test_wrong_first_shift_is_noticed(tmp_path, capsys):
    folder = plain(tmp_path, [PHASE_16 + "shift_deg = 120\n", GRAY_16])
    assert "shifted by 1" in refused(tmp_path, capsys, folder)


def test_exchanged_images_are_named_by_their_files(tmp_path, capsys):
    folder = plain(tmp_path, order={2: 3, 3: 2}, steps=8)
    message = refused(tmp_path, capsys, folder)
    assert "frames 2 (phase_column_02: img2.png) and 3 (phase_column_03: img3.png)" in message


def test_exchanged_bits_are_named_by_their_files(tmp_path, capsys):
    message = refused(tmp_path, capsys, plain(tmp_path, order={3: 5, 5: 3}))
    assert "(gray_column_00: img3.png) and 5 (gray_column_02: img5.png) look exchanged" in message


def test_images_of_another_size_and_colour_are_refused(tmp_path, capsys):
    folder = plain(tmp_path)
    imageio.imwrite(folder / "img4.png", np.zeros((96, 161), np.uint8))
    assert "img4.png: is 161 x 96 px" in refused(tmp_path, capsys, folder)
    imageio.imwrite(
        folder / "img4.png", np.arange(96 * 160 * 3, dtype=np.uint8).reshape(96, 160, 3)
    )
    assert 'name the channel of colour images ("red"' in refused(tmp_path, capsys, folder)


def test_exchanged_axes_are_noticed(tmp_path, capsys):
    """Fringes of columns listed as rows, together with Gray frames of rows."""
    keys, kinds, _ = SETS["inverse pairs, no fringes"]
    keys = 'steps = 4\nperiod_px = 12\ncode = "complementary_gray"\nuniform = false\n'
    kinds = ["phase_column", "phase_row", "gray_column", "gray_row"]
    groups = [PHASE.format(axis=axis, period=12) for axis in ("row", "column")]
    groups += [GRAY.format(axis=axis) for axis in ("column", "row")]
    images = project(tmp_path, keys)
    folder = record(tmp_path, images, kinds, groups, write_png)
    assert "phase frames of columns and rows look exchanged" in refused(tmp_path, capsys, folder)


def test_settings_change_a_sequence_file(tmp_path, capsys):
    (tmp_path / "sequence.toml").write_text(SEQUENCE)
    arguments = ["patterns", str(tmp_path / "sequence.toml"), "-o", str(tmp_path / "shown"), "-s"]
    assert run([*arguments, "projector.width_px=9"]) == 2
    assert "allowed are keys of [patterns]" in capsys.readouterr().err
    assert run([*arguments, 'patterns.axes=["row"]', "-s", "patterns.steps=2"]) == 2
    assert "patterns steps is 2" in capsys.readouterr().err
    assert run([*arguments, 'patterns.axes=["row"]']) == 0
    assert read_manifest(tmp_path / "shown").axes == ("row",)


def test_no_coordinate_is_an_error_with_its_likely_reason(tmp_path, capsys):
    """All phase frames are clipped; then all light is below the noise."""
    folder = plain(tmp_path)
    text = (folder / "capture.toml").read_text()
    clipped = text.replace("saturation_dn = 255.0", "saturation_dn = 20.0")
    (folder / "capture.toml").write_text(clipped)
    message = refused(tmp_path, capsys, folder)
    assert "no pixel gives a point (saturated 100%); phase frames are clipped or lost" in message
    for path in folder.glob("*.png"):
        imageio.imwrite(path, imageio.imread(path) // 40)
    noisy = text.replace("read_noise_e = 500", "read_noise_e = 9000")
    (folder / "capture.toml").write_text(noisy)
    message = refused(tmp_path, capsys, folder)
    assert "(low modulation 100%); the fringe contrast is too small for its noise" in message


def test_reconstruct_without_a_point_is_an_error(tmp_path, capsys):
    """Every image is the one without light."""
    folder = tmp_path / "capture"
    shutil.copytree(EXAMPLE, folder)
    black = next(folder.glob("*_black.png")).read_bytes()
    for path in folder.glob("*.png"):
        path.write_bytes(black)
    out = tmp_path / "out"
    assert run(["reconstruct", str(folder), "-o", str(out)]) == 2
    assert "no pixel gives a point (dark 100%); white and black do not" in capsys.readouterr().err
    assert not out.exists()


def test_a_wrong_period_is_among_the_likely_reasons(tmp_path, capsys):
    """Fringes of 18 px that are decoded as 17 px: 32 frames either way, so only rays disagree."""
    folder = tmp_path / "capture"
    shutil.copytree(EXAMPLE, folder)
    sequence = folder / "patterns.toml"
    sequence.write_text(sequence.read_text().replace("period_px = 18.0", "period_px = 17.0"))
    assert run(["reconstruct", str(folder), "-o", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert "(epipolar mismatch 100%)" in message
    assert "check period_px of the fringes" in message


DISPLACED = (
    'axes = ["column"]\nsteps = 4\nperiod_px = 10\nuniform = false\n'
    'code = "displaced_gray"\nfirst_shifts_deg = [180]\n'
)
SHIFTED = [PHASE.format(axis="column", period=10) + "shift_deg = 180\n", GRAY_16]


@pytest.mark.parametrize("is_listed", [True, False])
def test_one_gray_word_displaced_by_half_a_period(tmp_path, capsys, is_listed):
    """Setup: 16 periods in 4 bits, so that the last half of a period has no word of its own.

    Expected: with shifted = true pixel by pixel, that half and the like of it are masked; without
    it a line that names this remedy.
    """
    images = project(tmp_path, DISPLACED)
    groups = [SHIFTED[0], SHIFTED[1] + "shifted = true\n" * is_listed]
    folder = record(tmp_path, images, ["phase_column", "gray_column"], groups, write_png)
    if not is_listed:
        message = refused(tmp_path, capsys, folder)
        assert "correct the first shift, or list the Gray frames with shifted = true" in message
        return
    out = tmp_path / "out"
    assert run(["decode", str(folder), "-o", str(out), "--filter-taps", "0"]) == 0
    maps = coordinates(out)
    valid = maps["mask_reason"] == 0
    assert np.max(np.abs(maps["column_px"] - np.arange(160.0))[valid]) < 0.05
    assert np.flatnonzero(~valid[40]).tolist() == [*range(145, 150), *range(155, 160)]
    phase = np.exp(1j * (maps["phase_column_rad"] - 2.0 * np.pi * maps["column_px"] / 10.0))
    assert np.max(np.abs(np.angle(phase[valid]))) < 0.02
    # int16 of the order follows from both.
    assert np.array_equal(maps["order_column"][valid], (np.indices((96, 160))[1] // 10)[valid])
