"""twin describe and twin decode on real captures that others recorded, reduced in size.

The captures are public ones of kamino410/procam-calibration, jakobwilm/slstudio and SLMaster; they
are not part of this repository, so that these tests run only where a folder holds them.
"""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from reconstruction.capture.folder import read_uncalibrated
from reconstruction.decoding.decode import DecodeOptions, decode
from reconstruction.netcdf import read_arrays
from twin.cli import run

CASES = Path(__file__).parents[3] / "shared" / "cases"
pytestmark = pytest.mark.skipif(not CASES.is_dir(), reason="no folder of real captures")


def described(tmp_path, name, *size):
    """Return the groups of frames, and everything that is printed or written about a doubt."""
    out = tmp_path / "capture.toml"
    assert run(["describe", str(CASES / name), "--projector", *map(str, size), "-o", str(out)]) == 0
    text = out.read_text()
    return tomllib.loads(text)["frames"], [li for li in text.splitlines() if "# unsure" in li]


def numbered(pattern, numbers):
    return [pattern.format(number) for number in numbers]


def test_rows_of_a_chessboard_are_in_the_order_of_their_names(tmp_path):
    """Coarse bits with one or two edges in view; the finest are hardly resolved."""
    frames, doubts = described(tmp_path, "01_kamino_capture_0", 1024, 768)
    name = "graycode_{:02d}.png"
    expected = [
        ("gray", "column", range(0, 20, 2)),
        ("inverse", "column", range(1, 20, 2)),
        ("gray", "row", range(20, 40, 2)),
        ("inverse", "row", range(21, 40, 2)),
        ("white", None, [40]),
        ("black", None, [41]),
    ]
    result = [(item["kind"], item.get("axis"), item["files"]) for item in frames]
    assert result == [(kind, axis, numbered(name, some)) for kind, axis, some in expected]
    assert any(
        "graycode_38.png" not in li and "graycode_20.png: bit or inverse" in li for li in doubts
    )


def test_bits_of_a_skull_with_one_that_is_lit_everywhere(tmp_path, capsys):
    """The second coarsest bit has no stripes, the finest is not resolved."""
    frames, doubts = described(tmp_path, "02_slstudio_skull_gray", 1824, 1140)
    assert [item["kind"] for item in frames] == ["gray", "white", "black"]
    assert frames[0]["files"] == numbered("frameSeq_{:02d}.png", range(2, 12))
    assert frames[0]["period_px"] == 2.0
    assert any("frameSeq_11.png: stripes hardly resolved" in line for line in doubts)
    assert "unsure: frameSeq_11.png: stripes hardly resolved" in capsys.readouterr().out


def test_a_fringe_over_the_whole_projector_is_no_gray_code(tmp_path):
    """The view shows a quarter of it, as a dark and two bright images."""
    frames, _ = described(tmp_path, "03_slstudio_skull_2x3", 1824, 1140)
    assert [(item["kind"], item["axis"], item["period_px"]) for item in frames] == [
        ("phase", "column", 114.0),
        ("phase", "column", 1824.0),
    ]
    assert frames[0]["shift_deg"] == frames[1]["shift_deg"] == [0.0, 240.0, 120.0]


def test_fringes_of_little_contrast_next_to_bright_bits(tmp_path):
    frames, _ = described(tmp_path, "04_slmaster_monocular", 1920, 1080)
    assert [item["files"] for item in frames] == [
        numbered("{}.png", range(12)), numbered("{}.png", range(12, 18))
    ]  # fmt: skip
    assert [item["kind"] for item in frames] == ["phase", "gray"]
    assert frames[0]["period_px"] == 60.0
    assert frames[0]["shift_deg"] == [(180.0 + 30.0 * step) % 360.0 for step in range(12)]


def with_frames(tmp_path, name, text):
    folder = tmp_path / "capture"
    folder.mkdir()
    for path in (CASES / name).glob("*.png"):
        (folder / path.name).symlink_to(path)
    (folder / "capture.toml").write_text(text)
    return folder


def test_wrong_fringe_orders_are_warned_about(tmp_path, capsys):
    """Two bits of the rows exchanged: half of them are off by 48 px and more."""
    described(tmp_path, "01_kamino_capture_0", 1024, 768)
    text = (tmp_path / "capture.toml").read_text()
    folder = with_frames(tmp_path, "01_kamino_capture_0", text)
    assert run(["decode", str(folder), "-o", str(tmp_path / "right")]) == 0
    assert "warning" not in capsys.readouterr().err
    for item, second in (("24", "26"), ("25", "27")):
        text = text.replace(f"_{item}.png", "_X").replace(f"_{second}.png", f"_{item}.png")
        text = text.replace("_X", f"_{second}.png")
    (folder / "capture.toml").write_text(text)
    assert run(["decode", str(folder), "-o", str(tmp_path / "wrong")]) == 0
    assert "warning: the row coordinate jumps at 82% of" in capsys.readouterr().err


def test_words_that_are_displaced_by_half_a_period(tmp_path, capsys):
    """At full size pixel (460, 653) is column 990.74; here a pixel is four of those wide."""
    text = (CASES / "05_slmaster_shiftgray" / "capture.toml").read_text()
    folder = with_frames(tmp_path, "05_slmaster_shiftgray", text)
    out = tmp_path / "out"
    assert run(["decode", str(folder), "-o", str(out)]) == 2
    assert "or list the Gray frames with shifted = true" in capsys.readouterr().err
    shifted = text.replace('kind="gray"', 'kind="gray"\nshifted = true')
    (folder / "capture.toml").write_text(shifted)
    assert run(["decode", str(folder), "-o", str(out)]) == 0
    column_px = np.asarray(read_arrays(out / "decoded.nc")["column_px"])
    # The centre of that pixel is at (114.6, 162.9) of these.
    row, col = (460 + 0.5) / 4 - 0.5, (653 + 0.5) / 4 - 0.5
    result = ndimage.map_coordinates(column_px, [[row], [col]], order=1)[0]
    assert result == pytest.approx(990.74, abs=1.0)


def test_flicker_of_a_real_projector_is_divided_out(tmp_path):
    """12 steps, flicker of 6 %. Expected: the residuals of the fits fall by more than 30 %."""
    described(tmp_path, "04_slmaster_monocular", 1920, 1080)
    text = (tmp_path / "capture.toml").read_text()
    capture = read_uncalibrated(with_frames(tmp_path, "04_slmaster_monocular", text))
    neglected, divided = (
        decode(capture.stack, capture.patterns, capture.sensor, DecodeOptions(frame_gains=on))
        for on in (False, True)
    )
    assert 0.04 < np.ptp(divided.gains.relative[0, 0]) < 0.1
    residuals_dn = [np.median(d.column.residual_dn[d.valid]) for d in (neglected, divided)]
    assert residuals_dn[1] < 0.7 * residuals_dn[0]
