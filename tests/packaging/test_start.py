"""The command line starts fast: heavy packages are imported inside commands."""

import resource
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
HEAVY = ("mitsuba", "drjit", "scipy", "xarray", "trimesh", "matplotlib", "skfem", "numba", "cv2")
SHOW_HELP = """
import sys
from twin.cli import main
sys.argv = ["twin", "--help"]
try:
    main()
except SystemExit as end:
    assert not end.code, end.code
"""


def run_python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )


def processor_seconds_of_help() -> float:
    """User and system time: the wall clock tells how busy the machine is besides."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    ended = run_python(SHOW_HELP)
    assert ended.returncode == 0, ended.stderr
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def test_help_takes_less_than_half_a_second():
    # The best of several, since other work on the machine only ever adds; ends with the first good.
    assert any(processor_seconds_of_help() < 0.5 for _ in range(12))


def test_help_imports_nothing_heavy():
    code = f"{SHOW_HELP}\nprint('heavy:', [name for name in {HEAVY} if name in sys.modules])"
    assert run_python(code).stdout.splitlines()[-1] == "heavy: []"
