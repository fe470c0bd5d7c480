"""The same sweep on a Dask cluster of processes; needs the extra `sweep`."""

import pytest

from twin.study.engine import Run
from twin.study.workers import dask_workers, local_workers

distributed = pytest.importorskip("distributed")

# Dask's own: sockets that close late when a cluster of processes ends, and its event loop.
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


@pytest.fixture(scope="module")
def cluster():
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0"
    ) as running:
        yield running


def contents(store):
    """Every file of every case but the clock's."""
    return {
        path.relative_to(store.cases): path.read_bytes()
        for path in store.cases.rglob("*")
        if path.is_file() and path.name not in ("timings.json", "twin-manifest.txt")
    }


def test_cluster_gives_the_bytes_of_one_process(mi, cluster, study_of, stored):
    """Setup: a cluster of two processes, and this process."""
    albedo = {"path": "coating.base_albedo", "values": [0.3, 0.4]}
    period = {"path": "patterns.period_px", "values": [18.0, 20.0]}
    study = study_of(albedo, period)
    result = []
    for name, workers in (
        ("one", local_workers(1)),
        ("cluster", dask_workers(cluster.scheduler_address)),
    ):
        store, cases = stored(study, name)
        outcome = Run(store, workers)(cases)
        assert outcome.states == {"done": 4}
        result.append(contents(store))
    assert result[0] == result[1]


def test_no_scheduler(monkeypatch):
    from reconstruction.errors import InputError
    from twin.study import workers

    monkeypatch.setattr(workers, "_CONNECT_WITHIN", "1s")
    with pytest.raises(InputError, match="no Dask scheduler answers"):
        dask_workers("tcp://127.0.0.1:1")
