"""Messages of a command: version, keys, completion, progress; quiet and verbose; and its end."""

import re
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from twin.cli import run
from twin.cli.talk import choose_level, progress_bars

ROOT = Path(__file__).parents[2]
BUSY = """
import hashlib, sys
from pathlib import Path
from twin.cli.app import guarded
from twin.output import output_folder
from twin.working import end_within, unwind_on_signals

def command():
    with output_folder(Path(sys.argv[1])) as folder:
        (folder / "half").write_text("half")
        print("busy", flush=True)
        hashlib.pbkdf2_hmac("sha512", b"", b"", 2_000_000_000)  # many minutes, in one call

unwind_on_signals()
end_within(0.2)
sys.exit(guarded(command))
"""


def test_version_is_that_of_the_project(capsys):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert run(["--version"]) == 0
    assert capsys.readouterr().out.strip() == project["version"]


@pytest.mark.parametrize("columns", [40, 80, 200])
def test_keys_are_wrapped_and_never_cut(capsys, monkeypatch, columns):
    """Every word of allowed values and meaning is there at any width."""
    monkeypatch.setenv("COLUMNS", str(columns))
    assert run(["keys", "tack"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "elastomer.tack_j_m2" in lines
    assert all(len(line) <= max(columns, 40) for line in lines if line.startswith(" "))
    text = " ".join(" ".join(lines).split())
    assert "between clear face and specimen; stick: no slip after contact" in text
    assert "..." not in text
    assert "…" not in text


def test_every_key_is_listed(capsys):
    from twin.config.schema import experiment_keys

    assert run(["keys"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if not line.startswith(" ")] == [
        key.path for key in experiment_keys()
    ]


def test_keys_hold_every_word(capsys):
    assert run(["keys", "camera noise"]) == 0
    paths = [line for line in capsys.readouterr().out.splitlines() if not line.startswith(" ")]
    assert "camera.read_noise_e" in paths
    assert all(path.startswith("camera") for path in paths)


def test_no_key_is_one_line_with_the_nearest(capsys):
    assert run(["keys", "thicknes_mm_"]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "thickness_mm" in message


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_has_commands_and_options(capsys, shell):
    assert run(["completion", shell]) == 0
    script = capsys.readouterr().out
    for word in ("measure", "sweep", "uncertainty", "set"):
        assert word in script


def test_bash_takes_the_completion(capsys, tmp_path):
    run(["completion", "bash"])
    script = tmp_path / "completion.bash"
    script.write_text(capsys.readouterr().out)
    command = f"source {script}; complete -p twin"
    completed = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=True)
    assert completed.stdout.rstrip().endswith("twin")


def test_options_on_talk_may_stand_anywhere():
    assert choose_level(["measure", "-q", "x", "-o", "out"]) == ["measure", "x", "-o", "out"]
    assert choose_level(["-v", "keys", "--", "-q"]) == ["keys", "--", "-q"]
    choose_level([])


@pytest.mark.parametrize(
    ("option", "expected"),
    [("-q", ""), ("", "press ...\n"), ("-v", "press ...\npress took N s\n")],
)
def test_progress_has_the_requested_verbosity(capsys, option, expected):
    choose_level([option])
    try:
        with progress_bars() as watch:
            for fraction in (0.0, 0.5, 1.0):
                watch("press", fraction)
    finally:
        choose_level([])
    assert re.sub(r"\d+\.\d+", "N", capsys.readouterr().err) == expected


def test_a_terminal_shows_percent_and_remaining_time(capsys, monkeypatch):
    """Rich takes this for a terminal."""
    for name, value in (("FORCE_COLOR", "1"), ("TERM", "xterm"), ("COLUMNS", "120")):
        monkeypatch.setenv(name, value)
    with progress_bars() as watch:
        for tenth in range(11):
            watch("render", tenth / 10)
    message = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", capsys.readouterr().err)
    assert re.search(r"render .*100% +\d:\d\d:\d\d left +\d:\d\d:\d\d", message)


def test_verbose_prints_the_traceback_of_a_failure(capsys):
    assert run(["measure", "no/such/experiment", "-o", "out"]) == 2
    assert "Traceback" not in capsys.readouterr().err
    assert run(["measure", "no/such/experiment", "-o", "out", "-v"]) == 2
    message = capsys.readouterr().err
    assert message.startswith("fringe-twin ")
    assert "Traceback" in message
    choose_level([])


def test_who_stops_reading_is_no_failure():
    line = f"{sys.executable} -c 'from twin.cli import main; main()' keys | head -n 1"
    done = subprocess.run(
        ["bash", "-c", f"set -o pipefail; {line}"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stderr == ""
    assert done.returncode in (0, 128 + signal.SIGPIPE)


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_signal_ends_a_command_that_is_in_a_long_call(tmp_path, name):
    """The call would take many minutes; one line, the code of the signal, no files left."""
    child = subprocess.Popen(
        [sys.executable, "-c", BUSY, str(tmp_path / "out")],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert child.stdout
    assert child.stdout.readline() == "busy\n"
    child.send_signal(signal.Signals[name])
    try:
        _, message = child.communicate(timeout=60)
    finally:
        child.kill()
    assert message == f"twin: ended by {name}; no incomplete files remain\n"
    assert child.returncode == 128 + signal.Signals[name]
    assert list(tmp_path.iterdir()) == []
