"""Outcome of a run of a study: numbers of cases by state, failures, and the table of its store."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from reconstruction.errors import InputError
from twin.results.rows import draw_rows, rows_as_arrays
from twin.study.remarks import Remark
from twin.study.worker import State

if TYPE_CHECKING:
    import xarray

    from reconstruction.drawing import Drawing
    from twin.study.table import StudyTable


@dataclass(frozen=True)
class SweepOutcome:
    """Outcome of a run of a study.

    Attributes
    ----------
    states : number of cases of this run by state
    unsaved : by digest of each case that could not be written, the reason
    seconds : wall-clock time of the run, s
    busy_seconds : time in which cases were computed, s, summed over all workers
    finished : number of cases of the study that have a result, of this run or of an earlier one
    failures : digests of the failed cases, of this run or of an earlier one, by reason
    damaged : by digest of each case that ran again because its files could not be read, the reason
    remarks : warnings of the cases that have a result, the most frequent first
    folder : store of the study, from which settings and figures are read; None if not known
    """

    states: Mapping[State, int]
    unsaved: dict[str, str]
    seconds: float
    busy_seconds: float
    finished: int = 0
    failures: Mapping[str, Sequence[str]] = field(default_factory=dict)
    damaged: Mapping[str, str] = field(default_factory=dict)
    remarks: Sequence[Remark] = ()
    folder: Path | None = None

    def __repr__(self) -> str:
        shown = ", ".join(f"{name} {value}" for name, value in self._in_short().items())
        return f"<SweepOutcome: {shown}>"

    def _repr_html_(self) -> str:
        from reconstruction.drawing import as_html

        return as_html("sweep", self._in_short(), self.plot())

    def _in_short(self) -> dict[str, str]:
        """Return the numbers of cases and the run time as texts by name."""
        ended = {state: str(count) for state, count in sorted(self.states.items())}
        failed = {"cases that failed": str(sum(map(len, self.failures.values())))}
        more = failed if self.failures else {}
        seconds = {"run time": f"{self.seconds:.1f} s"}
        return {"cases with a result": str(self.finished)} | more | ended | seconds

    def plot(self) -> "Drawing":
        """Draw figures of the finished cases over the first axis into a Matplotlib figure.

        Up to three figures are drawn, first the objectives of the study.

        Raises
        ------
        InputError : the store cannot be read
        """
        table = self.table
        goals = [goal.metric for goal in table.record.study.goals]
        names = dict.fromkeys((*goals, *table.metrics))
        return draw_rows(table.done(), (*table.axes, "case")[0], [*names])

    def to_xarray(self) -> "xarray.Dataset":
        """Return settings, state and figures of all cases of the study; dimension `case`.

        Raises
        ------
        InputError : the store cannot be read
        """
        return rows_as_arrays(self.table.rows, self.table.columns).to_xarray()

    @property
    def table(self) -> "StudyTable":
        """Table of settings and figures of all cases of the study.

        Raises
        ------
        InputError : the store cannot be read
        """
        from twin.study.table import read_table

        if self.folder is None:
            raise InputError("sweep: this outcome has no store; read its table from the folder")
        return read_table(self.folder)

    @classmethod
    def together(cls, parts: Sequence["SweepOutcome"]) -> "SweepOutcome":
        """Return the outcome of several successive runs as one: sums of counts and of times."""
        states: Counter[State] = Counter()
        for part in parts:
            states.update(part.states)
        return cls(
            states=states,
            unsaved={digest: why for part in parts for digest, why in part.unsaved.items()},
            seconds=sum(part.seconds for part in parts),
            busy_seconds=sum(part.busy_seconds for part in parts),
        )
