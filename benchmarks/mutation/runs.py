"""Run chosen tests in a copy of the tree, in a forked child that has the libraries already.

The copy is made once; a mutant changes one file of it and is undone afterwards, so that the
checkout is never touched. Kernels that a change can reach are compiled anew in the child's memory
and stored nowhere; all others come from the checkout's own store, copied along.
"""

import importlib
import json
import os
import re
import shutil
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

LIBRARIES = (
    "pytest", "numpy", "scipy.optimize", "scipy.ndimage", "scipy.stats",
    "scipy.interpolate", "scipy.sparse.linalg", "scipy.spatial", "numba", "pydantic", "xarray",
    "h5netcdf", "trimesh", "cv2", "imageio.v3", "matplotlib.figure", "cyclopts", "skfem",
    "jinja2", "mitsuba",
)  # fmt: skip
_IGNORED = (".git", ".venv", ".ready", "out", ".ruff_cache", ".mypy_cache", ".pytest_cache",
            ".hypothesis", "*.pyc")  # fmt: skip
_POLL_S = 0.01


@dataclass(frozen=True)
class TestsAsked:
    """What to run.

    Attributes
    ----------
    limit_s : until the child is ended
    chosen : the tests to run, in this order; None: all
    traced : source files whose called functions are told
    anew : modules whose kernels are compiled anew, see `kernels_reached_by`
    """

    files: tuple[str, ...]
    limit_s: float
    chosen: tuple[str, ...] | None = None
    traced: frozenset[str] = frozenset()
    anew: frozenset[str] = frozenset()
    arguments: tuple[str, ...] = ()


@dataclass(frozen=True)
class TestRun:
    """One test: how long it took, and the functions of the tree that it called.

    Attributes
    ----------
    functions : file::qualified name; of a fixture's set-up too
    """

    __test__ = False

    test: str
    passed: bool
    seconds: float
    functions: frozenset[str] = frozenset()


@dataclass(frozen=True)
class SuiteRun:
    """What a child told of its tests.

    Attributes
    ----------
    status : of pytest, or None where the time was up
    said : end of what was printed
    """

    status: int | None
    tests: tuple[TestRun, ...]
    seconds: float
    said: str = field(repr=False, default="")

    @property
    def failed(self) -> str:
        """First test that did not pass; empty where all did."""
        return next((one.test for one in self.tests if not one.passed), "")


def preload() -> None:
    """Import libraries, none of the project, so that a forked child begins at once."""
    for name in LIBRARIES:
        with suppress(ImportError):
            importlib.import_module(name)


@contextmanager
def copied(root: Path, scratch: Path) -> Iterator[Path]:
    """Copy the tree with its stored kernels into a scratch folder."""
    tree = scratch / "tree"
    shutil.copytree(root, tree, ignore=shutil.ignore_patterns(*_IGNORED))
    yield tree
    shutil.rmtree(tree)


@contextmanager
def changed(file: Path, text: str) -> Iterator[None]:
    """Give a file another text for a while."""
    before, times = file.read_bytes(), (file.stat().st_atime_ns, file.stat().st_mtime_ns)
    file.write_text(text, encoding="utf-8")
    try:
        yield
    finally:
        file.write_bytes(before)
        os.utime(file, ns=times)


def run_tests(tree: Path, root: Path, asked: TestsAsked) -> SuiteRun:
    """Run tests in a child; end them when the time is up.

    Parameters
    ----------
    tree, root : the copy that is run, and the checkout, whose kernels are stored
    """
    told, said = tree.parent / "told.jsonl", tree.parent / "said.txt"
    told.unlink(missing_ok=True)
    start = time.monotonic()
    child = os.fork()
    if not child:
        _child(tree, root, asked)
    status = _wait(child, start + asked.limit_s)
    lines = told.read_text(encoding="utf-8").splitlines() if told.exists() else []
    tests = [_test_run(json.loads(line)) for line in lines if line.endswith("}")]
    text = said.read_text(encoding="utf-8", errors="replace")[-4000:] if said.exists() else ""
    return SuiteRun(status, tuple(tests), time.monotonic() - start, text)


def _test_run(line: dict[str, Any]) -> TestRun:
    return TestRun(line["test"], line["passed"], line["seconds"], frozenset(line["functions"]))


def _wait(child: int, end: float) -> int | None:
    """Return the status of a child; None where it had to be ended."""
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            with suppress(ProcessLookupError):  # what it has started and left
                os.killpg(child, signal.SIGKILL)
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() > end:
            with suppress(ProcessLookupError):
                os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return None
        time.sleep(_POLL_S)


# ---- in the child --------------------------------------------------------------------------------


