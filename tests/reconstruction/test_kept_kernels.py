"""Compiled kernels on disk: a pipe in the place of a file is not opened."""

import os
from pathlib import Path

import numba
import pytest

from reconstruction.compiling import compile_and_keep
from tests.endless import not_for_ever

_SOURCE = "def twice(x):\n    return 2 * x\n"


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict:
    """A module with a function and a cache folder of its own."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    file = tmp_path / "kernels.py"
    file.write_text(_SOURCE)
    names: dict = {"__name__": "kernels", "__file__": str(file)}
    exec(compile(_SOURCE, str(file), "exec"), names)
    return names


@pytest.mark.parametrize("kind", ["nbi", "nbc"])
def test_a_pipe_in_place_of_a_kernel_is_replaced(module: dict, tmp_path: Path, kind: str) -> None:
    """It was opened, and waited for its writer."""
    assert compile_and_keep(module["twice"], {}, "digest")(2) == 4
    (stored,) = (tmp_path / "cache").rglob(f"*.{kind}")
    stored.unlink()
    os.mkfifo(stored)
    with not_for_ever():
        assert compile_and_keep(module["twice"], {}, "digest")(2) == 4
    assert stored.is_file()
