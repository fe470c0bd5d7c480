"""Without the modules of POSIX systems, all modules are imported and a short run works.

On Linux, with those modules and functions hidden (`windows`): no test ran on Windows or macOS.
"""

import ast
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.packaging.windows import MODULES
from twin import locks

ROOT = Path(__file__).parents[2]
COARSE = ("-s", "press.solver_pitch_mm=0.4", "-s", "press.relief_pitch_mm=0.05")
STUDY = """
name = "two"
base = "examples/slab_ball"
set.camera.binning = 4
set.camera.width_px = 640
set.camera.height_px = 480
set.press.relief_pitch_mm = 0.05
set.patterns.steps = 4
[[axis]]
path = "coating.base_albedo"
values = [0.5, 0.6]
"""


def elsewhere(folder: Path, *arguments: str) -> str:
    """Run `windows` in a folder; return its output."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.packaging.windows", *arguments],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert "Traceback" not in done.stderr, done.stderr
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_module_is_imported(tmp_path):
    assert int(elsewhere(tmp_path, "import").split()[0]) > 300


def test_the_first_commands(tmp_path):
    elsewhere(tmp_path, "twin", "init", "mine.toml")
    assert (tmp_path / "mine.toml").is_file()
    assert "camera.exposure_ms" in elsewhere(tmp_path, "twin", "keys", "exposure_ms")


def test_a_press(tmp_path):
    line = ["press", "examples/slab_ball", *COARSE, "-o", "out"]
    elsewhere(tmp_path, "twin", *line)
    assert json.loads((tmp_path / "out/result.json").read_text())["metrics"]["force_n"] > 0
    assert not list(tmp_path.glob(".*"))


def test_a_sweep_in_one_process(tmp_path):
    (tmp_path / "two.toml").write_text(STUDY)
    elsewhere(tmp_path, "twin", "sweep", "two.toml", "-o", "out", "-j", "1")
    assert len(list((tmp_path / "out/cases").iterdir())) == 2
    elsewhere(tmp_path, "twin", "sweep", "two.toml", "-o", "out", "-j", "1")


def outer_imports(tree: ast.AST) -> Iterator[str]:
    """Yield the modules that the import of a file imports, in any block outside functions."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or ""
        elif not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield from outer_imports(node)


def test_no_module_imports_posix_modules():
    named = re.compile(rf"\b({'|'.join(MODULES)})\b")  # other files are not parsed
    texts = {
        path: path.read_text(encoding="utf-8")
        for package in ("twin", "reconstruction")
        for path in (ROOT / package).rglob("*.py")
    }
    imports = {
        path.relative_to(ROOT).as_posix(): set(outer_imports(ast.parse(text)))
        for path, text in texts.items()
        if named.search(text)
    }
    assert imports
    assert {path for path, names in imports.items() if names & set(MODULES)} == set()


LOCKING = """
import os, sys
from twin import locks
handle = os.open(sys.argv[1], os.O_RDWR)
print(locks.lock_byte(handle, 3), locks.lock_byte(handle, 4))
"""


def in_another(path: Path) -> str:
    done = subprocess.run(
        [sys.executable, "-c", LOCKING, path], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


@pytest.mark.parametrize("system", ["posix", "windows"])
def test_a_byte_is_locked_for_other_processes(tmp_path, monkeypatch, system):
    """Of the same system: POSIX and the imitated Windows count bytes up to different numbers."""
    if system == "windows":
        from tests.packaging.windows import imitated

        monkeypatch.setattr(locks, "_MSVCRT", imitated())
        monkeypatch.setattr(locks, "_FCNTL", None)
    path = tmp_path / "locks"
    path.write_bytes(b"content")
    handle = os.open(path, os.O_RDWR)
    try:
        assert locks.lock_byte(handle, 3)
        assert os.lseek(handle, 0, os.SEEK_CUR) == 0
        assert in_another(path) == "False True"
        locks.unlock_byte(handle, 3)
        assert in_another(path) == "True True"
    finally:
        os.close(handle)


def test_a_platform_without_locks_raises(tmp_path, monkeypatch):
    """OSError, as of a file system without locks, which every caller is ready for."""
    monkeypatch.setattr(locks, "_FCNTL", None)
    monkeypatch.setattr(locks, "_MSVCRT", None)
    with pytest.raises(OSError, match="not supported"):
        locks.lock_byte(0, 3)
    with pytest.raises(OSError, match="not supported"), locks.locked_folder(tmp_path, shared=True):
        pass
