"""Derivatives of presses by an experiment's numbers; what is not differentiable is told."""

import json

import h5netcdf
import numpy as np
import pytest

from reconstruction.errors import InputError
from tests.pictures import is_drawn
from twin.cli import run
from twin.config import load_experiment
from twin.mechanics.hardness import young_modulus
from twin.pipeline.gradients import with_number
from twin.pipeline.sensitivity import press_derivatives
from twin.specimens.kinds.ball import Ball


@pytest.fixture(scope="module")
def experiment():
    """Return a small ball in a small frame, under the sheet of the balls."""
    whole = load_experiment("examples/wrapped_balls")
    size = {"length_x_mm": 10.0, "length_y_mm": 10.0}
    load = {"cell_mm": 0.4, "depth_mm": 0.5}
    changed = {
        "specimen": Ball(diameter_mm=5.0),
        "elastomer": whole.elastomer.model_copy(update=size),
        "press": whole.press.model_copy(update=load),
    }
    return whole.model_copy(update=changed)


def test_hardness_acts_through_the_modulus(experiment):
    """Chain rule: what moves by Shore A moves by E times dE/dShore."""
    _, (by_shore,) = press_derivatives(experiment, ["elastomer.shore_a"])
    modulus_kpa = young_modulus(experiment.elastomer).best_kpa
    known = {"shore_a": None, "shore_00": None, "young_modulus_kpa": modulus_kpa}
    elastomer = experiment.elastomer.model_copy(update=known)
    stated = experiment.model_copy(update={"elastomer": elastomer})
    _, (by_modulus,) = press_derivatives(stated, ["elastomer.young_modulus_kpa"])
    shore = experiment.elastomer.shore_a
    ends = [
        young_modulus(with_number(experiment, "elastomer.shore_a", shore + by).elastomer).best_kpa
        for by in (-1e-4, 1e-4)
    ]
    slope = (ends[1] - ends[0]) / 2e-4
    assert by_shore.figures["young_modulus_kpa"] == pytest.approx(slope, rel=1e-6)
    largest = np.abs(by_shore.face_z).max()
    assert np.abs(by_shore.face_z - slope * by_modulus.face_z).max() < 1e-4 * largest


def test_the_contact_goes_with_the_travel(experiment):
    _, (by_travel,) = press_derivatives(experiment, ["press.depth_mm"])
    assert by_travel.figures["depth_mm"] == pytest.approx(1.0, rel=1e-6)
    assert by_travel.figures["relief_peak_mm"] == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(
    ("settings", "path", "told"),
    [
        ({}, "camera.gain", r"camera\.gain: found no derivative by it; allowed: elastomer"),
        ({}, "press.control", r"press\.control: found 'depth', allowed a number"),
        ({}, "elastomer.length_x_mm", "needs a new grid"),
        ({"mechanics.model": "spectral"}, "press.depth_mm", "found 'spectral', which has no deriv"),
    ],
)
def test_what_has_no_derivative_is_told(experiment, settings, path, told):
    case = load_experiment("examples/slab_balls", settings) if settings else experiment
    with pytest.raises(InputError, match=told):
        press_derivatives(case, [path])


def test_press_writes_them(tmp_path):
    path, out = "elastomer.thickness_mm", tmp_path / "out"
    small = ("press.cell_mm=0.5", "press.depth_mm=0.5", "elastomer.length_y_mm=15")
    settings = [word for one in small for word in ("-s", one)]
    command = ["press", "examples/wrapped_balls", "-o", str(out), *settings, "--by", path]
    assert run(command) == 0
    figures = json.loads((out / "result.json").read_text())["metrics"]
    assert figures[f"force_n_by_{path}"] < 0.0 < figures[f"thinnest_mm_by_{path}"]
    with h5netcdf.File(out / "derivatives.nc") as file:
        found = file[f"face_z_by_{path}"]
        assert found.dimensions == ("face_y", "face_x")
        assert np.abs(found[...]).max() > 1.0
    assert is_drawn(out / "derivatives.png", 5.2, 3.8)
