"""Compiled kernels on disk: a damaged file is compiled again, and a pipe is not opened."""

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


def _truncate(content: bytes) -> bytes:
    return content[: len(content) // 2]


def _flip(content: bytes) -> bytes:
    at = len(content) // 2
    return content[:at] + bytes([content[at] ^ 16]) + content[at + 1 :]


DAMAGES = {"cut": _truncate, "empty": lambda _: b"", "flipped": _flip, "text": lambda _: b"hello"}


@pytest.mark.parametrize("kind", ["nbi", "nbc"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_kernel_is_compiled_again(
    module: dict, tmp_path: Path, kind: str, damage: str
) -> None:
    """Numba reads such files with pickle, which raised errors of many kinds."""
    assert compile_and_keep(module["twice"], {}, "digest")(2) == 4
    (stored,) = (tmp_path / "cache").rglob(f"*.{kind}")
    intact = stored.read_bytes()
    stored.write_bytes(DAMAGES[damage](intact))
    again = compile_and_keep(module["twice"], {}, "digest")
    assert again(2) == 4
    assert sum(again.stats.cache_misses.values()) == 1
    kept = compile_and_keep(module["twice"], {}, "digest")
    assert kept(2) == 4
    assert sum(kept.stats.cache_hits.values()) == 1


@pytest.mark.parametrize("kind", ["nbi", "nbc"])
def test_a_folder_in_place_of_a_kernel_costs_a_compilation(
    module: dict, tmp_path: Path, kind: str
) -> None:
    assert compile_and_keep(module["twice"], {}, "digest")(2) == 4
    (stored,) = (tmp_path / "cache").rglob(f"*.{kind}")
    stored.unlink()
    stored.mkdir()
    assert compile_and_keep(module["twice"], {}, "digest")(2) == 4
