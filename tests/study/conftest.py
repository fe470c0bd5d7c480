"""Studies for tests: small images, coarse faces."""

import pytest

from twin.config import load_experiment
from twin.config.study import Study
from twin.study.record import StudyRecord, write_record
from twin.study.store import Store

SMALL = {
    "camera.binning": 4,
    "camera.width_px": 640,
    "camera.height_px": 480,
    "press.relief_pitch_mm": 0.05,
    "press.solver_pitch_mm": 0.16,
    # A free sheet: under a drape the shape depends on the modulus, and forces are the drape's.
    "press.back_pressure_kpa": 0.0,
    "patterns.steps": 4,
}


@pytest.fixture(scope="session")
def base():
    return load_experiment("examples/slab_balls", SMALL)


@pytest.fixture
def study_of():
    """Make a study from its axes and further keys."""

    def make(*axes, **keys):
        return Study(name="test", base="examples/slab_balls", axis=axes, **keys)

    return make


@pytest.fixture
def stored(tmp_path, base):
    """Put a study into a new store."""

    def make(study, name="store"):
        store = Store(tmp_path / name)
        store.open()
        record = StudyRecord(study, base)
        write_record(store.folder, record)
        return store, record.cases().unique()

    return make


@pytest.fixture
def few(study_of):
    """20 cases: where their number does not matter."""
    albedo = {"path": "coating.base_albedo", "low": 0.1, "high": 0.8, "count": 5}
    period = {"path": "patterns.period_px", "low": 10, "high": 28, "count": 4}
    return study_of(albedo, period)
