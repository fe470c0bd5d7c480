"""The examples of docs/evaluation.md, run unchanged on the result that they name."""

import contextlib
import io
import re
import runpy
from pathlib import Path

import numpy as np
import pytest

from twin.cli import run
from twin.pipeline.dimensions import Region, dimensions

DOCUMENT = Path(__file__).parents[2] / "docs" / "evaluation.md"
NUMBER = r"-?\d+\.?\d*(?:e[+-]?\d+)?"


@pytest.fixture(scope="module")
def text():
    return DOCUMENT.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def executed(mi, text, tmp_path_factory):
    """Return the variables of the document's code blocks, their output, and the result."""
    folder = tmp_path_factory.mktemp("document")
    script = folder / "blocks.py"
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    script.write_text("\n".join(blocks), encoding="utf-8")
    command = re.search(r"^    twin (measure .*)$", text, re.MULTILINE)
    assert command
    printed = io.StringIO()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert run(command.group(1).split()) == 0
        with contextlib.redirect_stdout(printed):
            variables = runpy.run_path(str(script))
    return variables, printed.getvalue(), folder / "gauges"


def test_gauges_have_their_size(executed):
    """Expected: the sizes in scenes/examples/gauges.toml.

    Radii to 5 um: noise of 1.5 um on a thousand points and more, facets 0.3 um below the round
    shape, and camera pixels of 0.06 mm, which lower a crest of radius R by 0.06^2 / (24 R). The
    bar's edges are within a cell (0.09 mm) of the position where 50 % of the band's rows exceed the
    rim.
    """
    variables = executed[0]
    assert variables["ball"].radius_mm == pytest.approx(2.0, abs=5e-3)
    assert variables["rod"].radius_mm == pytest.approx(1.0, abs=5e-3)
    np.testing.assert_allclose(variables["rod"].axis, [0.0, 1.0, 0.0], atol=1e-3)
    assert variables["bar"].width_mm == pytest.approx(2 * np.sqrt(2.0**2 - 0.25**2), abs=0.09)
    # The disc's foot is the ball's; the stage is 0.02 mm lower.
    assert variables["step"].height_mm == pytest.approx(0.52, abs=1e-3)
    # The highest of noisy heights.
    assert variables["bar"].height_mm == pytest.approx(0.52, abs=5e-3)
    assert variables["disc"].rms_mm < 2.5e-3


def test_figures_of_the_document(executed, text):
    """Expected: the output is the value in the comment of each line, within 20 % or 2 um."""
    stated = re.findall(r"^print\(.*\)  # (.*)$", text, re.MULTILINE)
    printed = executed[1].splitlines()
    assert len(stated) == len(printed) == 6
    for shown, got in zip(stated, printed, strict=True):
        pairs = [[float(n) for n in re.findall(NUMBER, line)] for line in (got, shown)]
        np.testing.assert_allclose(*pairs, rtol=0.2, atol=2e-3, err_msg=shown)


PARTS = {
    "plane": (Region((-9.2, -6.8), (-1.2, 1.2)), "flatness_rms_um", (0.5, 2.5)),
    "ball": (Region((6.9, 9.1), (-1.1, 1.1), (-2.0, 1.0)), "radius_mm", (1.995, 2.005)),
    "cylinder": (Region((0.2, 1.8), (-3.0, 3.0), (-3.0, 1.0)), "radius_mm", (0.995, 1.005)),
    "bar": (Region((-30.0, -1.0), (-0.5, 0.5)), "width_mm", (3.88, 4.06)),
    "step": (Region((-30.0, -1.0), (-0.5, 0.5)), "step_height_mm", (0.519, 0.521)),
    "roughness": (Region((11.0, 30.0), (-4.0, 4.0)), "sq_um", (0.5, 2.5)),
}


@pytest.mark.parametrize("shape", PARTS)
def test_the_command_prints_the_gauges_sizes(executed, capsys, shape):
    """Expected: sizes as above; the perfectly smooth disc and stage show the noise of 1.5 um."""
    part, figure, (low, high) = PARTS[shape]
    assert low < dimensions(executed[2], shape, part)[figure] < high
    ranges = (("--x", part.x_mm), ("--y", part.y_mm), ("--z", part.z_mm))
    given = [str(word) for name, ends in ranges if ends for word in (name, *ends)]
    assert run(["evaluate", str(executed[2]), shape, *given]) == 0
    assert figure in capsys.readouterr().out


def test_a_part_without_points_is_refused(executed, tmp_path, capsys):
    assert run(["evaluate", str(executed[2]), "ball", "--x", "100", "101"]) == 2
    assert "no valid point in the given ranges" in capsys.readouterr().err
    assert run(["evaluate", str(tmp_path), "ball"]) == 2
    assert "no reconstruction.nc" in capsys.readouterr().err
