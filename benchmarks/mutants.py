"""Mutation testing of the physics: which wrong signs, terms and constants the tests detect.

    ./run bench mutants                      # 40 mutants of each group of sources
    ./run bench mutants --room camera        # one group, repeatable; --count 100: more mutants
    ./run bench mutants --quick              # 5 of each group, without the tests of tests/slow.txt
    ./run bench mutants --mutant NAME        # one mutant by its printed name, with pytest's output

A mutant changes one expression of one source file in a copy of the tree: a sign, a term or factor
left out, + for -, * for /, a constant by 2 % or by one, < for <=, two arguments exchanged, sine for
cosine, another axis. The tests of the group (`benchmarks/mutants.toml`) that call the changed
function then run in a child process; of a kernel or a constant, which no profiler can trace, the
tests that import its folder run. Kernels are compiled without optimisation. Mutants are named by
file, function, operator and line of text, so names survive when lines move. Survivors are printed.

Last line: {"judged", "killed", "equivalent", "timed_out", "unseen", "by_room", "shares"}; mutants
that exceed the time limit count as killed. Exit status 1 if less than 85 % are killed.
"""

import argparse
import ast
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
KNOWN, RECORD = ROOT / "benchmarks" / "mutants.toml", "MUTANTS_RECORD"
LEAST_SHARE, MOST_S, LEAST_LIMIT_S, LIMIT_OVER_BASELINE = 0.85, 20.0, 150.0, 5.0
MODULE = "<module>"
IGNORED = (".git", ".venv", ".ready", "out", ".*_cache", ".hypothesis", "*.pyc", "__pycache__")
# Messages, checks, readers, writers and drawing are not physics.
_SKIPPED_FUNCTIONS = re.compile(
    r"^_?(plot|draw|show|write|read|load|save|explain|refuse|warn|in_words|to_xarray|shapes?_of_array"
    r"|require|check)(_|$)|^__(repr|post_init|str)__$|^_repr_"
)
_SKIPPED_CALLS = "Column|Table|require_number|watch|progress|cast|compile_and_keep"
_SKIPPED_CALLS += r"|(is|get|has)(instance|attr)|\w*Error"
_SYMMETRIC_CALLS = "max|min|maximum|minimum|hypot|larger|smaller|gcd|zip|corrcoef|spearmanr|isclose"
_SYMMETRIC_CALLS += "|allclose|array_equal|fmax|fmin|logical_and|logical_or"
_NOT_RUN = {"annotation", "returns", "decorator_list", "bases", "type_comment"}
_SWAPPED: dict[type, tuple[str, type]] = {
    ast.Add: ("add_subtract", ast.Sub), ast.Sub: ("add_subtract", ast.Add),
    ast.Mult: ("multiply_divide", ast.Div), ast.Div: ("multiply_divide", ast.Mult),
    ast.Lt: ("comparison", ast.LtE), ast.LtE: ("comparison", ast.Lt),
    ast.Gt: ("comparison", ast.GtE), ast.GtE: ("comparison", ast.Gt),
}  # fmt: skip
_TRIGONOMETRIC = {"sin": "cos", "cos": "sin"}
_GUARD, _HUGE = 1e-6, 1e12
# Most of these raise an error at once, so they are drawn less often.
_CRUDE, _CRUDE_SHARE = ("off_by_one", "arguments"), 0.3


Place = tuple[int, int, int, int]


@dataclass(frozen=True)
class Mutant:
    """One change of one file.

    Attributes
    ----------
    file, function : path from the root of the tree, and qualified name or `MODULE`
    before, after : line of the source where the change starts
    place : first and last line, and columns in bytes, of the source that `text` replaces
    """

    file: str
    function: str
    operator: str
    before: str
    after: str
    occurrence: int
    place: Place
    text: str

    @property
    def name(self) -> str:
        """Name that survives when lines move."""
        nth = f" #{self.occurrence}" if self.occurrence > 1 else ""
        return f"{self.file}::{self.function}::{self.operator}::{self.before} -> {self.after}{nth}"

    def applied(self, source: str) -> str:
        """Return the source with the change."""
        return _applied(source, self.place, self.text)


# ---- operators -----------------------------------------------------------------------------------


