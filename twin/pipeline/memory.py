"""Keep the stages' latest results and hand them out again where nothing that they read differs."""

import itertools
from collections import deque
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from reconstruction.errors import InputError
from twin.config import Experiment
from twin.pipeline.reads import Path, Reads, watched

Result = TypeVar("Result")
_serial = itertools.count()


@dataclass(frozen=True, eq=False)
class Kept(Generic[Result]):
    """A result with what it was made from.

    Attributes
    ----------
    outcome : the result, or why there is none
    token : names this result as input of a later stage; no two results share one
    reads : fields of the experiment that the stage looked at
    """

    outcome: Result | InputError
    token: int
    inputs: Hashable
    reads: Reads

    @property
    def value(self) -> Result:
        """The result.

        Raises
        ------
        InputError
            The stage refused: it would again.
        """
        if isinstance(self.outcome, InputError):
            raise self.outcome
        return self.outcome


class Memo(Generic[Result]):
    """Results of one stage, the least recently used forgotten first.

    Parameters
    ----------
    name : str
        Name of the stage, for counting.
    capacity : int
        How many results are kept; one is enough when cases come sorted by their stages.
    """

    def __init__(self, name: str, capacity: int = 1) -> None:
        self.name, self.computed, self.recalled = name, 0, 0
        self._kept: deque[Kept[Result]] = deque(maxlen=capacity)

    @property
    def latest_reads(self) -> Reads | None:
        """Fields that the latest computation looked at."""
        return self._kept[-1].reads if self._kept else None

    def recall(
        self,
        experiment: Experiment,
        inputs: Hashable,
        compute: Callable[[Experiment], Result],
    ) -> Kept[Result]:
        """Return the result for an experiment, computed only if no kept one is the same.

        Parameters
        ----------
        experiment : Experiment
        inputs : hashable
            Names what comes from earlier stages: their tokens, or digests of their contents.
        compute : callable
            The stage. It may look at the experiment that it is handed, and at its inputs, only.
        """
        found = self._find(experiment, inputs)
        if found is not None:
            self.recalled += 1
            self._kept.remove(found)
        else:
            self.computed += 1
            if len(self._kept) == self._kept.maxlen:
                self._kept.popleft()  # before the next is made: two may not fit into memory
            found = _kept(experiment, inputs, compute)
        self._kept.append(found)
        found.value  # noqa: B018  # raises what the stage raised
        return found

    def _find(self, experiment: Experiment, inputs: Hashable) -> Kept[Result] | None:
        for kept in self._kept:
            if kept.inputs == inputs and kept.reads.hold_for(experiment):
                return kept
        return None


def _kept(
    experiment: Experiment, inputs: Hashable, compute: Callable[[Experiment], Result]
) -> Kept[Result]:
    reads = Reads()
    try:
        outcome: Result | InputError = compute(watched(experiment, reads))
    except InputError as error:
        outcome = error.with_traceback(None)
    return Kept(outcome, next(_serial), inputs, reads)


# Stages in their order, and how many results of each are kept: a pressed face has a few MB, a stack
# of frames at full size 600 MB. One is enough where cases come sorted by their stages.
_CAPACITY = {
    "shape": 8,
    "press": 8,
    "texture": 8,
    "geometry": 1,
    "view": 1,
    "trace": 1,
    "photons": 1,
    "frames": 1,
    "capture": 1,
    "reconstruction": 1,
    "sensor": 2,
    "references": 2,
    "calibrations": 2,
    "image": 1,
}


class Memory:
    """What the stages of measurements keep for the next one; a new one is empty."""

    def __init__(self) -> None:
        self._memos: dict[str, Memo[Any]] = {n: Memo(n, most) for n, most in _CAPACITY.items()}

    def recall(
        self,
        stage: str,
        experiment: Experiment,
        inputs: Hashable,
        compute: Callable[[Experiment], Result],
    ) -> Kept[Result]:
        """Return a stage's result, computed only if no kept one is the same; see `Memo.recall`."""
        return self._memos[stage].recall(experiment, inputs, compute)

    def stages(self) -> Iterator[tuple[str, int, int, tuple[Path, ...]]]:
        """Yield name, times computed, times recalled and fields read of every stage in order."""
        for memo in self._memos.values():
            reads = memo.latest_reads
            yield memo.name, memo.computed, memo.recalled, reads.paths if reads else ()
