"""Output folders of commands: no file of the user is removed, no incomplete file remains."""

import errno
import hashlib
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
from twin import output
from twin.cli import run
from twin.output import alone_in, claim, end_exchange, output_folder, write_json

ROOT = Path(__file__).parents[2]
OURS = ("result.json", "twin-manifest.txt")
CAPTURE = ROOT / "docs" / "example_capture"
TWIN = "import sys; from twin.cli import main; main()"
# A reconstruction that has made its working folder and then waits to be ended.
WAITING = """
import time
from twin.cli import main
import twin.pipeline.captures as captures
captures.read_capture = lambda _: time.sleep(60)
main()
"""


def contents(folder):
    """Every entry below a folder with its bytes; None for folders."""
    return {
        str(path.relative_to(folder)): None if path.is_dir() else path.read_bytes()
        for path in sorted(folder.rglob("*"))
    }


def write(target, *, inputs=(), **files):
    with output_folder(target, inputs) as folder:
        for name, text in files.items():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(text)
        write_json(folder / "result.json", {})


def start(program, out):
    command = [sys.executable, "-c", program, "reconstruct", str(CAPTURE), "-o", str(out)]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)


def started(out):
    """A reconstruction that is under way."""
    child = start(WAITING, out)
    while not list(out.parent.rglob("*.part/new")):
        assert child.poll() is None, child.stderr.read()
        time.sleep(0.02)
    return child


def refusal(capsys, *arguments):
    assert run([str(argument) for argument in arguments]) == 2
    message = capsys.readouterr().err.strip().splitlines()
    assert len(message) == 1  # no stage was begun
    return message[0]


def test_a_folder_with_foreign_files_is_kept(tmp_path, capsys):
    """The issue's own command: result.json without a manifest makes no folder ours."""
    out = tmp_path / "B"
    (out / "src" / ".git").mkdir(parents=True)
    (out / "thesis.tex").write_text("x")
    (out / "result.json").write_text("{}")
    before = contents(tmp_path)
    message = refusal(capsys, "reconstruct", CAPTURE, "-o", out)
    assert "no twin-manifest.txt; found result.json" in message
    assert "choose another -o DIR" in message
    assert contents(tmp_path) == before


@pytest.mark.parametrize("harm", ["file", "folder", "edit", "link"])
def test_an_own_folder_is_replaced_only_while_it_is_all_ours(tmp_path, harm):
    out = tmp_path / "out"
    write(out, report="first", old="gone with the next")
    write(out, report="second")
    assert set(contents(out)) == {"report", "result.json", "twin-manifest.txt"}
    if harm == "file":
        (out / "notes.txt").write_text("mine")
    elif harm == "folder":
        (out / ".git").mkdir()
    elif harm == "edit":
        (out / "report").write_text("second, with my remarks")
    else:
        (out / "report").unlink()
        (out / "report").symlink_to(tmp_path)
    before = contents(out)
    named = {"file": r"notes\.txt", "folder": r"\.git", "edit": "report, changed since"}
    with pytest.raises(InputError, match=named.get(harm, "report")):
        write(out, report="third")
    assert contents(out) == before


def test_files_that_appear_meanwhile_are_not_overwritten(tmp_path):
    out = tmp_path / "out"
    write(out, report="first")
    (out.parent / "mine").write_text("mine")

    def compute():
        with output_folder(out) as folder:
            (folder / "notes").write_text("ours")
            (out.parent / "mine").rename(out / "notes")

    with pytest.raises(InputError, match="notes: is in the way"):
        compute()
    assert (out / "notes").read_text() == "mine"
    assert (out / "report").read_text() == "first"


@pytest.mark.parametrize("place", ["at", "above", "inside", "link"])
def test_an_input_is_no_place_for_output(tmp_path, capsys, place):
    capture = tmp_path / "all" / "A"
    shutil.copytree(CAPTURE, capture)
    out = {"at": capture, "above": capture.parent, "inside": capture / "points"}.get(place)
    if out is None:
        out = tmp_path / "link"
        out.symlink_to(capture)
    before = contents(tmp_path)
    message = refusal(capsys, "reconstruct", capture, "-o", out)
    assert f"the input {capture}; choose another -o DIR" in message
    assert contents(tmp_path) == before


def test_a_result_is_not_replaced_by_a_result_made_from_it(tmp_path):
    out = tmp_path / "out"
    write(out, **{"experiment.toml": "name = 'e'"})
    with pytest.raises(InputError, match="holds the input"):
        write(out, inputs=[out / "experiment.toml"])


PLACES = [(".", "is the current"), ("..", "holds the current"), ("~", "is your home"), ("/", "/: ")]


@pytest.mark.parametrize(("out", "named"), PLACES)
def test_here_home_and_root_are_refused(tmp_path, capsys, monkeypatch, out, named):
    """Even where they are a result of ours: whoever is in there loses the ground."""
    here, home = tmp_path / "a" / "here", tmp_path / "home"
    for folder in (here.parent, here, home):
        write(folder)
    monkeypatch.chdir(here)
    monkeypatch.setenv("HOME", str(home))
    before = contents(tmp_path)
    target = home if out == "~" else out
    assert named in refusal(capsys, "reconstruct", CAPTURE, "-o", target)
    assert contents(tmp_path) == before