def mutants_of(root: Path, file: str) -> list[Mutant]:
    """Return every mutant of a source file, in the order of its text."""
    source = (root / file).read_text("utf-8")
    counts, mutants = Counter[tuple[str, ...]](), []
    for node, parents, function in _sites(ast.parse(source), (), MODULE):
        place = (node.lineno, node.col_offset, node.end_lineno, node.end_col_offset)
        for operator, new in _changes(node, parents):
            text = ast.unparse(new) if isinstance(new, ast.stmt) else f"({ast.unparse(new)})"
            lines = (changed.splitlines() for changed in (source, _applied(source, place, text)))
            key = (function, operator, *(line[node.lineno - 1].strip() for line in lines))
            counts[key] += 1
            mutants.append(Mutant(file, *key, counts[key], place, text))
    return mutants


def _applied(source: str, place: Place, text: str) -> str:
    """Return the source with a text in a place."""
    first, left, last, right = place
    lines = source.encode().splitlines(keepends=True)
    head, tail = lines[first - 1][:left], lines[last - 1][right:]
    lines[first - 1 : last] = [head + text.encode() + tail]
    return b"".join(lines).decode()


def _sites(node: ast.AST, parents: tuple[ast.AST, ...], function: str) -> Iterator[Any]:
    """Yield (expression, its parents from the module down, function) of the physics."""
    if _is_skipped(node):
        return
    inside = any(isinstance(parent, ast.FunctionDef) for parent in parents)
    if isinstance(node, ast.FunctionDef | ast.ClassDef) and not inside:
        function = node.name if function == MODULE else f"{function}.{node.name}"
    elif isinstance(node, ast.expr | ast.AugAssign):
        yield node, parents, function
    for name, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and name not in _NOT_RUN:
                yield from _sites(child, (*parents, node), function)


def _is_skipped(node: ast.AST) -> bool:
    """Return True for messages, checks, imports, drawing and docstrings."""
    skipped = isinstance(node, ast.Raise | ast.Assert | ast.Import | ast.ImportFrom | ast.JoinedStr)
    match node:
        case ast.Expr(value=ast.Constant()):
            skipped = True
        case ast.ClassDef(name=name):
            skipped = name.endswith("Error")
        case ast.FunctionDef(name=name):
            skipped = _SKIPPED_FUNCTIONS.search(name) is not None
        case ast.If(test=test, body=body, orelse=orelse):
            raises = any(isinstance(line, ast.Raise) for line in body) and not orelse
            skipped = raises or "__name__" in ast.unparse(test)
        case ast.Call():
            skipped = re.fullmatch(_SKIPPED_CALLS, _called(node)) is not None
    return skipped


def _changes(node: ast.AST, parents: tuple[ast.AST, ...]) -> Iterator[tuple[str, Any]]:
    """Yield the operators that apply to an expression, and the changed expression."""
    match node:
        case ast.AugAssign(target=target, op=op, value=value) if type(op) in _SWAPPED:
            operator, swapped = _SWAPPED[type(op)]
            yield operator, ast.AugAssign(target, swapped(), value)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _SWAPPED:
            if not _is_text(left) and not _is_text(right):
                operator, swapped = _SWAPPED[type(op)]
                yield operator, ast.BinOp(left, swapped(), right)
                yield "drop_term" if operator == "add_subtract" else "drop_factor", left
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            yield ("axis", ast.Constant(0)) if _is_axis(parents[-1]) else ("sign", operand)
        case ast.Compare(left=left, ops=[op, *rest], comparators=right) if type(op) in _SWAPPED:
            yield "comparison", ast.Compare(left, [_SWAPPED[type(op)][1](), *rest], right)
        case ast.Constant(value=value) if not any(map(_is_axis, parents[-2:-1])):
            yield from _of_constant(value, parents[-1])
        case ast.Call():
            yield from _of_call(node)


def _of_constant(value: Any, parent: ast.AST) -> Iterator[tuple[str, ast.expr]]:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return
    if _is_axis(parent):
        yield "axis", ast.Constant(1 if value == 0 else 0)
    elif isinstance(value, float) and _GUARD < abs(value) < _HUGE:
        yield "constant", ast.Constant(float(f"{value * 1.02:.12g}"))
    elif isinstance(value, int) and abs(value) < _HUGE:
        yield "off_by_one", ast.Constant(value + 1 if value < 2 else value - 1)


def _of_call(node: ast.Call) -> Iterator[tuple[str, ast.expr]]:
    name, arguments = _called(node), node.args
    if other := _TRIGONOMETRIC.get(name):
        is_method = isinstance(node.func, ast.Attribute)
        function = ast.Attribute(node.func.value, other) if is_method else ast.Name(other)
        yield "sine_cosine", ast.Call(function, arguments, node.keywords)
    if len(arguments) > 1 and not re.fullmatch(_SYMMETRIC_CALLS, name):
        first, second, *rest = arguments
        text = isinstance(first, ast.Constant) and isinstance(first.value, str)
        # A number in the place of an array fails at once, so both must be of one type.
        alike = type(first) is type(second) and not isinstance(first, ast.Starred)
        if alike and not text and ast.unparse(first) != ast.unparse(second):
            yield "arguments", ast.Call(node.func, [second, first, *rest], node.keywords)


