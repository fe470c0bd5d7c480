"""A small data set: two reliefs by direct projection and a pressed ball, 80 x 60 pixels."""

import contextlib
import io
from pathlib import Path
from typing import NamedTuple

import pytest

from twin.cli import run
from twin.config.dataset import Recipe, load_recipe
from twin.config.models import Experiment
from twin.dataset.draws import SampleDraw
from twin.dataset.make import draw_all, work_folder

SMALL = """
[scene.set.camera]
binning = 4
width_px = 320
height_px = 240
[scene.set.patterns]
steps = 3
code = "gray"
"""
RECIPE = f"""
name = "small"
seed = 10
shard_mb = 0.3
[[scene]]
name = "relief"
base = "examples/gauges"
weight = 2.0
[scene.set.specimen]
kind = "random_relief"
shortest_mm = 2.0
rms_um = 30.0
material = {{ use = "materials/diffuse/gray_print" }}
{SMALL}
[[scene.axis]]
path = "specimen.seed"
low = 0
high = 4294967295
integer = true
[[scene]]
name = "ball"
base = "examples/slab_ball"
{SMALL}
[[scene.axis]]
path = "specimen.diameter_mm"
values = [6.0, 1e6]
[inputs.angle]
group = "optics"
key = "projector.pose.polar_deg"
distribution = "normal"
spread = 0.5
[sample]
hold = ["frames", "radiance", "depth_mm", "normal_world", "point_world_mm", "label", "lit",
  "projector_column_px", "phase_column_rad", "wrapped_phase_column_rad", "order_column",
  "decoded_depth_mm", "decoded_normal_world", "decoded_phase_column_rad",
  "decoded_wrapped_phase_column_rad", "decoded_reason", "decoded_sigma_z_mm"]
[split]
train = 0.0
validation = 0.0
test = 1.0
"""
COUNT = 4  # a draw that is not valid, two reliefs, one ball


class MadeSet(NamedTuple):
    """A data set on the disk, with its recipe and all that was drawn; the last word of the run."""

    folder: Path
    file: Path
    recipe: Recipe
    bases: tuple[Experiment, ...]
    draws: tuple[SampleDraw, ...]
    code: int
    printed: str

    @property
    def work(self) -> Path:
        return work_folder(self.folder)


@pytest.fixture(scope="session")
def small_recipe(tmp_path_factory) -> Path:
    file = tmp_path_factory.mktemp("recipe") / "small.toml"
    file.write_text(RECIPE, encoding="utf-8")
    return file


@pytest.fixture(scope="session")
def made(tmp_path_factory, small_recipe) -> MadeSet:
    """Return the data set of the first samples, made by the command."""
    folder = tmp_path_factory.mktemp("made") / "set"
    words = ["dataset", str(small_recipe), "-n", str(COUNT), "-o", str(folder), "-j", "1"]
    with contextlib.redirect_stderr(io.StringIO()) as printed:
        code = run(words)
    recipe, bases = load_recipe(small_recipe)
    draws = draw_all(recipe, bases, COUNT)
    return MadeSet(folder, small_recipe, recipe, bases, draws, code, printed.getvalue())
