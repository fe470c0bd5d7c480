"""Mutants of the physics: whether a test sees a sign, a term or a constant that is wrong.

    ./run bench mutants                      # 40 of each room
    ./run bench mutants --room camera        # one room, repeatable; --count 100: more of it
    ./run bench mutants --quick              # 5 of each room, without the tests of tests/slow.txt
    ./run bench mutants --mutant NAME        # one again, as printed; shows what the tests said
    ./run bench mutants --kept FILE          # and on from where it stopped

Mutants are drawn in turns over the functions of a room (`benchmarks/mutants.toml`), applied to a
copy of the tree, and judged by those of the room's tests that call the function. A kept verdict
holds while the changed file and the tests that gave it stay the same. Survivors are printed. Last
line: {"judged": n, "killed": n, "equivalent": n, "timed_out": n, ..., "shares": {room: share}};
those killed by time are among the killed. Exit status 1 below a share of 0.85.
"""

import argparse
import functools
import hashlib
import json
import re
import sys
import tempfile
import tomllib
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.mutation import runs
from benchmarks.mutation.operators import Mutant, drawn, mutants_of

ROOT = Path(__file__).resolve().parents[1]
KNOWN = ROOT / "benchmarks" / "mutants.toml"
WANTED_SHARE = 0.85
# Tests of one mutant: the quickest first, up to so many seconds of them on the copy as it is; fewer
# where kernels are compiled anew, which are not optimised then and run ten times as long.
_MOST_S, _MOST_ANEW_S = 20.0, 6.0
_LEAST_LIMIT_S, _LIMIT_OVER_BASELINE = 30.0, 5.0
_COMPILING_S = 120.0


@dataclass(frozen=True)
class Room:
    """A part of the physics: its sources and tests, paths from the root.

    Attributes
    ----------
    slow : whether the tests of tests/slow.txt judge too
    """

    name: str
    sources: tuple[str, ...]
    tests: tuple[str, ...]
    slow: bool = True


@dataclass(frozen=True)
class MutantVerdict:
    """What became of a mutant.

    Attributes
    ----------
    end : "killed", "timed_out", "survived", or "unseen": no test of the room calls the function
    by : the test that failed
    source, tests : digests of the changed file, and of the test file that killed it or of all
    """

    name: str
    room: str
    end: str
    by: str
    line: int
    seconds: float
    source: str
    tests: str

    @property
    def is_killed(self) -> bool:
        """Tell whether the tests saw it."""
        return self.end in ("killed", "timed_out")


@dataclass(frozen=True)
class Known:
    """Mutants of which something is known: why, by name."""

    equivalent: dict[str, str]
    accepted: dict[str, str]

    def gone(self, rooms: Iterable[Room], tree: Path) -> list[str]:
        """Return the names of what the sources no longer give."""
        told = {*self.equivalent, *self.accepted}
        files = {name.split("::")[0] for name in told}
        there = {file for room in rooms for file in room.sources if file in files}
        return sorted(told - {one.name for file in there for one in mutants_of(tree, file)})


