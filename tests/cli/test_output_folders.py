"""Output folders of commands: no file of the user is removed."""

import hashlib
import os
import shutil
import subprocess

import pytest

from reconstruction.errors import InputError
from tests.cli.result_folder import CAPTURE, contents, refusal, write
from twin.cli import run
from twin.output import adding, alone_in, claim, claimed, output_folder


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


def test_an_error_before_the_first_file_leaves_no_claimed_folder(tmp_path):
    """Expected: new folders and the manifest go; an own empty folder and added files stay."""
    (tmp_path / "mine").mkdir()
    for out in (tmp_path / "new" / "out", tmp_path / "mine"):
        with pytest.raises(InputError, match="stop"), claimed(out, "scan", ()):
            raise InputError("stop")
    assert contents(tmp_path) == {"mine": None}
    used = tmp_path / "used"
    with claimed(used, "scan", ()), adding(used, "map") as folder:
        (folder / "map").write_text("1")
    with pytest.raises(InputError, match="stop"), claimed(used, "scan", ["map"]):
        raise InputError("stop")
    assert (used / "map").read_text() == "1"
    claim(used, "scan", ["map"])
