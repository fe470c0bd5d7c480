"""twin describe and twin decode on real captures that others recorded, reduced in size.

The captures are public ones of kamino410/procam-calibration, jakobwilm/slstudio and SLMaster; they
are not part of this repository, so that these tests run only where a folder holds them.
"""

import tomllib
from pathlib import Path

import pytest

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
    found = [(one["kind"], one.get("axis"), one["files"]) for one in frames]
    assert found == [(kind, axis, numbered(name, some)) for kind, axis, some in expected]
    assert any(
        "graycode_38.png" not in li and "graycode_20.png: bit or inverse" in li for li in doubts
    )


def test_bits_of_a_skull_with_one_that_is_lit_everywhere(tmp_path, capsys):
    """The second coarsest bit has no stripes, the finest is not resolved."""
    frames, doubts = described(tmp_path, "02_slstudio_skull_gray", 1824, 1140)
    assert [one["kind"] for one in frames] == ["gray", "white", "black"]
    assert frames[0]["files"] == numbered("frameSeq_{:02d}.png", range(2, 12))
    assert frames[0]["period_px"] == 2.0
    assert any("frameSeq_11.png: stripes hardly resolved" in line for line in doubts)
    assert "unsure: frameSeq_11.png: stripes hardly resolved" in capsys.readouterr().out


def test_a_fringe_over_the_whole_projector_is_no_gray_code(tmp_path):
    """The view shows a quarter of it, as a dark and two bright images."""
    frames, _ = described(tmp_path, "03_slstudio_skull_2x3", 1824, 1140)
    assert [(one["kind"], one["axis"], one["period_px"]) for one in frames] == [
        ("phase", "column", 114.0),
        ("phase", "column", 1824.0),
    ]
    assert frames[0]["shift_deg"] == frames[1]["shift_deg"] == [0.0, 240.0, 120.0]


def test_fringes_of_little_contrast_beside_bright_bits(tmp_path):
    frames, _ = described(tmp_path, "04_slmaster_monocular", 1920, 1080)
    assert [one["files"] for one in frames] == [
        numbered("{}.png", range(12)), numbered("{}.png", range(12, 18))
    ]  # fmt: skip
    assert [one["kind"] for one in frames] == ["phase", "gray"]
    assert frames[0]["period_px"] == 60.0
    assert frames[0]["shift_deg"] == [(180.0 + 30.0 * step) % 360.0 for step in range(12)]
