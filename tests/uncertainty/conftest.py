"""A study of trials with a known result, without a renderer."""

import pytest

from tests.uncertainty.models import Linear
from twin.config import load_experiment
from twin.propagation.results import read_uncertainty
from twin.propagation.trials import record_of
from twin.study.measuring import RigCovariance
from twin.study.sweep import sweep
from twin.study.workers import local_workers

X = {"group": "placement", "key": "specimen.x_mm", "distribution": "normal", "spread": 0.1}
Y = {"group": "placement", "key": "specimen.y_mm", "distribution": "uniform", "spread": 0.1}


@pytest.fixture(scope="session")
def balls():
    return load_experiment("examples/slab_balls")


@pytest.fixture
def run_trials(tmp_path, balls, monkeypatch):
    """Run trials of a model into a folder, and evaluate them."""
    from twin.study import sweep as module

    monkeypatch.setattr(module, "calibrated", lambda *_: RigCovariance(()))

    def run(n, inputs=None, *, name="out", model=Linear, workers=1, **options):
        record = record_of(balls, inputs or {"x": X, "y": Y}, n, **options)
        sweep(record, tmp_path / name, local_workers(workers), make_measurer=model)
        return read_uncertainty(tmp_path / name, ["value_mm"])

    return run
