"""A data set made by a Dask cluster of processes; needs the extra `sweep`."""

import pytest

from tests.dataset.conftest import COUNT, MadeSet
from twin.cli import run

distributed = pytest.importorskip("distributed")

# As in tests/study/test_dask.py: Dask's own.
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


def test_a_cluster_gives_the_bytes_of_one_process(made: MadeSet, tmp_path) -> None:
    folder = tmp_path / "set"
    words = ["dataset", str(made.file), "-n", str(COUNT), "-o", str(folder)]
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=True, dashboard_address=":0"
    ) as cluster:
        assert run([*words, "--cluster", cluster.scheduler_address]) == made.code
    names = sorted(path.name for path in made.folder.iterdir())
    assert sorted(path.name for path in folder.iterdir()) == names
    for name in names:
        assert (folder / name).read_bytes() == (made.folder / name).read_bytes(), name
