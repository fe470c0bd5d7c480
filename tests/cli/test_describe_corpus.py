"""`twin describe` on generated folders: other codes, names, formats, parts of the image."""

import numpy as np
import pytest

from benchmarks.reality_captures import verdict_of
from tests.corpus.captures import RELATIVE, write_captured_set
from twin.cli import run

# 2: words that only decode as binary, 5: rows, 15: JPEG of a small object, 180: small object, more
# noise than assumed.
SEEDS = 2, 3, 5, 6, 15, 180


@pytest.mark.parametrize("seed", SEEDS)
def test_described_sets_decode_to_their_coordinates(tmp_path, seed):
    captured = write_captured_set(tmp_path / "set", seed)
    assert verdict_of(captured) == "right", captured.text


@pytest.mark.parametrize("seed", [3, 4, 11])
def test_several_fringes_of_one_period_are_spatial(tmp_path, capsys, seed):
    """3: columns; 4: both axes, names without order; 11: both axes of a small object.

    Expected: relative coordinates as true; the description states code and number of fringes,
    and the printed lines the reference that it needs.
    """
    captured = write_captured_set(tmp_path / "set", seed, RELATIVE)
    assert verdict_of(captured) == "right", captured.text
    out = tmp_path / "again.toml"
    command = ["describe", str(captured.folder), "--projector", "320", "240", "-o", str(out)]
    assert run(command) == 0
    text, printed = out.read_text(), capsys.readouterr().out
    assert 'code = "spatial"  # unsure' in text
    lengths = {"column": 320, "row": 240}
    for axis in captured.patterns.axes:
        covered_px = np.ptp(captured.coordinates_px[axis][captured.lit])
        fringes = int(np.ceil(covered_px / 40.0 - 0.1))
        assert f"period_px = {lengths[axis] / fringes:.6g}  # unsure: as if {fringes} " in text
    assert "a reference is needed (--reference-pixels or --reference-z-mm)" in printed
    assert "tested: " in printed


@pytest.mark.parametrize("seed", [4, 10])
def test_small_objects_under_names_without_order_are_unsure(tmp_path, seed):
    captured = write_captured_set(tmp_path / "set", seed)
    assert verdict_of(captured) == "unsure", captured.text


@pytest.mark.parametrize(
    ("seed", "mark"),
    [(56, "turns back in"), (70, "frame_005.png and frame_007.png"), (112, "11.bmp and 13.bmp")],
)
def test_a_missing_image_is_marked(tmp_path, capsys, seed, mark):
    """56: the coarsest bit under irregular time stamps; 70 and 112: a gap in the numbers."""
    captured = write_captured_set(tmp_path / "set", seed)
    assert captured.fault == "a frame is missing"
    assert run(["describe", str(captured.folder), "--projector", "320", "240"]) == 0
    unsure = [li for li in capsys.readouterr().out.splitlines() if li.startswith("unsure")]
    assert any(mark in line for line in unsure)


def test_an_encoding_that_only_decodes_is_written_with_a_mark(tmp_path, capsys):
    captured = write_captured_set(tmp_path / "set", 2)
    assert captured.patterns.word == "binary"
    assert run(["describe", str(captured.folder), "--projector", "320", "240"]) == 0
    text = (captured.folder / "capture.toml").read_text()
    assert 'word = "binary"\n' in text
    assert '# unsure: word = "binary" follows from the test; with "reflected" ' in text
    assert "tested: " in capsys.readouterr().out