def main(arguments: list[str] | None = None) -> int:
    """Judge mutants of the rooms asked for; return the exit status."""
    chosen = parse(arguments)
    rooms, known = read_known(KNOWN)
    unknown = [name for name in chosen.room if name not in rooms]
    if unknown:
        print(f"--room: found '{unknown[0]}', allowed {', '.join(rooms)}", file=sys.stderr)
        return 2
    kept = KeptVerdicts(chosen.kept)
    runs.preload()
    verdicts: list[MutantVerdict] = []
    equivalent = []
    with tempfile.TemporaryDirectory() as scratch, runs.copied(ROOT, Path(scratch)) as tree:
        if chosen.mutant:
            return show(chosen.mutant, rooms, tree)
        for name in known.gone(rooms.values(), tree):
            print(f"{KNOWN.name}: no such mutant any more, take it out: {name}")
        for name in chosen.room or rooms:
            count = chosen.count or (5 if chosen.quick else 40)
            mutants = drawn(room_mutants(rooms[name], tree), count, chosen.seed)
            equivalent += [one for one in mutants if one.name in known.equivalent]
            left = [one for one in mutants if one.name not in known.equivalent]
            verdicts += Judge(rooms[name], tree, kept, chosen.quick).judged(left, known.accepted)
    found = summary(verdicts, len(equivalent))
    print(json.dumps(found))
    return int(found["killed"] < WANTED_SHARE * found["judged"])


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Parse the command line; argparse leaves with status 2 where it is wrong."""
    parser = argparse.ArgumentParser(
        prog="bench mutants",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--room", action="append", default=[], help="repeatable; default all")
    parser.add_argument("--quick", action="store_true", help="5 of each room, no slow tests")
    parser.add_argument("--count", type=int, help="mutants of each room")
    parser.add_argument("--seed", type=int, default=1, help="of the draw")
    parser.add_argument("--mutant", metavar="NAME", help="only this one, shown")
    parser.add_argument("--kept", type=Path, help="verdicts of earlier runs, and where to add")
    return parser.parse_args(arguments)


def read_known(path: Path) -> tuple[dict[str, Room], Known]:
    """Read rooms, and the mutants of which something is known."""
    content = tomllib.loads(path.read_text(encoding="utf-8"))
    rooms = {
        name: Room(name, _paths(one["sources"]), _paths(one["tests"]), one.get("slow", True))
        for name, one in content["rooms"].items()
    }
    names = {
        kind: {one["mutant"]: one["reason"] for one in content.get(kind, [])}
        for kind in ("equivalent", "accepted")
    }
    return rooms, Known(**names)


def _paths(patterns: Iterable[str]) -> tuple[str, ...]:
    found = []
    for pattern in patterns:
        files = pattern if pattern.endswith(".py") else f"{pattern}/test_*.py"
        some = (str(path.relative_to(ROOT)) for path in sorted(ROOT.glob(files)))
        found += [path for path in some if not path.endswith("__init__.py")]
    return tuple(dict.fromkeys(found))


def room_mutants(room: Room, tree: Path) -> list[Mutant]:
    """Return every mutant of a room's sources."""
    return [one for file in room.sources for one in mutants_of(tree, file)]


def digest_of(tree: Path, *files: str) -> str:
    """Return the digest of some files of a tree."""
    found = hashlib.sha256(b"".join((tree / file).read_bytes() for file in files))
    return found.hexdigest()[:16]


