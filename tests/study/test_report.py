"""The page of a study: whole, self-contained, and every case one click away."""

import re

import pytest

from tests.study import synthetic
from twin.config.study import Study
from twin.report.study import write_study
from twin.study.record import StudyRecord
from twin.study.sweep import sweep
from twin.study.workers import local_workers

ALBEDO = {"path": "coating.base_albedo", "name": "albedo", "low": 0.1, "high": 0.9}
ROUGH = {"path": "coating.flake_roughness", "name": "rough", "low": 0.1, "high": 0.9}


def page_of(base, folder, *axes, **keys):
    record = StudyRecord(Study(name="test", base="x", axis=axes, **keys), base)
    sweep(record, folder, local_workers(1), make_measurer=synthetic.Bowl)
    return write_study(folder).read_text()


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
