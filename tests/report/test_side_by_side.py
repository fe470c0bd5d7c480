"""Figures that a second process draws are those that this one draws, to the last byte."""

import os
import shutil
import signal
import time
from functools import partial

import pytest

from twin.report import side_by_side
from twin.report.measurement import write_report
from twin.report.page import Figure, one_by_one
from twin.report.side_by_side import draw_side_by_side


@pytest.fixture(autouse=True)
def two_cores(monkeypatch):
    monkeypatch.setattr(side_by_side, "threads", lambda: 2)


def figures(draw, count=6):
    return [Figure(f"figure_{n}", "", "", "", draw) for n in range(count)]


def drawn(folder, draw, first_task=lambda: None, count=6):
    """Draw figures that write their process id; return the ids by name and the number of steps."""
    steps = []
    draw_side_by_side(
        figures(draw, count),
        lambda figure: folder / figure.name,
        lambda: steps.append(1),
        first_task=first_task,
    )
    return {path.name: int(path.read_text()) for path in folder.iterdir()}, len(steps)


def note_who(path):
    path.write_text(str(os.getpid()))


def until_another_has_drawn(folder):
    """Return a function that waits until the second process has drawn a figure."""

    def wait():
        while not any(folder.iterdir()):
            time.sleep(0.001)

    return wait


def test_two_processes_write_the_report_of_one_wherever_the_result_lies(finished, tmp_path):
    for name, draw in (("one", one_by_one), ("two", draw_side_by_side)):
        shutil.copytree(finished, tmp_path / name)
        write_report(tmp_path / name, draw=draw)
    one, two = (
        {
            path.relative_to(tmp_path / name).as_posix(): path.read_bytes()
            for path in (tmp_path / name).rglob("*")
            if path.is_file()
        }
        for name in ("one", "two")
    )
    assert one == two
    assert "report.html" in one
    assert not [name for name in one if name.endswith(".part")]


def test_the_second_process_draws_while_something_else_is_done(tmp_path):
    process_ids, steps = drawn(tmp_path, note_who, until_another_has_drawn(tmp_path))
    assert len(process_ids) == steps == 6
    assert set(process_ids.values()) - {os.getpid()}, "the second process drew no figure"


def test_what_fails_in_the_second_process_is_drawn_here(tmp_path):
    here = os.getpid()

    def draw(path):
        if os.getpid() != here:
            raise ValueError("not here")
        note_who(path)

    process_ids, steps = drawn(tmp_path, draw, partial(time.sleep, 0.05))
    assert set(process_ids.values()) == {here}
    assert len(process_ids) == steps == 6


@pytest.fixture
def copies(monkeypatch):
    """Process numbers of the copies that were started."""
    children, fork = [], os.fork

    def noted():
        number = fork()
        children.append(number)
        return number

    monkeypatch.setattr(os, "fork", noted)
    return children


def is_ended(copy):
    """Return True if a child has ended and was waited for."""
    try:
        os.waitpid(copy, os.WNOHANG)
    except ChildProcessError:
        return True
    return False


def test_a_second_process_that_hangs_is_ended(tmp_path, monkeypatch, copies):
    monkeypatch.setattr(side_by_side, "PATIENCE_S", 0.05)
    here = os.getpid()

    def draw(path):
        if os.getpid() != here:
            time.sleep(60)
        note_who(path)

    process_ids, steps = drawn(tmp_path, draw, partial(time.sleep, 0.05))
    assert set(process_ids.values()) == {here}
    assert len(process_ids) == steps == 6
    (copy,) = copies
    assert is_ended(copy)


def test_a_failure_here_ends_the_second_process(tmp_path, copies):
    def fail():
        raise OSError("no room")

    with pytest.raises(OSError, match="no room"):
        drawn(tmp_path, lambda path: time.sleep(60), fail)
    (copy,) = copies
    assert is_ended(copy)


def test_a_signal_to_the_second_process_is_not_ours(tmp_path):
    here, signals = os.getpid(), []
    read, write = os.pipe()
    os.set_blocking(write, False)
    os.set_blocking(read, False)
    before = signal.set_wakeup_fd(write)
    handler = signal.signal(signal.SIGTERM, lambda *_: signals.append(1))

    def draw(path):
        if os.getpid() != here:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(60)
        note_who(path)

    try:
        process_ids, _ = drawn(tmp_path, draw, partial(time.sleep, 0.05))
        assert set(process_ids.values()) == {here}
        assert not signals
        with pytest.raises(BlockingIOError):
            os.read(read, 1)
    finally:
        signal.signal(signal.SIGTERM, handler)
        signal.set_wakeup_fd(before)
        os.close(read)
        os.close(write)


def test_the_second_process_keeps_no_file_of_ours_open(tmp_path):
    here = os.getpid()
    with (tmp_path / "lock").open("w") as lock:
        folder = tmp_path / "figures"
        folder.mkdir()

        def draw(path):
            if os.getpid() != here:
                with pytest.raises(OSError, match="Bad file descriptor"):
                    os.fstat(lock.fileno())
            note_who(path)

        process_ids, _ = drawn(folder, draw, until_another_has_drawn(folder))
    assert set(process_ids.values()) - {here}, "the second process failed"


def test_one_core_draws_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(side_by_side, "threads", lambda: 1)
    process_ids, steps = drawn(tmp_path, note_who)
    assert set(process_ids.values()) == {os.getpid()}
    assert len(process_ids) == steps == 6


def test_nothing_to_draw_is_no_failure(tmp_path):
    assert drawn(tmp_path, note_who, count=0) == ({}, 0)