def _is_text(node: ast.AST) -> bool:
    is_string = isinstance(node, ast.Constant) and isinstance(node.value, str)
    return is_string or isinstance(node, ast.JoinedStr | ast.List | ast.Tuple)


def _is_axis(node: ast.AST) -> bool:
    return isinstance(node, ast.keyword) and node.arg == "axis"


def _called(node: ast.Call) -> str:
    return getattr(node.func, "attr", "") or getattr(node.func, "id", "")


def drawn(mutants: Iterable[Mutant], count: int, seed: int) -> list[Mutant]:
    """Draw mutants; the draw of each depends on its name and the seed only."""

    def lot(mutant: Mutant) -> float:
        share = _CRUDE_SHARE if mutant.operator in _CRUDE else 1.0
        return random.Random(f"{seed} {mutant.name}").random() ** (1.0 / share)

    return sorted(mutants, key=lot, reverse=True)[:count]


# ---- pytest plugin of the child process ----------------------------------------------------------

_CALLED, _SHARED, _HERE = set[str](), defaultdict[str, set[str]](set), f"{Path.cwd()}{os.sep}"


def pytest_runtest_setup(item: Any) -> None:
    """Start to record which functions of the tree a test calls."""
    if os.environ.get(RECORD):
        _CALLED.clear()
        threading.settrace(_trace)
        sys.settrace(_trace)


def _trace(frame: Any, _event: str, _argument: Any) -> None:
    code = frame.f_code
    if code.co_filename.startswith(_HERE):
        file = code.co_filename.removeprefix(_HERE)
        _CALLED.add(f"{file}::{code.co_qualname.split('.<')[0]}")


def pytest_runtest_logreport(report: Any) -> None:
    """Write a line of JSON for each test that passed; later tests of a file share its fixtures."""
    if not os.environ.get(RECORD):
        return
    functions = _SHARED[report.nodeid.split("::")[0]]
    if report.when == "setup":
        functions |= _CALLED
    elif report.when == "call" and report.passed:
        line = {"test": report.nodeid, "seconds": report.duration}
        with Path(os.environ[RECORD]).open("a", encoding="utf-8") as record:
            record.write(json.dumps(line | {"functions": sorted(functions | _CALLED)}) + "\n")


# ---- running tests on a copy of the tree ---------------------------------------------------------


class MutantJudge:
    """Runs the tests of one group of sources on a copy of the tree."""

    def __init__(self, tree: Path, group: dict[str, Any], quick: bool) -> None:
        self._tree = tree
        self._options = ["--quick"] * (quick or not group.get("slow", True))
        record = tree.with_name("record.jsonl")
        record.unlink(missing_ok=True)
        status, output = self._pytest(group["tests"], None, str(record))
        if status not in (0, 1, 5):
            raise SystemExit(f"pytest fails without any mutant\n{output}")
        lines = record.read_text("utf-8").splitlines() if record.exists() else []
        self._tests = sorted(map(json.loads, lines), key=lambda test: test["seconds"])

    def judged(self, mutant: Mutant) -> tuple[str, str]:
        """Return "killed", "timed_out", "survived" or "unseen", and the output of pytest."""
        tests, seconds = self._affordable(mutant)
        if not tests:
            return "unseen", ""
        path = self._tree / mutant.file
        source = path.read_text("utf-8")
        path.write_text(mutant.applied(source), "utf-8")
        try:
            limit_s = LEAST_LIMIT_S + LIMIT_OVER_BASELINE * seconds
            status, output = self._pytest(["-x", *tests], limit_s, "")
        finally:
            path.write_text(source, "utf-8")
        ends = {None: "timed_out", 0: "survived", 1: "killed", 2: "killed", 5: "unseen"}
        if status not in ends:
            raise SystemExit(f"pytest ended with status {status}\n{output}")
        return ends[status], output

    def _affordable(self, mutant: Mutant) -> tuple[list[str], float]:
        """Return the fastest tests that call the function or import its folder, and their time."""
        function, folder = f"{mutant.file}::{mutant.function}", str(Path(mutant.file).parent)
        calling = [test for test in self._tests if function in test["functions"]]
        near = [t for t in self._tests if any(f.startswith(folder) for f in t["functions"])]
        tests, seconds = [], 0.0
        for test in calling or near:
            if not tests or seconds + test["seconds"] < MOST_S:
                tests.append(test["test"])
                seconds += test["seconds"]
        return tests, seconds

    def _pytest(
        self, arguments: Sequence[str], limit_s: float | None, record: str
    ) -> tuple[int | None, str]:
        """Return pytest's exit status, None beyond the time limit, and the end of its output."""
        options = ["-q", "-n0", "--tb=short", "-p", "no:cacheprovider", "-p", "benchmarks.mutants"]
        command = [sys.executable, "-m", "pytest", *options, *self._options, *arguments]
        kernels, output = self._tree.with_name("kernels"), self._tree.with_name("output.txt")
        environment = os.environ | {"PYTHONPATH": str(self._tree), "NUMBA_CACHE_DIR": str(kernels)}
        environment |= {"NUMBA_OPT": "0", "PYTHONDONTWRITEBYTECODE": "1", RECORD: record}
        with output.open("wb") as file:
            streams = {"stdout": file, "stderr": file, "timeout": limit_s, "check": False}
            try:
                run = subprocess.run(command, cwd=self._tree, env=environment, **streams)
                status = run.returncode
            except subprocess.TimeoutExpired:
                status = None
        return status, output.read_text("utf-8", "replace")[-4000:]