class KeptVerdicts:
    """Verdicts and baselines of earlier runs, a line of JSON each."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._lines: dict[str, dict[str, Any]] = {}
        if path is not None and path.exists():
            for text in path.read_text(encoding="utf-8").splitlines():
                line = json.loads(text)
                self._lines[line["key"]] = line

    def get(self, key: str) -> Any:
        """Return what was last kept under a key, or None."""
        return self._lines.get(key, {}).get("value")

    def add(self, key: str, value: Any) -> None:
        """Keep a value, which JSON can hold."""
        line = {"key": key, "value": value}
        self._lines[key] = line
        if self._path is not None:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")


class Judge:
    """Judges mutants of one room by its tests, which must pass on the copy as it is."""

    def __init__(self, room: Room, tree: Path, kept: KeptVerdicts, quick: bool) -> None:
        self._room, self._tree, self._kept = room, tree, kept
        self._arguments = ("--quick",) if quick or not room.slow else ()
        self._baseline = [one for file in room.tests for one in self._of_file(file, False)]

    def _of_file(self, file: str, anew: bool) -> list[runs.TestRun]:
        """Run a test file on the copy as it is, with the room's kernels compiled anew or not."""
        helpers = sorted((self._tree / file).parent.glob("conftest.py"))
        own = [file, *(str(one.relative_to(self._tree)) for one in helpers)]
        digest = digest_of(self._tree, *own, *self._room.sources)
        key = f"baseline {file} {digest} {self._arguments} {anew}"
        found = self._kept.get(key)
        if found is None:
            compiled = [
                runs.kernels_reached_by(self._tree, one) for one in self._room.sources if anew
            ]
            traced = frozenset() if anew else frozenset(self._room.sources)
            modules = frozenset[str]().union(*compiled)
            asked = runs.TestsAsked((file,), 600.0, None, traced, modules, self._arguments)
            run = runs.run_tests(self._tree, ROOT, asked)
            # 1: a test that fails by another rounding is no judge of kernels; 5: all are slow.
            if run.status not in ((0, 1, 5) if anew else (0, 5)):
                raise SystemExit(f"{file}: fails without any mutant\n{run.said}")
            found = [asdict(one) | {"functions": sorted(one.functions)} for one in run.tests]
            self._kept.add(key, found)
            failed = f", of which fail {[one.test for one in run.tests if not one.passed]}"
            told = f"{file}: {len(found)} tests, {run.seconds:.1f} s{', kernels anew' * anew}"
            print(f"{told}{failed * any(not one.passed for one in run.tests)}", flush=True)
        return [runs.TestRun(**one | {"functions": frozenset(one["functions"])}) for one in found]

    def judged(
        self, mutants: Sequence[Mutant], accepted: dict[str, str]
    ) -> Iterator[MutantVerdict]:
        """Judge mutants, and print those that survive."""
        for number, one in enumerate(mutants, 1):
            verdict = self._from_before(one) or self._judge(one)
            told = f"{self._room.name} {number}/{len(mutants)}: {verdict.end}"
            if verdict.is_killed:
                print(f"{told} by {verdict.by} ({verdict.seconds:.1f} s)", flush=True)
            else:
                why = accepted.get(one.name, "")
                print(f"{told} ({verdict.seconds:.1f} s): {one.file}:{one.place[0]}", flush=True)
                print(f"    - {one.before}\n    + {one.after}\n    {one.name}", flush=True)
                if why:
                    print(f"    accepted: {why}", flush=True)
            yield verdict

    def _from_before(self, one: Mutant) -> MutantVerdict | None:
        found = self._kept.get(one.name)
        if found is None:
            return None
        before = MutantVerdict(**found)
        same = before.source == digest_of(
            self._tree, one.file
        ) and before.tests == self._tests_digest(before.by)
        return before if same else None

    def _tests_digest(self, by: str) -> str:
        file = re.split(r"::| \(", by)[0]
        tests = [file] if file in self._room.tests else self._room.tests
        return digest_of(self._tree, *tests)

    def _judge(self, one: Mutant) -> MutantVerdict:
        chosen = self.chosen(one)
        if not chosen:
            return self._verdict(one, "unseen", "", 0.0)
        seconds = sum(test.seconds for test in chosen)
        limit_s = max(_LEAST_LIMIT_S, _LIMIT_OVER_BASELINE * seconds)
        limit_s += _COMPILING_S * bool(anew_for(one, self._tree))
        run = run_mutant(one, self._tree, chosen, limit_s)
        if run.status is None:
            return self._verdict(one, "timed_out", "", run.seconds)
        end = "survived" if run.status == 0 else "killed"
        return self._verdict(one, end, run.failed, run.seconds)

    def _verdict(self, one: Mutant, end: str, by: str, seconds: float) -> MutantVerdict:
        found = MutantVerdict(
            one.name, self._room.name, end, by, one.place[0], round(seconds, 1),
            digest_of(self._tree, one.file), self._tests_digest(by),
        )  # fmt: skip
        self._kept.add(one.name, asdict(found))
        return found

    def chosen(self, one: Mutant) -> list[runs.TestRun]:
        """Return the tests that can see a mutant, in the order in which they are run."""
        function = f"{one.file}::{one.function}"
        can = [test for test in self._baseline if function in test.functions]
        if one.is_kernel or one.is_constant:
            can = [test for test in self._baseline if self._is_near(one, test)] or self._baseline
        most_s = _MOST_S
        if anew_for(one, self._tree):
            files = dict.fromkeys(test.test.split("::")[0] for test in can)
            sound = {t.test for file in files for t in self._of_file(file, True) if t.passed}
            can, most_s = [test for test in can if test.test in sound], _MOST_ANEW_S
        return affordable(can, lambda test: imports(self._tree, test, one.file), most_s)

    def _is_near(self, one: Mutant, test: runs.TestRun) -> bool:
        """Tell whether a test calls something beside a kernel or constant, or imports its file.

        No profiler sees a kernel being called, nor a constant being read.
        """
        beside = one.is_kernel or bool(anew_for(one, self._tree))
        near = str(Path(one.file).parent) if beside else one.file
        names = (name.split("::")[0] for name in test.functions)
        return any(near in (n, str(Path(n).parent)) for n in names) or imports(
            self._tree, test, one.file
        )


