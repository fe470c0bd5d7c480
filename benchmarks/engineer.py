"""An engineer's task: from a wish to a sensor in six commands, confirmed by an exhaustive check.

The wish: engraved text with strokes of 1.6 mm, 0.2 mm deep, its depth within 10 um; a field of
12 x 9 mm, 200 ms per sequence, air of 2 kPa. The engineer fills in the templates of `twin init`,
and a study varies thickness and hardness of the sheet and the phase steps of the sequence. The last
sentence of the study's page must name the design that the exhaustive check selects: every
combination is measured by `twin.measure` outside the study, and judged by its own figures.

Last line: {"commands": n, "designs": n, "within_tolerance": n, "confirmed": true or false,
"margin_um": um of the best design of the check, "margin_full_size_um": um of the named design at
full size, "sequence_ms": ms}. "margin_um" is null if no design meets all conditions.
"""

import contextlib
import html
import io
import math
import re
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import trimesh

import twin
from benchmarks._harness import print_figures, quick_parser
from reconstruction.reading import read_json
from twin.cli import run
from twin.study.table import read_table

DEPTH_MM, STROKE_MM = 0.2, 1.6
SEQUENCE_MS, COVERAGE = 200.0, 0.8
# Strokes of the letter H in stroke widths: x, y, width, height; 5 x 5 in all.
_STROKES = ((0, 0, 1, 5), (4, 0, 1, 5), (1, 2, 3, 1))

_SENSOR = """
[specimen]
kind = "mesh"
file = "./text.stl"

[[measurand]]
name = "depth"
quantity = "step_height"
nominal_mm = 0.2
plus_minus_um = 10.0

[elastomer]
use = "materials/elastomers/thin_silicone_c"
length_x_mm = 18.0
length_y_mm = 15.0

[press]
use = "scenes/presses/wrapped"
depth_mm = 0.3
back_pressure_kpa = 2.0
cell_mm = {cell_mm}

[optics]
field_mm = [12.0, 9.0]

[patterns]
axes = ["column"]
"""
_STUDY = """
[set.camera]
binning = 4

[[axis]]
name = "thickness"
path = "elastomer.thickness_mm"
values = {thickness}

[[axis]]
name = "hardness"
path = "elastomer.shore_a"
values = {hardness}

[[axis]]
name = "steps"
{steps}
[[constraint]]
value = "sequence_ms"
at_most = 200.0

"""
_STEPS = """[axis.choices.{steps}]
patterns.steps = {steps}
camera.exposure_ms = {exposure_ms}
"""
# Exposure, ms, by the number of phase steps: of 14, 17 and 18 frames. The camera takes 89 images/s.
_EXPOSURE_MS = {4: 14.2, 7: 11.7, 8: 11.1}


@dataclass(frozen=True)
class Space:
    """Design space of the study, and the cell of the press.

    Attributes
    ----------
    thickness_mm, shore_a : levels of the axes
    steps : phase steps of the sequences; 8 steps take more than 200 ms
    cell_mm : cell of the sheet
    binning : of the last measurement, which is that of the named design
    """

    thickness_mm: Sequence[float] = (0.1, 0.15, 0.2)
    shore_a: Sequence[float] = (8.0, 12.0)
    steps: Sequence[int] = (4, 7, 8)
    cell_mm: float = 0.3
    binning: int = 1

    def designs(self) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
        """Yield the settings of every design as in the page, and the changes of the experiment."""
        for thickness_mm, shore_a, steps in product(self.thickness_mm, self.shore_a, self.steps):
            settings = {"thickness": thickness_mm, "hardness": shore_a, "steps": steps}
            sheet = {"elastomer.thickness_mm": thickness_mm, "elastomer.shore_a": shore_a}
            sequence = {"patterns.steps": steps, "camera.exposure_ms": _EXPOSURE_MS[steps]}
            yield settings, {"camera.binning": 4} | sheet | sequence


QUICK = Space((0.1, 0.3), (10.0,), (4, 7), 0.4, 4)


def main() -> None:
    """Play the engineer and print one JSON line."""
    quick = quick_parser(__doc__, "four designs, coarse cells").parse_args().quick
    space = QUICK if quick else Space()
    with tempfile.TemporaryDirectory() as scratch, contextlib.chdir(scratch):
        commands, last, built = play(space)
        margins = exhaustive(space)
    sys.stdout.write(f"{last}\n")
    best = max(margins, key=margins.__getitem__)
    print_figures(
        {
            "commands": len(commands),
            "designs": len(margins),
            "within_tolerance": sum(margin >= 0 for margin in margins.values()),
            "confirmed": last.startswith(f"Build this: {best}, because "),
            "margin_um": margins[best] if math.isfinite(margins[best]) else None,
            "margin_full_size_um": built["least_margin_um"],
            "sequence_ms": built["sequence_ms"],
        }
    )


