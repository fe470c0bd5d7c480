"""A signal ends every command at work: in time, with its exit code, in one line."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from twin.cli import SIGNAL_DELAY_S

ROOT = Path(__file__).parents[2]
# The first stage that the command reports is a call of many minutes, as into a solver.
AT_WORK = """
import hashlib, sys
from contextlib import contextmanager
from twin.cli import calibration, captures, forward, inverse, main, studies

def call(stage, share):
    print("busy", flush=True)
    hashlib.pbkdf2_hmac("sha512", b"", b"", 2_000_000_000)

@contextmanager
def progress_bars():
    yield call

for module in (calibration, captures, forward, inverse, studies):
    module.progress_bars = progress_bars
main()
"""
BALL = "examples/slab_ball"
COMMANDS = {
    "press": [BALL],
    "render": [BALL],
    "measure": [BALL],
    "demo": [],
    "compare": [BALL, "--methods", "contact_fpp"],
    "reconstruct": [str(ROOT / "docs" / "example_capture")],
    "calibrate": [BALL],
    "sweep": ["STUDY", "-j", "2"],
    "uncertainty": [BALL, "-n", "2", "-j", "2", "--no-budget", "--calibration", "true"],
    "paper": ["--only", "hardness", "--trials", "2", "--workers", "2"],
    "identify": ["problems/slab", "--quick", "-j", "2"],
}
_GOES_ON = ("compare", "sweep", "uncertainty", "paper", "identify")


def test_the_answer_comes_within_two_seconds():
    """The call may continue for that time; afterwards only a folder has to be removed."""
    assert SIGNAL_DELAY_S < 1.5


@pytest.mark.parametrize("command", COMMANDS)
def test_an_interrupted_command_prints_one_line_and_leaves_no_files(tmp_path, command):
    study = tmp_path / "study.toml"
    study.write_text(
        f'name = "two"\nbase = "{BALL}"\n[[axis]]\npath = "camera.binning"\nvalues = [2, 4]\n'
    )
    arguments = [str(study) if item == "STUDY" else item for item in COMMANDS[command]]
    place = tmp_path / "place"
    place.mkdir()
    line = [command, *arguments, "-o", str(place / "out")]
    with subprocess.Popen(
        [sys.executable, "-c", AT_WORK, *line],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as child:
        assert child.stdout
        first = child.stdout.readline()
        child.send_signal(signal.SIGINT)
        try:
            _, message = child.communicate(timeout=60)
        finally:
            child.kill()
    assert first == "busy\n", message
    assert child.returncode == 128 + signal.SIGINT
    assert message.splitlines()[-1] == "twin: ended by SIGINT; no incomplete files remain"
    assert message.count("twin: ended") == 1
    assert "Traceback" not in message
    assert not list(place.rglob("*.part"))
    if command not in _GOES_ON:
        assert list(place.iterdir()) == []
