"""The command line starts fast: modules that only one command needs are imported inside it."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
HEAVY = ("mitsuba", "drjit", "scipy", "xarray", "trimesh", "matplotlib", "skfem", "numba", "cv2")
SHOW_HELP = """
import sys
from twin.cli import run
assert not run(["--help"])
"""


def run_python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )


def test_help_imports_few_modules():
    """Imports are nearly all of its time: 321 modules, 20 of them ours, take 0.2 s."""
    ended = run_python(f"{SHOW_HELP}\nprint(*sys.modules)")
    assert ended.returncode == 0, ended.stderr
    modules = ended.stdout.splitlines()[-1].split()
    assert len(modules) < 420
    assert sum(name.partition(".")[0] in ("twin", "reconstruction") for name in modules) < 25


def test_help_imports_no_heavy_module():
    code = f"{SHOW_HELP}\nprint('heavy:', [name for name in {HEAVY} if name in sys.modules])"
    assert run_python(code).stdout.splitlines()[-1] == "heavy: []"


def test_a_dry_run_imports_only_needed_modules(tmp_path):
    """33 % of its time was the import of statistics, which a grid of two cases does not use."""
    (tmp_path / "study.toml").write_text(
        'name = "two"\nbase = "examples/slab_ball"\n'
        '[[axis]]\npath = "coating.base_albedo"\nvalues = [0.3, 0.5]\n'
    )
    line = ["sweep", str(tmp_path / "study.toml"), "--dry-run", "-o", str(tmp_path / "out")]
    ended = run_python(
        f"import sys\nfrom twin.cli import run\nassert run({line}) == 0\nprint(*sys.modules)"
    )
    assert ended.returncode == 0, ended.stderr
    modules = set(ended.stdout.split())
    assert "twin.study.sweep" in modules
    heavy = ("scipy.stats", "mitsuba", "drjit", "matplotlib", "xarray", "skfem", "optuna")
    assert modules.isdisjoint(heavy), modules & set(heavy)


def test_a_reconstruction_imports_only_needed_modules():
    """50 % of its start time was the import of modules that press, fit and draw."""
    ended = run_python("import sys\nimport twin.pipeline.captures\nprint(*sys.modules)")
    assert ended.returncode == 0, ended.stderr
    modules = set(ended.stdout.split())
    heavy = ("scipy.optimize", "scipy.ndimage", "matplotlib", "trimesh", "skfem", "mitsuba")
    assert modules.isdisjoint(heavy), modules & set(heavy)