def files_of(patterns: Iterable[str]) -> list[str]:
    """Return the source or test files that patterns name, relative to the root."""
    globs = (name if name.endswith(".py") else f"{name}/test_*.py" for name in patterns)
    return [path.relative_to(ROOT).as_posix() for glob in globs for path in sorted(ROOT.glob(glob))]


# ---- all -----------------------------------------------------------------------------------------


def read_known() -> tuple[dict[str, Any], dict[str, str], dict[str, str]]:
    """Return the groups of sources, and the reasons of equivalent and of accepted mutants."""
    content = tomllib.loads(KNOWN.read_text("utf-8"))
    groups = {
        name: group | {key: files_of(group[key]) for key in ("sources", "tests")}
        for name, group in content["rooms"].items()
    }
    return groups, content["equivalent"], content["accepted"]


def summary(ends: dict[str, Counter[str]]) -> dict[str, Any]:
    """Count how mutants ended, in total and by group."""
    total = sum(ends.values(), Counter[str]())
    killed = {name: end["killed"] + end["timed_out"] for name, end in ends.items()}
    judged = {name: end.total() - end["equivalent"] for name, end in ends.items()}
    return {
        "judged": sum(judged.values()),
        "killed": sum(killed.values()),
        **{name: total[name] for name in ("equivalent", "timed_out", "unseen")},
        "by_room": {name: [killed[name], judged[name]] for name in ends},
        "shares": {name: round(killed[name] / (judged[name] or 1), 3) for name in ends},
    }


def main() -> int:
    """Judge mutants of the chosen groups; return the exit status."""
    groups, equivalent, accepted = read_known()
    parser = argparse.ArgumentParser(prog="bench mutants", description=__doc__.splitlines()[0])
    parser.add_argument("--room", choices=groups, action="append", help="repeatable")
    parser.add_argument("--count", type=int, default=40, help="mutants of each group")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="5 of each group, no slow tests")
    parser.add_argument("--mutant", help="this mutant only, with the output of pytest")
    chosen = parser.parse_args()
    count, ends = 5 if chosen.quick else chosen.count, defaultdict[str, Counter[str]](Counter)
    with tempfile.TemporaryDirectory() as scratch:
        tree = Path(scratch) / "tree"
        shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(*IGNORED))
        for name in chosen.room or groups:
            mutants = [m for file in groups[name]["sources"] for m in mutants_of(tree, file)]
            if chosen.mutant:
                mutants = [mutant for mutant in mutants if mutant.name == chosen.mutant]
            left = [m for m in drawn(mutants, count, chosen.seed) if m.name not in equivalent]
            ends[name]["equivalent"] = min(count, len(mutants)) - len(left)
            judge = MutantJudge(tree, groups[name], chosen.quick) if left else None
            for mutant in left:
                end, output = judge.judged(mutant)
                ends[name][end] += 1
                print(f"{end}: {mutant.name} {accepted.get(mutant.name, '')}", flush=True)
                print(output * bool(chosen.mutant), end="")
    counts = summary(ends)
    print(json.dumps(counts))
    return int(counts["killed"] < LEAST_SHARE * counts["judged"])


if __name__ == "__main__":
    sys.exit(main())
