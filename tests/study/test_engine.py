"""The engine: every case once, even if processes die; the same bytes on any executor."""

import multiprocessing
import os
import random
import signal
import threading
import time
from collections import Counter

import pytest

from tests.study import synthetic
from tests.work import lines_run
from twin.study.engine import Run, run_together
from twin.study.index import Index
from twin.study.record import read_record
from twin.study.store import FAILURE_FILE, Store
from twin.study.sweep import forget_failures, sweep
from twin.study.table import read_table, write_csv
from twin.study.worker import Batch, compute
from twin.study.workers import lasting, local_workers, of_executor


@pytest.fixture
def two_axes(study_of):
    """60 cases."""
    albedo = {"path": "coating.base_albedo", "low": 0.1, "high": 0.8, "count": 10}
    period = {"path": "patterns.period_px", "low": 10, "high": 28, "count": 3}
    return study_of(albedo, period, repeats=2)


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """Two worker processes for several tests, and the log that their measurements write."""
    log = tmp_path_factory.mktemp("pair") / "log"
    with pytest.MonkeyPatch.context() as patch, lasting(local_workers(2)) as workers:
        patch.setenv(synthetic.LOG_VARIABLE, str(log))
        yield workers, log


@pytest.fixture
def two_workers(pair):
    """The two processes, with an empty log."""
    workers, log = pair
    log.write_text("")
    return workers, log


def csv_of(store, tmp_path, name):
    write_csv(read_table(store.folder), tmp_path / name)
    return (tmp_path / name).read_bytes()


