"""Commands on damaged files and hostile arguments, each in its own process: 8 fixed seeds."""

import json
import random
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks import fuzz_stock
from benchmarks.damage import damaged_bytes
from benchmarks.fuzzing import LIMIT_S, TARGETS, run_case
from twin.cli import run

ROOT = Path(__file__).parents[2]


def test_damage_changes_a_file_and_says_how():
    content = b"a = 1\nb = [1, 2]\nc = 'x'\n" * 20
    faults = {damaged_bytes(content, random.Random(seed))[1] for seed in range(200)}
    changed = sum(damaged_bytes(content, random.Random(seed))[0] != content for seed in range(200))
    assert changed > 190
    names = {part for fault in faults for part in fault.split("+")}
    assert names == {"flip", "cut", "truncate", "double", "token", "zero", "number", "line"}


def _seed_of(target: str) -> int:
    names = (*TARGETS, "arguments")
    return next(seed for seed in range(1000) if random.Random(seed).choice(names) == target)


@pytest.mark.parametrize(
    ("ending", "end"),
    [
        ("raise SystemError('x')", "traceback"),
        ("import faulthandler, os; faulthandler.disable(); os.kill(os.getpid(), 11)", "crash"),
        ("open('fifo').read()", "hang"),
        ("while True: pass", "hang"),
        ("open('kept/canary.txt', 'a').write('x')", "foreign_change"),
        ("import os; os.mkdir('kept/.half')", "partial_output"),
        ("import os; os.mkdir('kept/out')", "partial_output"),
        ("import sys; sys.exit(7)", "exit_code"),
        ("import sys; print('x\\n' * 100, file=sys.stderr); sys.exit(2)", "unreported"),
    ],
)
def test_misbehaviour_is_seen(tmp_path, ending, end):
    """The judge is a test, too: it reports each kind of misbehaviour by its name."""
    stock, scratch = tmp_path / "stock", tmp_path / "case"
    (stock / "kept").mkdir(parents=True)
    scratch.mkdir()
    (stock / "kept" / "canary.txt").write_text("x")
    for name in ("slab.toml", "slab_mesh.toml", "study.toml"):
        (stock / name).write_text("")

    def command(_arguments: list[str]) -> int:
        try:
            exec(ending)
        except SystemExit as error:
            return int(str(error))
        return 0

    limit_s = 0.2 if end == "hang" else LIMIT_S
    result = run_case(_seed_of("arguments"), stock, scratch, command, limit_s)
    assert result.end == end
    assert result.is_bad


@pytest.fixture
def stock(mi, tmp_path, monkeypatch):
    """Sound inputs; the commands that make them run in this process."""
    folder = tmp_path / "stock"
    folder.mkdir()

    def run_here(arguments, **_):
        assert run(arguments[1:]) == 0

    monkeypatch.chdir(folder)
    monkeypatch.setattr(fuzz_stock, "subprocess", SimpleNamespace(run=run_here))
    fuzz_stock.make_stock(folder, Path("twin"))
    return folder


@pytest.mark.filterwarnings("ignore:ImageIO's vendored tifffile:DeprecationWarning")
def test_commands_survive_damaged_input(stock):
    done = subprocess.run(
        # The limit only ends endless cases; the speed of the machine is not tested.
        [
            *(sys.executable, "-m", "benchmarks.fuzz", "--cases", "8", "--limit", "300"),
            *("--stock", str(stock)),
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    result = json.loads(done.stdout.splitlines()[-1])
    bad = {key: value for key, value in result.items() if key.endswith("s") and key != "cases"}
    assert done.returncode == 0, done.stdout
    assert result["cases"] == 8
    assert result["reported"] > 2
    assert not any(bad[name] for name in ("tracebacks", "hangs", "crashes", "partial_outputs"))
    assert not bad["foreign_changes"]