def play(space: Space) -> tuple[list[str], str, Mapping[str, Any]]:
    """Go from the wish to the sensor in the current folder.

    Returns
    -------
    the commands, the last sentence of the study's page, and the figures of the named design
    """
    engraved_text().export("text.stl")
    commands = ["init experiment.toml --template sheet", "init study.toml --template study"]
    for command in commands:
        command_output(command)
    fill_in(space)
    commands += [
        "sweep study.toml -o found --dry-run",
        "sweep study.toml -o found -j 1",
        "sweep report found",
    ]
    for command in commands[2:]:
        command_output(command)
    last = last_sentence(Path("found/report.html").read_text(encoding="utf-8"))
    case = named_case(last)
    size = f"-s camera.binning={space.binning}"
    commands.append(f"measure found/cases/{case}/experiment.toml -o built {size} --no-report")
    command_output(commands[-1])
    return commands, last, read_json(Path("built/result.json"))["metrics"]


def command_output(command: str) -> str:
    """Run a command of `twin` and return its standard output; RuntimeError if it fails."""
    text = io.StringIO()
    with contextlib.redirect_stdout(text):
        code = run(command.split())
    if code:
        raise RuntimeError(f"twin {command}: exit code {code}")
    return text.getvalue()


def engraved_text() -> trimesh.Trimesh:
    """Return a plate of 14 x 11 mm with the letter H engraved into its upper face."""
    cuts = []
    for x, y, across, up in _STROKES:
        low = (x - 2.5) * STROKE_MM, (y - 2.5) * STROKE_MM
        ends = low[0] + across * STROKE_MM, low[1] + up * STROKE_MM
        # Strokes overlap by 2 um: between faces that only touch, a wall would remain.
        bounds = [[*(a - 1e-3 for a in low), -DEPTH_MM], [*(b + 1e-3 for b in ends), 1.0]]
        cuts.append(trimesh.creation.box(bounds=bounds))
    plate = trimesh.creation.box(bounds=[[-7.0, -5.5, -2.0], [7.0, 5.5, 0.0]])
    text = trimesh.boolean.union(cuts, engine="manifold")
    return trimesh.boolean.difference([plate, text], engine="manifold")


def fill_in(space: Space) -> None:
    """Write the wish into the templates: part, tolerance, air and field; axes and limits."""
    sensor_file, study_file = Path("experiment.toml"), Path("study.toml")
    sensor = sensor_file.read_text(encoding="utf-8")
    head = sensor[: sensor.index("[specimen]")]
    text = head + _SENSOR.format(cell_mm=space.cell_mm)
    sensor_file.write_text(text, encoding="utf-8")

    study = study_file.read_text(encoding="utf-8")
    study = study.replace('"templates/part"', '"experiment.toml"')
    axes = _STUDY.format(
        thickness=list(space.thickness_mm),
        hardness=list(space.shore_a),
        steps="".join(
            _STEPS.format(steps=steps, exposure_ms=_EXPOSURE_MS[steps]) for steps in space.steps
        ),
    )
    cut = re.compile(r"\[set\.camera\].*?(?=\[\[constraint\]\])", re.DOTALL)
    study_file.write_text(cut.sub(axes, study), encoding="utf-8")


def last_sentence(page: str) -> str:
    """Return the last paragraph of a page."""
    return html.unescape(re.findall(r"<p[^>]*>(.*?)</p>", page, re.DOTALL)[-1])


def named_case(sentence: str) -> str:
    """Return the name of the case with the design that a sentence names."""
    for row in read_table(Path("found")).rows:
        if sentence.startswith(f"Build this: {in_words(row)}, because "):
            return str(row["case"])
    raise RuntimeError(f"no case is the design of: {sentence}")


def in_words(settings: Mapping[str, Any]) -> str:
    """Return the settings of a design as the page writes them."""
    thickness, hardness = settings["thickness"], settings["hardness"]
    return f"thickness {thickness:.4g} mm, hardness {hardness:.4g}, steps {settings['steps']}"


def exhaustive(space: Space) -> dict[str, float]:
    """Measure every design outside the study; return the margin, um, of each by its settings.

    The margin of a design that misses a condition or has no value is minus infinity.
    """
    sensor = twin.load_experiment("experiment.toml")
    memory, margins = twin.Memory(), {}
    for settings, changes in space.designs():
        figures = twin.measure(twin.vary(sensor, changes), memory=memory).metrics
        margin, covered = figures["least_margin_um"], figures["object_coverage_share"]
        enough = covered >= COVERAGE and figures["sequence_ms"] <= SEQUENCE_MS
        within = margin is not None and margin >= 0
        margins[in_words(settings)] = float(margin) if enough and within else float("-inf")
    return margins


if __name__ == "__main__":
    main()
