import imageio.v3 as imageio
import numpy as np

from reconstruction.capture.description import read_manifest
from twin.cli import run


def test_patterns_for_a_real_projector(tmp_path, capsys):
    """Expected: the manifest is the requested sequence, and each image agrees with it."""
    out = tmp_path / "patterns"
    settings = ["patterns.steps=4", 'patterns.code="shifted_gray"', "projector.width_px=640"]
    arguments = [word for setting in settings for word in ("-s", setting)]
    assert run(["patterns", "-o", str(out), *arguments]) == 0
    patterns = read_manifest(out)
    assert (patterns.steps, patterns.code, patterns.width_px) == (4, "shifted_gray", 640)
    assert f"wrote {len(patterns.frames)} images" in capsys.readouterr().out
    image = imageio.imread(out / "003_phase_column_03.png")
    np.testing.assert_array_equal(image, patterns.image(patterns.frames[3]))


def test_impossible_sequence_gives_one_line_and_no_files(tmp_path, capsys):
    out = tmp_path / "patterns"
    assert run(["patterns", "-o", str(out), "-s", 'patterns.code="heterodyne"']) == 2
    error = capsys.readouterr().err.strip().splitlines()
    assert len(error) == 1
    assert "further_periods_px" in error[0]
    assert not out.exists()