def test_a_link_is_written_through_and_kept(tmp_path):
    (tmp_path / "disk").mkdir()
    link = tmp_path / "out"
    link.symlink_to("disk")
    number = (tmp_path / "disk").stat().st_ino
    write(link, report="first")
    write(link, report="second")
    assert link.is_symlink()
    assert (tmp_path / "disk").stat().st_ino == number
    assert (link / "report").read_text() == "second"
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["disk", "out"]


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


def test_a_folder_that_grows_has_one_command_at_a_time(tmp_path):
    out = tmp_path / "out"
    claim(out, "compare", ())
    with alone_in(out):
        second = pytest.raises(InputError, match="out: another twin is writing there; wait for it")
        with second, alone_in(out):
            pytest.fail("let in")
    with alone_in(out):
        pass
    assert set(contents(out)) == {"twin-manifest.txt"}


def test_paper_has_its_folder_for_itself(tmp_path, capsys):
    out = tmp_path / "out"
    line = ["paper", "-o", out, "--only", "hardness", "--trials", "2"]
    claim(out, "paper", ())
    with alone_in(out):
        assert "another twin is writing there; wait for it" in refusal(capsys, *line)
    assert set(contents(out)) == {"twin-manifest.txt"}


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


def test_paper_leaves_a_folder_with_a_work_of_others(tmp_path, capsys):
    """The issue's own command: hidden files below work/cases were removed."""
    mine = tmp_path / "P" / "work" / "cases" / "nut" / ".hidden"
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    message = refusal(capsys, "paper", "-o", tmp_path / "P", "--only", "hardness", "--trials", "2")
    assert "is no earlier run of twin paper (no twin-manifest.txt; found work)" in message
    assert set(contents(tmp_path / "P")) == {
        "work", "work/cases", "work/cases/nut", "work/cases/nut/.hidden"
    }  # fmt: skip


def test_folders_of_several_runs_keep_foreign_files(tmp_path):
    from twin.output import adding, claim

    out = tmp_path / "out"
    claim(out, "compare", ["report"])
    (out / "notes").write_text("mine")
    for text in ("first", "second"):
        with adding(out, "report") as folder:
            (folder / "report").write_text(text)
        claim(out, "compare", ["report"])
    assert (out / "report").read_text() == "second"
    with pytest.raises(InputError, match="no earlier run of twin sweep"):
        claim(out, "sweep", [])
    with pytest.raises(InputError, match="belongs to twin compare"):
        write(out)
    (out / "report").write_text("second, with my remarks")
    with pytest.raises(InputError, match=r"report, changed since .* is in the way"):
        claim(out, "compare", ["report"])
    with pytest.raises(InputError, match="in the way"), adding(out, "report"):
        raise AssertionError("computed before it looked")
    assert (out / "report").read_text() == "second, with my remarks"
    assert (out / "notes").read_text() == "mine"


def test_a_report_drawn_again_belongs_to_the_result(tmp_path):
    """Files that are added later are in the manifest too, so the folder can still be replaced."""
    from twin.output import adding

    out = tmp_path / "out"
    write(out, data="1")
    for text in ("first", "second"):
        with adding(out, "figures", "report.html") as folder:
            (folder / "figures").mkdir()
            (folder / "figures" / "map.png").write_text(text)
            (folder / "report.html").write_text(text)
    write(out, data="2")
    assert set(contents(out)) == {"data", "result.json", "twin-manifest.txt"}


def test_the_manifest_has_the_format_of_sha256sum(tmp_path):
    if shutil.which("sha256sum") is None:
        pytest.skip("no sha256sum")
    write(tmp_path / "out", report="text")
    command = ["sha256sum", "--strict", "-c", "twin-manifest.txt"]
    done = subprocess.run(command, cwd=tmp_path / "out", capture_output=True, check=False)
    assert done.returncode == 0, done.stderr


def test_single_files_are_never_overwritten(tmp_path):
    from twin.files import creating

    file = tmp_path / "table.csv"
    with creating(file) as part:
        part.write_text("1")
    with pytest.raises(InputError, match="exists already"), creating(file):
        raise AssertionError("computed before it looked")
    with pytest.raises(InputError, match="cannot be written"), creating(tmp_path / "b.csv") as part:
        part.mkdir() or part.write_text("this is a folder")
    assert contents(tmp_path) == {"table.csv": b"1"}


@pytest.mark.parametrize("command", [["evaluate", "plane"], ["report"], ["reconstruct", "-o"]])
def test_a_pipe_in_place_of_a_folder_is_refused(tmp_path, capsys, command):
    """Nobody ever writes into it: whoever opens it, waits."""
    os.mkfifo(tmp_path / "pipe")
    first, *rest = command
    out = [str(tmp_path / "out")] if "-o" in rest else []
    assert run([first, str(tmp_path / "pipe"), *rest, *out]) == 2
    assert f"{tmp_path / 'pipe'}" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["pipe"]


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


@pytest.mark.parametrize("away", ["../other.txt", "{root}/other.txt"])
def test_a_manifest_with_files_outside_its_folder_removes_none(tmp_path, away):
    further, target = tmp_path / "other.txt", tmp_path / "out"
    further.write_text("of somebody else")
    write(target, first="ours")
    digest = hashlib.sha256(further.read_bytes()).hexdigest()
    with (target / "twin-manifest.txt").open("a") as manifest:
        manifest.write(f"{digest}  {away.format(root=tmp_path)}\n")
    write(target, second="ours")
    assert further.read_text() == "of somebody else"
    assert not (target / "first").exists()
