"""The page of a study: whole, self-contained, and every case one click away."""

import re

import numpy as np
import pytest

from reconstruction.errors import InputError
from tests.study import synthetic
from twin.config.study import Study
from twin.optics.backend import MissingBackend
from twin.report.study import write_study
from twin.report.study_figures import Scales
from twin.study import pictures
from twin.study.pictures import CasePicture
from twin.study.record import StudyRecord
from twin.study.sweep import sweep
from twin.study.workers import local_workers

ALBEDO = {"path": "coating.base_albedo", "name": "albedo", "low": 0.1, "high": 0.9}
ROUGH = {"path": "coating.flake_roughness", "name": "rough", "low": 0.1, "high": 0.9}


def picture_of(level):
    """A picture with heights up to `level` mm and an error of `level` um everywhere."""
    there = np.ones((6, 8), bool)
    flat = np.full((6, 8), level, np.float32)
    ends = np.array([0.0, level])
    return CasePicture(there.astype(np.uint8), flat, there, flat, there, ends, np.array(9.6))


@pytest.fixture(autouse=True)
def taken(monkeypatch):
    """Cases that were measured for their picture: here replaced by a function without renderer."""
    result = []

    def take(experiment, _):
        result.append(experiment)
        return picture_of(experiment.coating.base_albedo)

    monkeypatch.setattr(pictures, "take_picture", take)
    return result


def page_of(base, folder, *axes, **keys):
    record = StudyRecord(Study(name="test", base="x", axis=axes, **keys), base)
    sweep(record, folder, local_workers(1), make_measurer=synthetic.Bowl)
    return drawn(folder)


def drawn(folder):
    """Make the missing pictures, then draw."""
    return write_study(folder, failed=pictures.picture_best(folder)).read_text()


def test_grid(base, tmp_path):
    bound = {"value": "bowl", "at_most": 0.1}
    axes = ALBEDO | {"count": 5}, ROUGH | {"values": [0.3, 0.6], "low": None, "high": None}
    text = page_of(base, tmp_path, *axes, constraint=(bound,))
    assert 'src="http' not in text
    links = re.findall(r'href="(cases/[0-9a-f]{16}/result.json)"', text)
    assert len(set(links)) == 10
    assert all((tmp_path / link).is_file() for link in links)
    assert "bowl &lt;= 0.1" in text
    for name in ("main_effects", "parallel", "interactions_bowl", "sensitivity"):
        assert (tmp_path / "figures" / f"{name}.png").is_file()


@pytest.mark.parametrize("method", ["saltelli", "morris", "latin_hypercube"])
def test_samplers(base, tmp_path, method):
    text = page_of(base, tmp_path, ALBEDO, ROUGH, sampling={"method": method, "count": 8})
    drawn = (tmp_path / "figures" / "sensitivity.png").is_file()
    assert drawn == (method != "latin_hypercube")
    assert ("95 %" in text) == drawn


def test_pareto_front(base, tmp_path):
    pytest.importorskip("optuna")
    goals = [{"metric": "bowl"}, {"metric": "slope", "goal": "maximise"}]
    plan = {"objectives": goals, "trials": 8, "batch": 8, "sampler": "random"}
    text = page_of(base, tmp_path, ALBEDO, ROUGH, sampling={"method": "optimise"}, optimise=plan)
    assert "minimise bowl, maximise slope" in text
    assert (tmp_path / "figures" / "front.png").is_file()


def test_best_designs_in_pictures(base, tmp_path, taken):
    """Five designs of one objective, each with three pictures; a second report measures no case."""
    text = page_of(base, tmp_path, ALBEDO | {"count": 5}, metrics=["bowl"], repeats=2)
    assert len(taken) == 5  # the second repeat is no design of its own
    assert text.count('<section id="design_') == 5
    assert text.index("1 · albedo 0.5, seed") < text.index("2 · albedo 0.3, seed")
    assert len(list((tmp_path / "figures").glob("design_*.png"))) == 15
    assert drawn(tmp_path) == write_study(tmp_path).read_text() == text
    assert len(taken) == 5
    next((tmp_path / "pictures").iterdir()).write_bytes(b"damaged")
    assert "Without pictures: not drawn yet" in write_study(tmp_path).read_text()
    assert len(taken) == 5  # the report itself measures no case
    assert drawn(tmp_path) == text
    assert len(taken) == 6


def test_designs_share_their_scales():
    scales = Scales.of([picture_of(0.2), picture_of(0.41), picture_of(0.3)])
    assert scales.z.ends_mm == (0.0, 0.5)
    assert scales.error_um == 0.5


@pytest.mark.parametrize("error", [MissingBackend("no LLVM"), InputError("pokes through")])
def test_pictures_that_cannot_be_taken(base, tmp_path, monkeypatch, error):
    def take(*_):
        raise error

    monkeypatch.setattr(pictures, "take_picture", take)
    text = page_of(base, tmp_path, ALBEDO | {"count": 3})
    assert f"Without pictures: {error}" in text
    assert text.count('<section id="design_') == 3
    assert not list((tmp_path / "figures").glob("design_*.png"))