def _child(tree: Path, root: Path, asked: TestsAsked) -> None:
    """Become a process of its own, run pytest, and end without a way back."""
    status = 70
    try:
        os.setsid()
        with (tree.parent / "said.txt").open("wb") as said:
            os.dup2(said.fileno(), 1)
            os.dup2(said.fileno(), 2)
        # Kernels of a mutant's scenes stay out of the user's store.
        home = tree.parent / "home"
        home.mkdir(exist_ok=True)
        known = os.environ.get("XDG_CACHE_HOME") or str(Path("~/.cache").expanduser())
        os.environ |= {
            "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1", "HOME": str(home),
            "XDG_CACHE_HOME": known,
        }  # fmt: skip
        sys.dont_write_bytecode = True
        os.chdir(tree)
        sys.path[:] = [str(tree), *(p for p in sys.path if Path(p).resolve() != root)]
        _keep_kernels_apart(tree, root, asked.anew)
        import pytest

        plugin = _Plugin(tree, asked)
        options = ["-q", "-n0", "-p", "no:cacheprovider", "-p", "no:randomly", "--rootdir", "."]
        status = int(pytest.main([*asked.files, *options, *asked.arguments], plugins=[plugin]))
    except BaseException as error:  # whatever it is, the parent must hear of it
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def _keep_kernels_apart(tree: Path, root: Path, anew: frozenset[str]) -> None:
    """Let kernels find their stored code by the checkout's sources, but for those compiled anew."""
    if anew:
        # Optimising takes ten times as long as compiling.
        os.environ["NUMBA_OPT"] = "0"
        importlib.import_module("numba").config.reload_config()
    compiling: Any = importlib.import_module("reconstruction.compiling")
    digest, keep = compiling.digest_of_sources, compiling.compile_and_keep

    def digest_of_checkout(folder: Path, patterns: tuple[str, ...]) -> Any:
        return digest(root / folder.resolve().relative_to(tree.resolve()), patterns)

    def keep_if_unchanged(function: Any, options: dict[str, Any], source_digest: str) -> Any:
        if function.__module__ in anew:
            return compiling.numba.njit(**options)(function)
        return keep(function, options, source_digest)

    compiling.digest_of_sources = digest_of_checkout
    compiling.compile_and_keep = keep_if_unchanged
    compiling.SOURCE_DIGEST = digest_of_checkout(tree / "reconstruction", compiling.KERNEL_SOURCES)


class _Plugin:
    """Choose and order tests, and tell of each as it ends."""

    def __init__(self, tree: Path, asked: TestsAsked) -> None:
        self._told = tree.parent / "told.jsonl"
        chosen = asked.chosen
        self._order = None if chosen is None else {test: n for n, test in enumerate(chosen)}
        self._calls = _Calls(tree, asked.traced) if asked.traced else None
        self._seconds: dict[str, float] = {}
        self._failed: set[str] = set()
        self._shared: dict[str, set[str]] = {}

    def pytest_collection_modifyitems(self, config: Any, items: list[Any]) -> None:
        if self._order is None:
            return
        order = self._order
        config.hook.pytest_deselected(items=[one for one in items if one.nodeid not in order])
        items[:] = sorted(
            (one for one in items if one.nodeid in order), key=lambda one: order[one.nodeid]
        )

    def pytest_runtest_logstart(self, nodeid: str, location: Any) -> None:
        self._seconds[nodeid] = 0.0
        if self._calls:
            self._calls.begin()

    def pytest_runtest_logreport(self, report: Any) -> None:
        self._seconds[report.nodeid] += report.duration
        if report.failed:
            self._failed.add(report.nodeid)
        file = report.nodeid.split("::")[0]
        if report.when == "setup" and self._calls:
            # A fixture of the whole file is set up by its first test and used by all others.
            self._shared.setdefault(file, set()).update(self._calls.found)
        if report.when == "teardown":
            functions: set[str] = set()
            if self._calls:
                functions = self._calls.found | self._shared.get(file, set())
            line = {
                "test": report.nodeid, "passed": report.nodeid not in self._failed,
                "seconds": round(self._seconds[report.nodeid], 3), "functions": sorted(functions),
            }  # fmt: skip
            with self._told.open("a", encoding="utf-8") as told:
                told.write(json.dumps(line) + "\n")

    def pytest_collectreport(self, report: Any) -> None:
        if report.failed:
            line = {"test": f"{report.nodeid} (import)", "passed": False, "seconds": 0.0}
            with self._told.open("a", encoding="utf-8") as told:
                told.write(json.dumps(line | {"functions": []}) + "\n")


class _Calls:
    """Functions of some files that are called from now on, in any thread."""

    def __init__(self, tree: Path, files: frozenset[str]) -> None:
        self._files = {str(tree / file): file for file in files}
        self.found: set[str] = set()

    def begin(self) -> None:
        self.found = set()
        threading.settrace(self._trace)
        sys.settrace(self._trace)

    def _trace(self, frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        file = self._files.get(code.co_filename)
        if file:
            self.found.add(f"{file}::{code.co_qualname.split('.<')[0]}")


# ---- what a change can reach --------------------------------------------------------------------


def kernels_reached_by(tree: Path, file: str) -> frozenset[str]:
    """Return the modules with kernels that import a file, directly or not, or are it: by name."""
    imported = _imports(tree)
    found, new = set(), {_module(file)}
    while new:
        found |= new
        new = {name for name, used in imported.items() if used & new} - found
    return frozenset(name for name in found if "reconstruction.compiling" in imported[name])


def _imports(tree: Path) -> dict[str, set[str]]:
    files = [f for package in ("twin", "reconstruction") for f in (tree / package).rglob("*.py")]
    names = {_module(str(file.relative_to(tree))): file for file in files}
    return {name: _imported(file) & set(names) for name, file in names.items()}


def _imported(file: Path) -> set[str]:
    """Return the modules that a file imports at its top, and those that names may be taken from."""
    text = file.read_text(encoding="utf-8")
    found = set(re.findall(r"^import ([\w.]+)", text, re.MULTILINE))
    for module, names in re.findall(r"^from ([\w.]+) import (.*)", text, re.MULTILINE):
        found |= {module, *(f"{module}.{name}" for name in re.findall(r"\w+", names))}
    return found


def _module(file: str) -> str:
    return re.sub(r"(/__init__)?\.py$", "", file).replace("/", ".")
