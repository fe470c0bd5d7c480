"""Environment of a command: variables, limits, folder and streams of the process that starts it."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from twin.cli import run

TWIN = "import sys; from twin.cli import main; main()"
COMMAND = [sys.executable, "-c", TWIN, "init", "--list"]
REJECTED = [
    ("NUMBA_NUM_THREADS", "many"),
    ("NUMBA_NUM_THREADS", "0"),
    ("NUMBA_NUM_THREADS", "-3"),
    ("NUMBA_NUM_THREADS", "²"),
    ("SOURCE_DATE_EPOCH", "today"),
    ("SOURCE_DATE_EPOCH", ""),
]
LIMITS = [
    (resource.RLIMIT_NOFILE, 8, "limit of open files: found 8"),
    (resource.RLIMIT_AS, 2**29, "limit of the address space: found 0.5 GiB"),
]


def start(command: list[str] = COMMAND, **options: object) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(command, capture_output=True, text=True, check=False, **options)


@pytest.mark.parametrize(("name", "value"), REJECTED)
def test_a_variable_that_no_package_can_read_is_named(name: str, value: str) -> None:
    done = start(env=os.environ | {name: value})
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert f"environment variable {name}: found {value!r}" in done.stderr


@pytest.mark.parametrize(("limit", "value", "message"), LIMITS)
def test_a_limit_below_that_of_the_packages_is_named(limit: int, value: int, message: str) -> None:
    done = start(preexec_fn=lambda: resource.setrlimit(limit, (value, value)))
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert message in done.stderr


def test_a_low_limit_of_open_files_is_raised_if_it_may_be() -> None:
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    done = start(preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (8, most)))
    assert done.returncode == 0, done.stderr


def test_the_current_folder_may_be_removed(tmp_path: Path) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    done = start(cwd=gone, preexec_fn=gone.rmdir)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "the current folder was removed" in done.stderr


def test_compilation_may_be_disabled(tmp_path: Path) -> None:
    """Developers disable it to run kernels in a debugger; the press has few and small ones."""
    press = [
        *COMMAND[:3],
        "press",
        "examples/slab_ball",
        *("-s", "press.solver_pitch_mm=0.4", "-s", "press.relief_pitch_mm=0.05"),
        "--no-report",
        "-o",
        str(tmp_path / "out"),
    ]
    done = start(press, env=os.environ | {"NUMBA_DISABLE_JIT": "1"})
    assert done.returncode == 0, done.stderr
    assert "NUMBA_DISABLE_JIT is set" in done.stderr


def test_an_unknown_backend_of_pictures_does_not_matter(tmp_path: Path) -> None:
    """A command draws into files only; Matplotlib rejects the name when it is imported."""
    draw = "from twin.cli.environment import prepare_environment as p; p(); import matplotlib"
    done = start([sys.executable, "-c", draw], env=os.environ | {"MPLBACKEND": "nonsense"})
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("closed", [(1,), (2,), (0, 1, 2)], ids=str)
def test_closed_streams_do_not_change_the_result(tmp_path: Path, closed: tuple[int, ...]) -> None:
    """Expected: the file is complete, without messages that were meant for a stream."""

    def close() -> None:
        for number in closed:
            os.close(number)

    file = tmp_path / "experiment.toml"
    command = [*COMMAND[:3], "init", str(file)]
    done = subprocess.run(command, preexec_fn=close, check=False)
    assert done.returncode == 0
    again = tmp_path / "again.toml"
    assert run(["init", str(again)]) == 0
    assert file.read_bytes() == again.read_bytes()
