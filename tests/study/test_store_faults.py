"""Damaged, unfinished and full stores: reported, repaired, and never an obstacle."""

import os
import re
import shutil
import sqlite3
from contextlib import closing

import pytest

from tests.study import synthetic
from twin.study import index as index_module
from twin.study.engine import Run
from twin.study.index import Index
from twin.study.record import read_record
from twin.study.store import Store
from twin.study.sweep import sweep
from twin.study.table import read_table, write_csv
from twin.study.workers import local_workers


def csv_of(store, tmp_path, name):
    write_csv(read_table(store.folder), tmp_path / name)
    return (tmp_path / name).read_bytes()


@pytest.mark.parametrize("left", [(), ("store.json",), ("store.json", "cases")])
def test_killed_before_the_store_is_one(few, stored, tmp_path, left):
    """Setup: the files of a run that was killed while it created its store."""
    whole, _ = stored(few, "whole")
    folder = tmp_path / "killed"
    folder.mkdir()
    for name in ("twin-manifest.txt", *left):
        if name == "cases":
            (folder / name).mkdir()
        else:
            (folder / name).write_bytes((whole.folder / name).read_bytes())
    store = Store(folder)
    assert store.finished() == set()
    store.open()
    assert store.finished() == set()
    assert store.abandoned() == []
    with store.claimed("00ff") as mine:
        assert mine


def test_give_up_on_a_full_disk(study_of, stored, monkeypatch):
    """Not even the reason of a crash can be written: it is reported, other cases are computed."""
    import errno

    from twin.study import store as store_module

    def synchronise(folder):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))

    monkeypatch.setattr(store_module, "make_durable", synchronise)  # of this process, not workers
    monkeypatch.setattr("twin.study.engine._MOST_DEATHS_EACH", 1)
    store, cases = stored(study_of({"path": "coating.base_albedo", "values": [0.1, 0.4, 0.5]}))
    outcome = Run(store, local_workers(2), make_measurer=synthetic.Failing)(cases)
    assert outcome.states == {"done": 2, "unsaved": 1}
    (reason,) = outcome.unsaved.values()
    assert "died 1 times" in reason
    assert "No space left" in reason


def test_full_disk_is_reported_and_repaired(study_of, stored, monkeypatch):
    """The disk is full for two cases: reported, other cases are saved, a second run adds them."""
    import errno

    from twin.study import store as store_module

    albedo = {"path": "coating.base_albedo", "values": [0.1, 0.2, 0.3, 0.4]}
    store, cases = stored(study_of(albedo))
    real, calls = store_module.make_durable, []

    def synchronise(folder):
        calls.append(folder)
        if len(calls) in (2, 3):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))
        real(folder)

    monkeypatch.setattr(store_module, "make_durable", synchronise)
    index = Index(store)
    outcome = Run(store, local_workers(1), make_measurer=synthetic.Fake, done=index.enter)(cases)
    assert outcome.states == {"done": 2, "unsaved": 2}
    assert all("No space left" in reason for reason in outcome.unsaved.values())
    unsaved = [e for e in index.entries().values() if e.state == "unsaved"]
    assert {e.digest for e in unsaved} == set(outcome.unsaved)
    assert not any((store.folder / ".parts").iterdir())
    again = Run(store, local_workers(1), make_measurer=synthetic.Fake, done=index.enter)(cases)
    assert again.states == {"done": 2}
    assert {e.state for e in index.entries().values()} == {"done"}


def test_a_failing_index_does_not_stop_a_run(few, stored, monkeypatch):
    """Damaged while cases are entered; then one that cannot be opened at all."""
    store, cases = stored(few)
    (store.folder / "index.sqlite").write_bytes(b"no database at all" * 100)
    index = Index(store)
    Run(store, local_workers(1), make_measurer=synthetic.Fake, done=index.enter)(cases)
    digests = {case.digest for case in cases}
    assert index.entries().keys() == digests

    def refuse(*_, **__):
        raise sqlite3.OperationalError("unable to open database file")

    monkeypatch.setattr(sqlite3, "connect", refuse)
    assert index.entries().keys() == digests
    assert (store.folder / "index.sqlite").is_file()


