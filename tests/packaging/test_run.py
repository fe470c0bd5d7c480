"""The front door `./run`, with a replacement of Python, so that there is no download."""

import os
import shutil
import subprocess
import time
import tomllib
from collections.abc import Callable
from itertools import chain
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
# Notes each call; `-m venv` makes an environment with this script as Python.
STAND_IN = """#!/bin/sh
printf '%s\\n' "$*" >>"$CALLS"
case $* in
    *"-m venv"*)
        for folder; do :; done
        mkdir -p "$folder/bin"
        cp "$0" "$folder/bin/python"
        printf '#!/bin/sh\\necho "twin $*"\\npwd\\n' >"$folder/bin/twin"
        for tool in ruff mypy lint-imports; do
            printf '#!/bin/sh\\necho "%s $*" >>"$CALLS"\\n' "$tool" >"$folder/bin/$tool"
        done
        chmod +x "$folder/bin/"*
        ;;
    *requirements.lock*) sleep "${SLOW:-0}"; exit "${PIP_STATUS:-0}" ;;
    *twin.optics.backend*) echo "llvm_ad_mono, LLVM 19" ;;
    *benchmarks/*) echo '{"seconds": 1}' ;;
esac
"""


class Checkout:
    """A checkout with the real `run` in a path with spaces."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "a check out"
        (self.root / "benchmarks").mkdir(parents=True)
        for name in ("run", "pyproject.toml", "requirements.lock"):
            shutil.copy2(ROOT / name, self.root)
        for name in ("stack", "_shared"):
            (self.root / "benchmarks" / f"{name}.py").write_text("")
        self.calls_file = folder / "calls"
        self.python = folder / "python"
        self.python.write_text(STAND_IN)
        self.python.chmod(0o755)

    def start(self, *arguments: str, **environment: str) -> subprocess.Popen[str]:
        own = {"TWIN_PYTHON": str(self.python), "CALLS": str(self.calls_file), "CI": "true"}
        return subprocess.Popen(
            [self.root / "run", *arguments],
            cwd=self.calls_file.parent,
            env={"PATH": os.environ["PATH"]} | own | environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
        process = self.start(*arguments, **environment)
        out, err = process.communicate(timeout=60)
        return subprocess.CompletedProcess(arguments, process.returncode, out, err)

    def count(self, part: str) -> int:
        if not self.calls_file.exists():
            return 0
        return sum(part in call for call in self.calls_file.read_text().splitlines())


def wait_until(condition: Callable[[], bool], seconds: float = 60) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"not so within {seconds} s"
        time.sleep(0.01)


@pytest.fixture
def checkout(tmp_path) -> Checkout:
    return Checkout(tmp_path)


def test_first_call_sets_up_then_runs_where_the_user_is(checkout):
    ended = checkout.run("twin", "press", "my file.toml")
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout == f"twin press my file.toml\n{checkout.calls_file.parent}\n"
    assert [line[:3] for line in ended.stderr.splitlines() if "/5 " in line] == [
        f"{step}/5" for step in (1, 2, 3, 4, 5)
    ]
    assert checkout.count("-m twin.doctor") == 1


def test_second_call_starts_at_once(checkout):
    checkout.run("demo")
    calls = checkout.calls_file.read_text()
    ended = checkout.run("demo", "--full")
    assert ended.stdout.startswith("twin demo --full\n")
    assert ended.stderr == ""
    assert checkout.calls_file.read_text() == calls


def test_failed_set_up_is_one_line_and_not_taken_for_finished(checkout):
    ended = checkout.run("demo", PIP_STATUS="1")
    assert ended.returncode == 3
    assert ended.stdout == ""
    assert ended.stderr.splitlines()[-1].startswith("run: pip could not install requirements.lock")
    assert checkout.run("demo").returncode == 0
    assert checkout.count("-m venv") == 2


def test_interrupted_set_up_is_not_taken_for_finished(checkout):
    process = checkout.start("setup", SLOW="3")
    # The note of the replacement, not the message of `run`, which is printed before pip starts.
    wait_until(lambda: checkout.count("requirements.lock") == 1)
    process.terminate()
    process.communicate(timeout=60)
    assert process.returncode == 130
    assert checkout.run("demo").returncode == 0
    assert checkout.count("requirements.lock") == 2


def test_two_set_ups_at_once_do_the_work_once(checkout):
    both = [checkout.start("demo", SLOW="1") for _ in range(2)]
    ends = [process.communicate(timeout=60) for process in both]
    assert [process.returncode for process in both] == [0, 0], ends
    assert checkout.count("requirements.lock") == 1


def test_new_lock_file_means_a_new_environment(checkout):
    checkout.run("setup")
    with (checkout.root / "requirements.lock").open("a") as lock:
        lock.write("# changed\n")
    checkout.run("demo")
    assert checkout.count("-m venv") == 2


def test_new_project_file_keeps_the_environment(checkout):
    checkout.run("setup")
    with (checkout.root / "pyproject.toml").open("a") as project:
        project.write("# changed\n")
    checkout.run("demo")
    assert checkout.count("-m venv") == 1
    assert checkout.count("--no-deps") == 2


def test_moved_checkout_is_set_up_again(checkout):
    checkout.run("setup")
    checkout.root = checkout.root.rename(checkout.root.with_name("moved"))
    assert checkout.run("demo").returncode == 0
    assert checkout.count("-m venv") == 2


def test_set_up_looks_for_the_backend_afresh(checkout):
    checkout.run("setup")
    checkout.run("setup")
    assert checkout.count("twin.optics.backend --fresh") == 2
    assert checkout.count("-m venv") == 1


def test_checks_come_before_pytest_which_gets_the_arguments(checkout):
    ended = checkout.run("test", "--quick", "tests/a b")
    assert ended.returncode == 0, ended.stderr
    calls = checkout.calls_file.read_text().splitlines()
    assert calls[-5:] == [
        "ruff check .",
        "ruff format --check .",
        "mypy ",
        "lint-imports ",
        "-m pytest -n auto --maxprocesses 4 --dist loadfile --quick tests/a b",
    ]


def test_quick_is_passed_on(checkout):
    assert "--quick" in checkout.run("help").stdout.split("  test ")[1].split("  bench ")[0]


def test_benchmark_result_is_the_last_line_of_stdout(checkout):
    ended = checkout.run("bench", "stack", "--quick")
    assert ended.stdout == '{"seconds": 1}\n'
    assert checkout.count("benchmarks/stack.py --quick") == 1


@pytest.mark.parametrize("name", ["absent", "_shared", "../run", ""])
def test_unknown_benchmark_lists_the_known_ones(checkout, name):
    ended = checkout.run("bench", name)
    assert ended.returncode == 2
    assert ended.stderr == f"run: no benchmark '{name}', there are: stack\n"


def test_unknown_command_shows_the_usage(checkout):
    ended = checkout.run("demmo")
    assert ended.returncode == 2
    assert "usage: ./run" in ended.stderr
    assert ended.stderr.splitlines()[-1] == "run: unknown command 'demmo'"


def test_help_needs_no_set_up(checkout):
    assert "usage: ./run" in checkout.run("help").stdout
    assert not checkout.calls_file.exists()


def test_an_environment_of_another_checkout_is_not_emptied(checkout, tmp_path):
    package = tmp_path / "other" / "package"
    package.mkdir(parents=True)
    (checkout.root / ".venv").symlink_to(package.parent)
    ended = checkout.run("demo")
    assert ended.returncode == 2
    assert ".venv is a link" in ended.stderr
    assert package.exists()
    assert checkout.count("-m venv") == 0


def test_python_that_does_not_work_is_reported(checkout):
    ended = checkout.run("demo", TWIN_PYTHON="/absent/python")
    assert ended.returncode == 3
    assert "no Python 3.11 or newer found at TWIN_PYTHON=/absent/python" in ended.stderr


def test_lock_file_has_every_requirement_of_the_project():
    """With a version that pyproject.toml allows: those of the extras, too."""
    lines = (ROOT / "requirements.lock").read_text().splitlines()
    pins = dict(line.partition("; ")[0].split("==") for line in lines if not line.startswith("#"))
    versions = {canonicalize_name(name): version for name, version in pins.items()}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"].values()
    for line in (*project["dependencies"], *chain(*extras)):
        requirement = Requirement(line)
        assert versions[canonicalize_name(requirement.name)] in requirement.specifier, line


def test_lock_file_holds_versions_only():
    lines = (ROOT / "requirements.lock").read_text().splitlines()
    pins = [line for line in lines if not line.startswith("#")]
    assert pins
    versions, markers = zip(*(pin.partition("; ")[::2] for pin in pins), strict=True)
    assert all(pin.count("==") == 1 and "/" not in pin and " " not in pin for pin in versions)
    assert set(markers) <= {"", 'platform_machine == "x86_64"'}
