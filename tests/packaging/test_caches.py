"""Caches of compiled code: named with their sizes, cleared by a command, sound if damaged."""

import os
import subprocess
import sys
from collections.abc import Callable
from itertools import cycle
from pathlib import Path

import pytest

from twin import doctor
from twin.caches import CLEAR, CodeCache, caches
from twin.cli import run
from twin.optics.backend import find_backend


def lose_the_end(file: Path) -> None:
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def change_bits(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[len(content) // 3] ^= 0xFF
    file.write_bytes(content)


def become_a_folder(file: Path) -> None:
    file.unlink()
    file.mkdir()


def become_a_pipe(file: Path) -> None:
    file.unlink()
    os.mkfifo(file)


DAMAGES: tuple[Callable[[Path], None], ...] = (
    lose_the_end,
    change_bits,
    become_a_folder,
    become_a_pipe,
    lambda file: file.write_bytes(b"") and None,
)


@pytest.fixture
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder of all caches, with a file of each and files of others."""
    for variable in ("NUMBA_CACHE_DIR", "DRJIT_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.setenv(variable, str(tmp_path / variable))
    monkeypatch.setattr("twin.caches._PACKAGES", (tmp_path / "package",))
    for name in (
        "package/rows.py",
        "package/__pycache__/rows.sum-3.py311.nbi",
        "package/__pycache__/rows.cpython-311.pyc",
        "DRJIT_CACHE_DIR/0011.llvm.v6.bin",
        "DRJIT_CACHE_DIR/notes.txt",
        "XDG_CACHE_HOME/fringe-twin/backend.json",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("1234")
    return tmp_path


def test_each_cache_has_its_size_and_the_command_that_clears_it(in_folder: Path) -> None:
    assert [(cache.size_bytes(), len(list(cache.files()))) for cache in caches()] == [(4, 1)] * 3
    findings = {finding.name: finding for finding in doctor._caches()}
    for cache in caches():
        assert findings[cache.name].ok
        assert "1 files" in findings[cache.name].detail
        assert CLEAR in findings[cache.name].detail
    assert str(in_folder / "DRJIT_CACHE_DIR") in findings["dr.jit cache"].detail


def test_the_command_clears_the_caches_only(
    in_folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(doctor, "diagnose", list)
    assert run(["doctor", "--clear"]) == 0
    assert capsys.readouterr().out.count(": 1 files removed") == 3
    left = {path.name for path in in_folder.rglob("*") if path.is_file()}
    assert left == {"rows.py", "rows.cpython-311.pyc", "notes.txt"}


def test_folders_of_another_user_are_reported(
    in_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The code in a cache is executed, so whoever may write there may run programs as this user."""
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    monkeypatch.setattr("twin.caches._owner", lambda folder: 1001)
    cache = CodeCache("dr.jit cache", (in_folder,), ("*",))
    finding = doctor._cache(cache)
    assert not finding.ok
    assert "belongs to another user" in finding.detail


def test_damaged_kernels_of_the_renderer_are_compiled_again(tmp_path: Path, mi: object) -> None:
    backend = find_backend()
    environment = os.environ | {"DRJIT_CACHE_DIR": str(tmp_path)}
    if backend.library:
        environment["DRJIT_LIBLLVM_PATH"] = backend.library

    def computed() -> str:
        line = [sys.executable, "-m", "twin.optics.backend_kernels", backend.variant]
        return subprocess.run(
            line, env=environment, capture_output=True, text=True, check=True
        ).stdout

    sound = computed()
    files = sorted(tmp_path.glob("*.bin"))
    assert len(files) >= len(DAMAGES)
    for file, damage in zip(files, cycle(DAMAGES), strict=False):
        damage(file)
    assert computed() == sound
