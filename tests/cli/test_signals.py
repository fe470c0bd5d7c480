"""A signal ends every command at work: in time, with its exit code, in one line."""

import os
import signal
import subprocess
import sys
import time
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
# With two processes a command reports its first case when it is done: few pixels.
FILES = {
    "BALL": """name = "ball"
use = "scenes/examples/slab_ball"
[camera]
binning = 4
width_px = 480
height_px = 360
[press]
solver_pitch_mm = 0.4
relief_pitch_mm = 0.05
""",
    "STUDY": """name = "two"
base = "./BALL.toml"
[[axis]]
path = "camera.binning"
values = [2, 4]
""",
    "PROBLEM": """name = "few"
use = "scenes/problems/slab"
[experiments.balls]
base = "./BALL.toml"
""",
}
COMMANDS = {
    "press": ["BALL"],
    "render": ["BALL"],
    "measure": ["BALL"],
    "demo": [],
    "compare": ["BALL", "--methods", "contact_fpp"],
    "reconstruct": [str(ROOT / "docs" / "example_capture")],
    "calibrate": ["BALL"],
    "sweep": ["STUDY", "-j", "2"],
    "uncertainty": ["BALL", "-n", "2", "-j", "2", "--no-budget", "--calibration", "true"],
    "paper": ["--only", "hardness", "--trials", "2", "--workers", "2"],
    "identify": ["PROBLEM", "--quick", "-j", "2"],
}
_GOES_ON = ("compare", "sweep", "uncertainty", "paper", "identify")


def test_the_answer_comes_within_two_seconds():
    """The call may continue for that time; afterwards only a folder has to be removed."""
    assert SIGNAL_DELAY_S < 1.5


@pytest.mark.parametrize("command", COMMANDS)
def test_an_interrupted_command_prints_one_line_and_leaves_no_files(tmp_path, command):
    for name, text in FILES.items():
        (tmp_path / f"{name}.toml").write_text(text)
    files = {name: str(tmp_path / f"{name}.toml") for name in FILES}
    arguments = [files.get(item, item) for item in COMMANDS[command]]
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
while True:
    try:
        print("busy", flush=True)
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


# A process starts a mesher and is killed; the mesher runs native code for ever.
PARENT = """
import os, signal, subprocess, sys
child = "import hashlib, os\\n"
child += "from twin.mechanics.reference.tetwild_child import end_with_parent\\n"
child += "end_with_parent(); print(os.getpid(), flush=True)\\n"
child += "hashlib.pbkdf2_hmac('sha512', b'', b'', 2_000_000_000)"
mesher = subprocess.Popen([sys.executable, "-c", child], stdout=subprocess.PIPE, text=True)
print(mesher.stdout.readline(), flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux ends a child with its parent")
def test_a_mesher_ends_with_its_parent():
    line = [sys.executable, "-c", PARENT]
    ended = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=False)
    mesher = int(ended.stdout)
    for _ in range(1000):
        if not is_running(mesher):
            return
        time.sleep(0.02)
    os.kill(mesher, signal.SIGKILL)
    pytest.fail("the mesher is still running")


def is_running(process: int) -> bool:
    """Return False for an ended process, also if its exit status was not read yet."""
    try:
        stat = Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"
