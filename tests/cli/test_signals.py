"""A signal ends every command at work: in time, with its exit code, in one line."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from twin.cli import SIGNAL_DELAY_S
from twin.study.workers import local_workers

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


# The main thread catches everything, as the imports of some packages do, and imports the module
# that lists the children.
CAUGHT = """
import sys, time, types
from twin.working import end_within, unwind_on_signals
end_within(0.05)
unwind_on_signals()
sys.modules["multiprocessing"] = types.ModuleType("multiprocessing")
print("busy", flush=True)
while True:
    try:
        time.sleep(60)
    except BaseException:
        pass
"""
# A signal arrives in the import of the first package that takes long.
AT_IMPORT = """
import os, sys
from importlib.abc import MetaPathFinder
from twin.cli import main

class Finder(MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == "cyclopts":
            os.kill(os.getpid(), {number})
            sum(range(10**8))  # until the signal arrives

sys.meta_path.insert(0, Finder())
main()
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_process_ends_although_its_main_thread_catches_the_exception(number):
    with subprocess.Popen(
        [sys.executable, "-c", CAUGHT], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as child:
        try:
            assert child.stdout
            assert child.stdout.readline() == b"busy\n"
            child.send_signal(number)
            _, message = child.communicate(timeout=60)
        finally:
            child.kill()
    assert child.returncode == 128 + number
    assert message.decode() == f"twin: ended by {number.name}; no incomplete files remain\n"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_while_packages_are_imported_prints_one_line(number):
    line = [sys.executable, "-c", AT_IMPORT.format(number=int(number)), "keys"]
    ended = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=False)
    assert ended.returncode == 128 + number
    assert ended.stderr == f"twin: ended by {number.name}; no incomplete files remain\n"


def test_a_stopped_worker_ends_with_an_interrupted_run():
    """SIGTERM has no effect on it until it continues."""
    workers = local_workers(1, cores=1).open()
    worker = workers.submit(os.getpid).result()
    os.kill(worker, signal.SIGSTOP)
    try:
        raise KeyboardInterrupt
    except KeyboardInterrupt:
        workers.shutdown()
    with pytest.raises(ProcessLookupError):
        os.kill(worker, 0)