def test_killed_at_random_20_times(two_axes, stored, tmp_path):
    """kill -9 of the whole run, 20 times during 60 cases.

    Expected: the table of an undisturbed run, byte by byte; every case computed once but for two at
    each kill, the one being computed and the one being stored; only complete cases in the store.
    """
    undisturbed, cases = stored(two_axes, "undisturbed")
    Run(undisturbed, local_workers(1), make_measurer=synthetic.Fake)(cases)
    store, _ = stored(two_axes, "killed")
    log = tmp_path / "log"
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tests.study.synthetic"])
    rng, kills = random.Random(1), 0
    while len(store.finished()) < len(cases):
        run = context.Process(target=synthetic.run_here, args=(store.folder, log))
        before = len(store.finished())
        run.start()
        if kills < 20:
            # Half of an even share on average: cases are left for all 20 on a slow machine too.
            more = rng.randint(0, (len(cases) - before) // (21 - kills))
            while run.is_alive() and len(store.finished()) < before + more:
                time.sleep(0.003)
            time.sleep(rng.uniform(0.0, 0.03))
            os.kill(run.pid, signal.SIGKILL)
            kills += 1
        run.join()
        for entry in store.cases.iterdir():
            assert {"result.json", "experiment.toml"} <= {f.name for f in entry.iterdir()}
    assert kills == 20
    assert csv_of(store, tmp_path, "a.csv") == csv_of(undisturbed, tmp_path, "b.csv")
    started = Counter(log.read_text().splitlines())
    assert len(started) == len(cases)
    assert sum(started.values()) - len(started) <= 2 * kills


def test_killed_worker_costs_its_case_only(two_axes, stored, tmp_path, monkeypatch):
    """kill -9 of a pool's worker: the run itself continues, without a restart."""
    log = tmp_path / "log"
    monkeypatch.setenv(synthetic.LOG_VARIABLE, str(log))
    store, cases = stored(two_axes)
    victims = []

    def kill_one(_):
        children = multiprocessing.active_children()
        if len(store.finished()) > 20 and children and not victims:
            victims.append(children[0].pid)
            os.kill(children[0].pid, signal.SIGKILL)

    run = Run(store, local_workers(2), make_measurer=synthetic.Fake, done=kill_one)
    outcome = run(cases)
    assert victims
    assert outcome.states["done"] == len(store.finished()) == len(cases)
    started = Counter(log.read_text().splitlines())
    # Per worker, one case is being computed and one is being stored.
    assert sum(started.values()) - len(started) <= 2 * 2


def test_failing_cases_do_not_stop_the_rest(study_of, stored):
    """A refusal, an unexpected error and a case that kills its worker are recorded with reasons.

    The death costs a second study on the same workers no case. A later run repeats crashes and
    unexpected errors, but InputErrors only with `retry`.
    """
    workers, parts = local_workers(2), []
    for name, values in (("sound", [0.1, 0.5]), ("failing", [0.1, 0.2, 0.3, 0.4, 0.5, 0.6])):
        store, cases = stored(study_of({"path": "coating.base_albedo", "values": values}), name)
        parts.append((Run(store, workers, make_measurer=synthetic.Failing), cases))
    sound, failing = run_together(parts, workers)
    assert sound.states == {"done": 2}
    assert failing.states == {"done": 3, "failed": 3}
    entries = Index(store).entries()
    reasons = [entries[case.digest].reason for case in cases]
    assert reasons[1] == "coating.base_albedo: found 0.2, which this test refuses"
    assert reasons[2] == "ZeroDivisionError: broken"
    assert reasons[3].startswith("its worker died 3 times")
    assert reasons[0] == reasons[4] == reasons[5] == ""
    assert forget_failures(store, cases) == 2
    assert forget_failures(store, cases) == 0
    assert forget_failures(store, cases, every=True) == 1
    assert not any(store.cases.glob(f"*/{FAILURE_FILE}"))


def test_two_runs_share_a_store(two_axes, stored, tmp_path, monkeypatch):
    """Two processes sweep the same study at once: together they compute each case once."""
    log = tmp_path / "log"
    store, cases = stored(two_axes)
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tests.study.synthetic"])
    runs = [context.Process(target=synthetic.run_here, args=(store.folder, log)) for _ in range(2)]
    for run in runs:
        run.start()
    for run in runs:
        run.join()
        assert run.exitcode == 0
    started = Counter(log.read_text().splitlines())
    assert len(started) == sum(started.values()) == len(cases) == len(store.finished())


def test_a_second_run_reports_the_first(few, stored):
    store, _ = stored(few)
    record, messages = read_record(store.folder), list[str]()

    def run():
        return sweep(
            *(record, store.folder, local_workers(1)),
            make_measurer=synthetic.Fake,
            tell=messages.append,
        )

    with store.exclusive() as exclusive:
        assert exclusive
        assert run().finished == 20
    assert messages == [f"{store.folder}: another run is active; both share the remaining cases"]
    run()
    assert len(messages) == 1


def test_two_runs_in_one_process(few, stored, tmp_path, monkeypatch):
    """Two threads sweep the same study: the system's locks do not exclude threads."""
    log = tmp_path / "log"
    monkeypatch.setenv(synthetic.LOG_VARIABLE, str(log))
    store, cases = stored(few)
    runs = [Run(store, local_workers(1), make_measurer=synthetic.Fake) for _ in range(2)]
    threads = [threading.Thread(target=run, args=(cases,)) for run in runs]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    started = Counter(log.read_text().splitlines())
    assert len(started) == sum(started.values()) == len(cases) == len(store.finished())
    with store.claimed(cases[0].digest) as first, store.claimed(cases[0].digest) as second:
        assert (first, second) == (True, False)


def test_same_bytes_on_any_workers(few, stored, two_workers, tmp_path):
    """One process and two give the same table; for a Dask cluster see test_dask."""
    first, cases = stored(few, "one")
    Run(first, local_workers(1), make_measurer=synthetic.Fake)(cases)
    two, _ = stored(few, "two")
    Run(two, two_workers[0], make_measurer=synthetic.Fake)(cases)
    assert csv_of(first, tmp_path, "1.csv") == csv_of(two, tmp_path, "2.csv")


def test_any_executor_will_do(few, stored):
    """A thread pool of the user's own; cases of one process never run side by side."""
    from concurrent.futures import ThreadPoolExecutor

    store, cases = stored(few)
    with ThreadPoolExecutor(3) as pool:
        outcome = Run(store, of_executor(pool, 3), make_measurer=synthetic.Fake)(cases)
    assert outcome.states == {"done": len(cases)}


def test_overhead_per_case(study_of, stored):
    """Engine, store and index run 37,000 lines of Python per case, however many cases there are.

    `benchmarks/sweep.py` has the milliseconds.
    """
    per_case = []
    for count in (20, 60):
        albedo = {"path": "coating.base_albedo", "low": 0.1, "high": 0.8, "count": count}
        store, cases = stored(study_of(albedo), f"of_{count}")
        run = Run(store, local_workers(1), make_measurer=_instant, done=Index(store).enter)
        per_case.append(lines_run(lambda run=run, cases=cases: run(cases)) / len(cases))
    assert max(per_case) < 60_000
    assert per_case[1] < 1.05 * per_case[0]


def _instant(keep):
    return synthetic.Fake(keep, seconds=0.0)


def test_two_workers_are_never_idle(study_of, stored, two_workers):
    """Each of 24 cases ends only while a second case runs: an idle worker would give errors.

    `benchmarks/sweep.py` has the gain in time.
    """
    albedo = {"path": "coating.base_albedo", "low": 0.1, "high": 0.8, "count": 24}
    store, cases = stored(study_of(albedo))
    outcome = Run(store, two_workers[0], make_measurer=synthetic.Meeting)(cases)
    assert outcome.states == {"done": 24}
    begun = Counter(two_workers[1].read_text().split())
    assert list(begun.values()) == [12, 12]


def test_runs_together_fill_each_others_gaps(study_of, stored, two_workers):
    """Two studies of one case each, a case that ends only while a second case runs.

    Expected: both end: the second study's case is handed out while the first one's is at work.
    Progress is that of both.
    """
    workers, parts, messages = two_workers[0], [], []
    for name, albedo in (("one", 0.2), ("two", 0.3)):
        store, cases = stored(study_of({"path": "coating.base_albedo", "values": [albedo]}), name)
        parts.append((Run(store, workers, make_measurer=synthetic.Meeting), cases))
    outcomes = run_together(parts, workers, lambda _, share: messages.append(share))
    assert [outcome.states for outcome in outcomes] == [{"done": 1}, {"done": 1}]
    assert messages == [0.5, 1.0]


@pytest.mark.parametrize("held_case", [0, 1])
def test_another_holds_a_case(study_of, stored, held_case):
    """A case locked by another process is waited for, not computed twice.

    If it is the first case, the next case reports the fields that stages read.
    """
    albedo = {"path": "coating.base_albedo", "values": [0.1, 0.2]}
    store, cases = stored(study_of(albedo))
    context = multiprocessing.get_context("forkserver")
    held, release, states = context.Event(), context.Event(), []
    digest = cases[held_case].digest
    holder = context.Process(target=_hold, args=(store.folder, digest, held, release))
    holder.start()
    held.wait()

    def look(reports):
        states.extend(report.state for report in reports if report.digest == digest)
        if "elsewhere" in states:
            release.set()

    run = Run(store, local_workers(1), make_measurer=synthetic.Fake, done=look)
    outcome = run(cases)
    release.set()
    holder.join()
    assert outcome.states == {"done": 2}
    assert set(states[:-1]) == {"elsewhere"}
    assert states[-1] == "done"
    assert run._reads == synthetic.Fake().reads()


def _hold(folder, digest, held, release):
    with Store(folder).claimed(digest) as mine:
        assert mine
        held.set()
        release.wait()


def test_workers_end_with_their_run(two_axes, stored):
    """kill -9 of a run while its worker computes: it ends too, without a message."""
    store, _ = stored(two_axes)
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tests.study.synthetic"])
    pids = context.Queue()
    run = context.Process(target=synthetic.run_slowly, args=(store.folder, pids))
    run.start()
    workers = pids.get(timeout=60)
    run.kill()
    run.join()
    until = time.monotonic() + 60
    while any(map(_is_running, workers)) and time.monotonic() < until:
        time.sleep(0.05)
    assert workers
    assert not any(map(_is_running, workers))


def _is_running(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_a_run_in_this_process_leaves_the_renderers_threads(mi, tmp_path):
    """One worker is this process, with the caller's number of threads."""
    import drjit as dr

    before = dr.thread_count()
    dr.set_thread_count(before + 1)
    try:
        compute(Batch(tmp_path, ()))
        assert dr.thread_count() == before + 1
    finally:
        dr.set_thread_count(before)
