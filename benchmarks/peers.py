"""The same work by this project and by other programs: processor time, memory and error.

- decode: one stack of a curved coat at 484 x 366 px, each program with its own code, to projector
  coordinates; same camera noise, amplitude and finest period;
- tactile: images of balls in a GelSight Mini; change of levels by the contact compared with those
  of presses on a real unit (`real_presses`), in the best of four mirror images and two colour
  orders, since the other program does not state its orientation;
- press: a ball on a bonded, nearly incompressible layer, 512 x 512 cells; force compared with the
  Fredholm equation;
- frame: one fringe image of two balls under the coated slab, 484 x 366 px, 4 rays per pixel;
  compared with the same image by stock Mitsuba with 512 rays per pixel.

Other programs are installed in environments of their own below `out/peers` (8 GB, most of it the
libraries of `gsoup`). Arrays pass between the environments by files. Every program works in a
process of its own on one core; the time is the median processor time after a first call, the
memory the peak of the whole process. A program that cannot be installed or fails has a row with the
reason.

`--only NAME` compares one other program, repeatable, `--work NAME` one kind of work; `--update`
writes the table of docs/peers.md, with all programs and works. Last line: {"decode_twin_s",
"decode_twin_mib", "decode_twin_error", ...}, null where a program has no result.
"""

import argparse
import json
import os
import subprocess
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from benchmarks import all as all_cases
from benchmarks._harness import print_figures, quick_parser
from benchmarks.contest.contestants import CONTESTANTS, HERE, Contestant
from benchmarks.contest.environments import PeerError
from benchmarks.contest.work import WORKS, PeerTask
from benchmarks.regression.tables import with_table
from twin.optics.backend import CHOICE_VARIABLE, LIBRARY_VARIABLE, MissingBackend, find_backend

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "peers.md"
HEAD = "work", "program", "time per result, s", "peak memory, MiB", "error", "remarks"
REPEATS, TIMEOUT_S = 5, 1800


@dataclass(frozen=True)
class PeerResult:
    """One program's result of a piece of work, or the reason that there is none.

    Attributes
    ----------
    seconds : processor time per result
    error : in the unit of the work; None: no result
    """

    work: PeerTask
    contestant: Contestant
    seconds: float | None = None
    memory_mib: float | None = None
    error: float | None = None
    remark: str = ""

    def cells(self) -> tuple[str, ...]:
        """Return the cells of the table."""
        name, version = self.contestant.label, self.contestant.environment.version
        return (
            self.work.name,
            f"{name} {version}".strip(),
            *(_shown(value) for value in (self.seconds, self.memory_mib)),
            "" if self.error is None else f"{self.error:.2g}",
            "; ".join(filter(None, (self.contestant.scope[self.work.name], self.remark))),
        )

    def figures(self) -> dict[str, float | None]:
        """Return the figures of the last line."""
        before = f"{self.work.name}_{self.contestant.name}"
        values = {"s": self.seconds, "mib": self.memory_mib, "error": self.error}
        return {f"{before}_{name}": value for name, value in values.items()}


def parsed(words: list[str] | None = None) -> argparse.Namespace:
    """Return the options of a command line, by default that of this process."""
    parser = quick_parser(__doc__, "smaller images and grids, fewer presses, one repeat")
    others = [one.name for one in CONTESTANTS if one.environment is not HERE]
    parser.add_argument("--only", action="append", choices=others, help="repeatable")
    parser.add_argument("--work", choices=[work.name for work in WORKS], help="this work only")
    parser.add_argument("--update", action="store_true", help="write the table of docs/peers.md")
    chosen = parser.parse_args(words)
    if chosen.update and (chosen.only or chosen.work or chosen.quick):
        parser.error("--update writes the whole table: omit --only, --work and --quick")
    return chosen


def use_llvm() -> None:
    """Select LLVM, on the processor, for the renderers of this process and of the programs."""
    os.environ[CHOICE_VARIABLE] = "llvm"
    with suppress(MissingBackend):  # a work without images needs no renderer
        os.environ[LIBRARY_VARIABLE] = find_backend().library or ""


def main() -> None:
    chosen = parsed()
    use_llvm()
    compared = [
        one
        for one in CONTESTANTS
        if one.environment is HERE or not chosen.only or one.name in chosen.only
    ]
    rows = []
    works = [work for work in WORKS if chosen.work in {None, work.name}]
    for row in compare(works, compared, chosen.quick):
        print(" | ".join(row.cells()), flush=True)
        rows.append(row)
    if chosen.update:
        PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8"), table(rows)), "utf-8")
    print_figures({name: value for row in rows for name, value in row.figures().items()})


def compare(
    works: list[PeerTask], contestants: list[Contestant], quick: bool
) -> Iterator[PeerResult]:
    """Do each piece of work that another program does, by all of them; yield the rows."""
    for work in works:
        capable = [program for program in contestants if work.name in program.scope]
        if len(capable) < 2:
            continue
        with tempfile.TemporaryDirectory() as folder:
            inputs = work.inputs(Path(folder), quick)
            np.savez(Path(folder) / "inputs.npz", **inputs)
            for contestant in capable:
                yield row_of(work, contestant, inputs, Path(folder), 1 if quick else REPEATS)


def row_of(
    work: PeerTask,
    contestant: Contestant,
    inputs: dict[str, np.ndarray],
    folder: Path,
    repeats: int,
) -> PeerResult:
    """Let a program do a piece of work whose inputs are in a folder, and judge its result."""
    try:
        python = contestant.environment.python()
        figures = run_child(python, contestant.name, work.name, folder, repeats)
    except PeerError as error:
        return PeerResult(work, contestant, remark=str(error))
    with np.load(folder / "result.npz") as file:
        result = dict(file)
    error, remark = work.error_of(inputs, result)
    seconds = figures["seconds"] / work.results_in(result)
    return PeerResult(work, contestant, seconds, figures["memory_bytes"] / 2**20, error, remark)


def run_child(
    python: Path, contestant: str, work: str, folder: Path, repeats: int
) -> dict[str, float]:
    """Run the child process of a program; return the figures of its last line.

    Raises
    ------
    PeerError : the process fails or takes too long
    """
    command = [str(python), "-m", "benchmarks.contest.child", contestant, work]
    files = [str(folder / name) for name in ("inputs.npz", "result.npz")]
    try:
        done = subprocess.run(
            [*command, *files, str(repeats)],
            cwd=ROOT,
            env=os.environ | {"PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "ignore"},
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
        )
    except subprocess.TimeoutExpired:
        raise PeerError(f"no result within {TIMEOUT_S} s") from None
    if done.returncode:
        last = (done.stderr.strip() or f"exit status {done.returncode}").splitlines()[-1]
        raise PeerError(f"failed: {last}")
    return dict(json.loads(done.stdout.splitlines()[-1]))


def table(rows: Iterable[PeerResult]) -> str:
    """Return the page's table in Markdown."""
    errors = "; ".join(f"{work.name}: {work.error}" for work in WORKS)
    lines = [
        f"On one of {all_cases.machine()}, {datetime.now(UTC).date().isoformat()}.",
        f"Errors: {errors}.",
        "",
        *(f"|{'|'.join(cells)}|" for cells in (HEAD, ("---",) * len(HEAD))),
    ]
    return "\n".join((*lines, *(f"|{'|'.join(row.cells())}|" for row in rows)))


def _shown(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}" if value < 1000 else f"{value:.0f}"


if __name__ == "__main__":
    main()