def imports(tree: Path, test: runs.TestRun, file: str) -> bool:
    """Tell whether the file of a test imports a source file by name."""
    module = file.removesuffix(".py").replace("/", ".")
    return f"{module} import" in (tree / test.test.split("::")[0]).read_text(encoding="utf-8")


def affordable(
    tests: Sequence[runs.TestRun], is_close: Callable[[runs.TestRun], bool], most_s: float
) -> list[runs.TestRun]:
    """Return the tests, file by file, that together fit into so many seconds; at least one.

    Files that are close to the mutant come first, then those that take least time.
    """
    files: dict[str, list[runs.TestRun]] = defaultdict(list)
    for test in tests:
        files[test.test.split("::")[0]].append(test)
    ordered = sorted(
        files.values(), key=lambda some: (not is_close(some[0]), sum(t.seconds for t in some))
    )
    found: list[runs.TestRun] = []
    total = 0.0
    for test in (one for some in ordered for one in sorted(some, key=lambda one: one.seconds)):
        if not found or total + test.seconds <= most_s:
            found.append(test)
            total += test.seconds
    return found


@functools.cache
def anew_for(one: Mutant, tree: Path) -> frozenset[str]:
    """Return the modules whose kernels a mutant can change; none by a function that is plain."""
    if not (one.is_kernel or one.is_constant):
        wrapped = re.compile(rf"\b_?(compiled|inlined|merged)\({one.function.split('.')[-1]}\)")
        files = (
            f for package in ("twin", "reconstruction") for f in (tree / package).rglob("*.py")
        )
        if not any(wrapped.search(file.read_text(encoding="utf-8")) for file in files):
            return frozenset()
    return runs.kernels_reached_by(tree, one.file)


def run_mutant(
    one: Mutant, tree: Path, chosen: Sequence[runs.TestRun], limit_s: float
) -> runs.SuiteRun:
    """Run tests on the copy with one mutant, up to the first that fails."""
    names = tuple(test.test for test in chosen)
    files = tuple(dict.fromkeys(name.split("::")[0] for name in names))
    asked = runs.TestsAsked(
        files, limit_s, names, anew=anew_for(one, tree), arguments=("-x", "--tb=short")
    )
    path = tree / one.file
    with runs.changed(path, one.applied(path.read_text(encoding="utf-8"))):
        return runs.run_tests(tree, ROOT, asked)


def show(name: str, rooms: dict[str, Room], tree: Path) -> int:
    """Judge one mutant and show what the tests say."""
    for room in rooms.values():
        for one in room_mutants(room, tree):
            if one.name == name:
                judge = Judge(room, tree, KeptVerdicts(None), quick=False)
                chosen = judge.chosen(one)
                run = run_mutant(one, tree, chosen, 600.0)
                print(f"{run.said}\n{one.file}:{one.place[0]}: {one.before} -> {one.after}")
                print(f"{len(chosen)} tests, {run.seconds:.1f} s: {run.failed or 'survived'}")
                return 0
    print(f"--mutant: found no '{name}', give a name as printed", file=sys.stderr)
    return 2


def summary(verdicts: Sequence[MutantVerdict], equivalent: int) -> dict[str, Any]:
    """Count how mutants ended, together and by room."""
    rooms: dict[str, list[MutantVerdict]] = defaultdict(list)
    for one in verdicts:
        rooms[one.room].append(one)
    return {
        "judged": len(verdicts),
        "killed": sum(one.is_killed for one in verdicts),
        "equivalent": equivalent,
        "timed_out": sum(one.end == "timed_out" for one in verdicts),
        "unseen": sum(one.end == "unseen" for one in verdicts),
        "by_room": {
            name: [sum(o.is_killed for o in some), len(some)] for name, some in rooms.items()
        },
        "shares": {
            name: round(sum(o.is_killed for o in some) / len(some), 3)
            for name, some in rooms.items()
        },
    }


if __name__ == "__main__":
    sys.exit(main())
