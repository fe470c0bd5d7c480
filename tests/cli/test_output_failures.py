"""Failures while a command writes: full disk, signal, kill. No incomplete file remains."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from itertools import count
from pathlib import Path

import pytest

from reconstruction.errors import InputError
from tests.cli.killed import EARLIER, LATER
from tests.cli.result_folder import OURS, ROOT, TWIN, contents, start, started, write
from twin import output
from twin.output import end_exchange, output_folder, write_json


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 400 kB."""
    place = tmp_path / "disk"
    place.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=400k", "tmpfs", str(place)]
    try:
        done = subprocess.run(command, capture_output=True, check=False)
    except FileNotFoundError:
        pytest.skip("no mount command")
    if done.returncode:
        pytest.skip("mounting is not permitted")
    yield place
    subprocess.run(["umount", str(place)], check=True)


def test_a_mount_point_is_a_target_until_it_is_full(small_disk):
    write(small_disk, report="first")
    write(small_disk, report="second")
    assert small_disk.is_mount()
    before = contents(small_disk)
    assert before["report"] == b"second"
    child = start(TWIN, small_disk)
    message = child.communicate()[1].strip().splitlines()
    assert child.returncode == 1
    assert message[-1].startswith(f"twin: {small_disk}: no room left (No space left on device); ")
    assert contents(small_disk) == before


def test_a_full_disk_gives_one_line_and_no_files(tmp_path):
    """No file may be longer than 400 kB: netCDF ended in a segmentation fault then."""
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (400_000, 400_000)); "
    child = start(limit + TWIN, tmp_path / "new" / "deep" / "out")
    message = child.communicate()[1].strip().splitlines()
    assert child.returncode == 1, message
    assert message[-1].startswith(f"twin: {tmp_path / 'new' / 'deep' / 'out'}: no room left")
    assert [line for line in message if not line.endswith("...")] == message[-1:]
    assert list(tmp_path.iterdir()) == []


SECOND = {"report": "second", "data": "second"}


def texts_of(out):
    result = (path for path in out.iterdir() if path.is_file() and path.name not in OURS)
    return {path.name: path.read_text() for path in result}


def failing_at(number, error, monkeypatch):
    """Let the renaming of that number fail, as the system may at any of them."""
    real, calls = Path.replace, []

    def replace(self, target):
        calls.append(self)
        if len(calls) == number:
            raise OSError(error, os.strerror(error), str(self))
        return real(self, target)

    monkeypatch.setattr(Path, "replace", replace)
    return calls


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EPERM])
def test_a_failure_among_renamings_loses_neither_result(tmp_path, monkeypatch, error):
    """The earlier result is whole, or the next command on the folder ends the exchange."""
    out, taken_up = tmp_path / "out", 0
    for number in count(1):
        write(out, report="first", table="first")
        with monkeypatch.context() as patch, suppress(InputError, OSError):
            calls = failing_at(number, error, patch)
            write(out, report="second", data="second")
        at_once = texts_of(out)
        end_exchange(out)
        taken_up += at_once != texts_of(out)
        assert texts_of(out) in ({"report": "first", "table": "first"}, SECOND)
        assert (out / "result.json").exists()
        if len(calls) < number:
            break
    assert texts_of(out) == SECOND
    assert taken_up >= 2
    assert not list(tmp_path.rglob("*.part"))


