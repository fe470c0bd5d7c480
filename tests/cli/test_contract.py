"""Content of every result folder of a command: result.json with a digest, and its settings."""

import json
import shutil
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest

from benchmarks.fuzz_stock import make_colours
from twin.cli import run
from twin.config.digest import content_digest

SEQUENCE = """format = "fringe-patterns"
version = 1
[patterns]
width_px = 64
height_px = 32
period_px = 16
"""
CAPTURE = Path(__file__).parents[2] / "docs" / "example_capture"


def arguments_of(command: str, folder: Path) -> list[str]:
    """Return a command line with its inputs in a folder."""
    if command == "photometric":
        make_colours(folder / "colours")
        return ["reconstruct", "--photometric", str(folder / "colours" / "press.toml")]
    if command in ("patterns", "patterns of a file"):
        shown = folder / "sequence.toml"
        shown.write_text(SEQUENCE)
        few = ["-s", "patterns.steps=3"]
        named = "paper/two_balls" if command == "patterns" else str(shown)
        return ["patterns", named, *few]
    return [command, str(CAPTURE)]


@pytest.mark.parametrize(
    "command", ["reconstruct", "decode", "photometric", "patterns", "patterns of a file"]
)
def test_results_have_digest_versions_and_settings(tmp_path: Path, command: str) -> None:
    arguments = arguments_of(command, tmp_path)
    digests = []
    for out in (tmp_path / "out", tmp_path / "again"):
        assert run([*arguments, "-o", str(out)]) == 0
        result = json.loads((out / "result.json").read_text())
        assert result["command"] == arguments[0]
        assert result["metrics"]
        assert result["versions"]["fringe-twin"]
        assert len(result["digest"]) == 16
        assert (out / "experiment.toml").read_text().strip()
        digests.append(result["digest"])
    assert digests[0] == digests[1]


def test_one_pixel_is_another_digest(tmp_path: Path) -> None:
    capture = tmp_path / "capture"
    shutil.copytree(CAPTURE, capture)
    for number, out in enumerate((tmp_path / "before", tmp_path / "after")):
        if number:
            image = sorted(capture.glob("*.png"))[0]
            bits = imageio.imread(image)
            bits[0, 0] += 1
            imageio.imwrite(image, bits)
        assert run(["decode", str(capture), "-o", str(out)]) == 0
    before, after = (
        json.loads((tmp_path / name / "result.json").read_text())["digest"]
        for name in ("before", "after")
    )
    assert before != after


def test_arrays_are_named_by_type_shape_and_content() -> None:
    zeros = np.zeros((2, 3), np.uint8)
    bits = zeros.copy()
    bits[0, 0] = 1
    several = [
        zeros,
        bits,
        zeros.T,
        zeros.astype(np.uint16),
        (zeros, bits),
        "text",
        ("text", zeros),
    ]
    assert len({content_digest(part) for part in several}) == len(several)
    assert content_digest(zeros) == content_digest(zeros.copy())