def test_a_missing_index_is_built_again(few, stored, tmp_path):
    store, cases = stored(few)
    index = Index(store)
    Run(store, local_workers(1), make_measurer=synthetic.Fake, done=index.enter)(cases)
    before = csv_of(store, tmp_path, "before.csv")
    (store.folder / "index.sqlite").unlink()
    assert csv_of(store, tmp_path, "missing.csv") == before
    (store.folder / "index.sqlite").write_bytes(b"no database at all" * 100)
    assert csv_of(store, tmp_path, "damaged.csv") == before
    store.forget(cases[0].digest)
    assert index.entries().keys() == {case.digest for case in cases[1:]}


def cut(folder):
    (folder / "result.json").write_text('{"metrics": {"value": 1')


def empty(folder):
    for file in folder.iterdir():
        file.unlink()


def nested(folder):
    (folder / "result.json").write_text("[" * 100_000)


def no_metrics(folder):
    (folder / "result.json").write_text("{}")


def no_time(folder):
    (folder / "timings.json").write_text('{"case": null}')


def another_figure(folder):
    """Valid in itself, but not the measured result."""
    path = folder / "result.json"
    path.write_text(re.sub(r'"value": [^,}\n]+', '"value": 1.25', path.read_text()))


def pipe(folder):
    (folder / "result.json").unlink()
    os.mkfifo(folder / "result.json")


def no_manifest(folder):
    (folder / "twin-manifest.txt").unlink()


def cut_manifest(folder):
    (folder / "twin-manifest.txt").write_text("# fringe-twin manifest 1: result\nabc")


def somebody_elses(folder):
    (folder / "result.json").unlink()
    (folder / "notes.txt").write_text("mine")


def a_file(folder):
    shutil.rmtree(folder)
    folder.write_text("no folder")


DAMAGES = [cut, empty, nested, no_metrics, no_time, another_figure, pipe, no_manifest, cut_manifest]


@pytest.mark.parametrize("damage", [*DAMAGES, somebody_elses, a_file])
def test_a_damaged_case_costs_itself(few, stored, tmp_path, damage):
    """It is named in the table, all other cases are read, and the next run computes it again."""
    store, cases = stored(few)
    record = read_record(store.folder)

    def run():
        return sweep(record, store.folder, local_workers(1), make_measurer=synthetic.Fake)

    assert run().finished == 20
    before = csv_of(store, tmp_path, "before.csv")
    victim = cases[7].digest
    damage(store.path_of(victim))
    for _ in ("with the index", "without"):
        rows = {row["case"]: row for row in read_table(store.folder).rows}
        assert [row["state"] for row in rows.values()].count("done") == 19
        assert rows[victim]["state"] == "damaged"
        assert str(store.path_of(victim)) in rows[victim]["reason"]
        (store.folder / "index.sqlite").unlink()
    again = run()
    assert again.states == {"done": 1}
    assert list(again.damaged) == [victim]
    assert csv_of(store, tmp_path, "after.csv") == before


def test_foreign_files_are_moved_aside(few, stored):
    store, cases = stored(few)
    record = read_record(store.folder)
    for _ in range(2):
        sweep(record, store.folder, local_workers(1), make_measurer=synthetic.Fake)
        somebody_elses(store.path_of(cases[2].digest))
    sweep(record, store.folder, local_workers(1), make_measurer=synthetic.Fake)
    notes = sorted((store.folder / "aside").glob("*/notes.txt"))
    assert [path.parent.name for path in notes] == [f"{cases[2].digest}.{n}" for n in (0, 1)]


def test_figures_of_the_index_are_those_of_the_case(few, stored, tmp_path):
    """A row that somebody changed, or that a disk did, does not hold against its case."""
    store, cases = stored(few)
    Run(store, local_workers(1), make_measurer=synthetic.Fake, done=Index(store).enter)(cases)
    before = csv_of(store, tmp_path, "before.csv")
    with closing(sqlite3.connect(store.folder / "index.sqlite")) as connection, connection:
        changed = connection.execute("UPDATE checked SET figures = '{\"value\": 1.25}'").rowcount
    assert changed == 20
    assert csv_of(store, tmp_path, "after.csv") == before


def test_a_valid_index_is_not_read_again(few, stored, tmp_path, monkeypatch):
    store, cases = stored(few)
    Run(store, local_workers(1), make_measurer=synthetic.Fake, done=Index(store).enter)(cases)
    before = csv_of(store, tmp_path, "before.csv")
    monkeypatch.setattr(index_module, "entry_of", lambda *_: pytest.fail("read anew"))
    assert csv_of(store, tmp_path, "after.csv") == before