def test_a_full_disk_before_the_exchange_leaves_the_folder_as_it_was(tmp_path, monkeypatch):
    """Also its manifest; and no folder that the new files need."""
    out, real = tmp_path / "out", output.write_json
    write(out, report="first")
    earlier = contents(out)

    def full(path, content, **rest):
        if path.name.startswith("plan"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        real(path, content, **rest)

    monkeypatch.setattr(output, "write_json", full)
    with pytest.raises(OSError, match="No space left on device"):
        write(out, **{"figures/a": "second"})
    assert contents(out) == earlier


def test_a_working_folder_that_was_removed_is_one_line(tmp_path):
    """Somebody cleaned up while a command was under way."""
    for name in ("new", "there"):
        write(tmp_path / "there", report="first")
        removed = pytest.raises(InputError, match=rf"{name}: its working folder .*part was removed")
        with removed, output_folder(tmp_path / name) as folder:
            shutil.rmtree(folder.parent)
            write_json(folder / "result.json", {})
    assert set(contents(tmp_path)) == {"there", *(f"there/{item}" for item in ("report", *OURS))}


def test_an_error_of_the_disk_is_one_line(tmp_path, monkeypatch):
    """Neither full nor forbidden: input/output error, stale handle. The target is named."""

    def write_bytes(path, *_, **__):
        raise OSError(errno.EIO, os.strerror(errno.EIO), str(path))

    monkeypatch.setattr("reconstruction.writing.write_bytes", write_bytes)
    with pytest.raises(InputError, match=r"out: cannot be written \(Input/output error\)"):
        write(tmp_path / "out", report="first")
    assert not list(tmp_path.iterdir())


def test_another_full_disk_is_not_taken_for_the_target(tmp_path):
    """For instance that of temporary files."""
    with pytest.raises(OSError, match="elsewhere"), output_folder(tmp_path / "out"):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "/elsewhere/file")


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP", "SIGINT"])
def test_a_signal_cleans_up(tmp_path, name):
    number = signal.Signals[name]
    child = started(tmp_path / "out")
    child.send_signal(number)
    message = child.communicate()[1].strip().splitlines()
    assert child.returncode == 128 + number
    assert message[-1] == f"twin: ended by {name}; no incomplete files remain"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("there", [False, True])
def test_the_next_run_removes_leftovers_of_a_killed_run(tmp_path, there):
    """And no file of a running process, by its lock; the lock also has the time of its start."""
    out = tmp_path / "out"
    if there:
        write(out, report="earlier")
    lives = started(out)
    (neighbours,) = list(tmp_path.rglob("*.part"))
    try:
        with pytest.raises(
            InputError, match=r"out: another twin is writing there; wait for it, or"
        ):
            write(out, report="meanwhile")
        write(tmp_path / "other", report="meanwhile")
        assert (neighbours / "new").is_dir()
    finally:
        lives.kill()
        lives.communicate()
    assert neighbours.is_dir()
    (tmp_path / ".out.twin-notes.part").mkdir()
    (tmp_path / ".out.twin-notes.part" / "lock").write_text("my own lock")
    write(out, report="next")
    assert not neighbours.exists()
    assert set(contents(out)) == {"report", "result.json", "twin-manifest.txt"}
    assert (tmp_path / ".out.twin-notes.part" / "lock").read_text() == "my own lock"


def test_interrupted_workers_are_ended_at_once(tmp_path):
    from twin.study.workers import local_workers
    from twin.working import Interrupted

    workers = local_workers(1, cores=1)
    executor = workers.open()
    busy = executor.submit(time.sleep, 60)

    def interrupted():
        try:
            raise Interrupted(signal.SIGTERM)
        finally:
            workers.close(executor)

    with pytest.raises(Interrupted):
        interrupted()
    assert busy.exception() is not None


def test_the_exchange_of_files_is_not_interrupted():
    from twin.working import Interrupted, signals_held, unwind_on_signals

    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    before[signal.SIGINT] = signal.getsignal(signal.SIGINT)
    steps = []

    def exchange():
        with signals_held():
            os.kill(os.getpid(), signal.SIGTERM)
            steps.append("after the signal")

    try:
        unwind_on_signals()
        with pytest.raises(Interrupted, match="SIGTERM"):
            exchange()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert steps == ["after the signal"]


def whole(texts):
    """Files of a result as `tests.cli.killed` writes them."""
    return texts | {"result.json": json.dumps(texts, indent=2, sort_keys=True) + "\n"}


@pytest.mark.parametrize("how", ["new", "replaced", "added"])
def test_killed_at_each_operation_on_files(tmp_path, how):
    """kill -9 before each renaming, removal, new folder and opened file of a run.

    Expected: whoever reads next finds the earlier result or the later one, whole; the next run
    leaves nothing but its own.
    """
    command = [sys.executable, "-m", "tests.cli.killed", how, str(tmp_path / "place")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    result = [json.loads(line) for line in done.stdout.splitlines()]
    earlier = {} if how == "new" else whole(EARLIER)
    later = earlier | LATER if how == "added" else whole(LATER)
    assert [item["read"] for item in result if item["read"] not in (earlier, later)] == []
    assert {tuple(item["left"]) for item in result} == {("out/twin-manifest.txt",)}
    assert [item for item in result if item["read"] == earlier]
    assert [item for item in result if item["read"] == later]
    # Between both there are instants at which only the plan makes it whole.
    mixed = [item for item in result if item["at_once"] != item["read"]]
    assert bool(mixed) == (how != "new")
