"""Cache the stages' latest results; reuse one if every field that its stage read is the same.

A stage is handed a watched experiment, which notes every field that is read and the value found
there. The stage is deterministic, so it takes the same course, and gives the same bytes, for every
experiment with the same values in these fields: no list of "fields that matter to the press" is
kept by hand, and none can become outdated. (Mokhov, Mitchell, Peyton Jones: Build systems a la
carte, ICFP 2018, call this a constructive trace.)
"""

import inspect
import itertools
import threading
import types
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path as Folder
from typing import Any, Generic, TypeVar, cast

from pydantic import BaseModel
from pydantic_core import to_json, to_jsonable_python

from reconstruction.errors import InputError
from twin.config import Experiment
from twin.config.base import Model
from twin.config.digest import with_file_contents
from twin.config.schema import models_of

Path = tuple[str, ...]

# Prefix of the kind of a table that was accessed: no JSON text starts with it.
_PRESENT = b"table "


class Reads:
    """The fields that were read, each with the value that was found."""

    def __init__(self) -> None:
        self._values: dict[Path, bytes] = {}

    @property
    def paths(self) -> tuple[Path, ...]:
        """Paths that were read, sorted; a table that is one of several kinds counts as a whole."""
        return tuple(sorted(self._values))

    def note(self, path: Path, value: Any) -> None:
        """Enter a field; of a table that is looked into only that it is there."""
        if not isinstance(value, type):
            self._values[path] = _content(path, value)
        elif path not in self._values:  # read as a whole before: more specific
            self._values[path] = _presence(value)

    @classmethod
    def union(cls, parts: Iterable["Reads"]) -> "Reads":
        """Return the fields that were read by any of several stages of one experiment."""
        together = cls()
        for part in parts:
            for path, value in part._values.items():
                # A table's content is more specific than its presence.
                if not value.startswith(_PRESENT) or path not in together._values:
                    together._values[path] = value
        return together

    def as_json(self) -> list[Any]:
        """Return path and value of every field, for `from_json`."""
        return [[list(path), value.decode()] for path, value in sorted(self._values.items())]

    @classmethod
    def from_json(cls, content: Iterable[Any]) -> "Reads":
        """Return the reads from the output of `as_json`."""
        reads = cls()
        reads._values = {tuple(path): value.encode() for path, value in content}
        return reads

    def hold_for(self, experiment: Experiment) -> bool:
        """Return True if another experiment has the same values in all these fields."""
        return all(_at(experiment, path, value) == value for path, value in self._values.items())


def watched(experiment: Experiment, reads: Reads) -> Experiment:
    """Return a proxy of an experiment that records the fields read of it in `reads`."""
    return cast(Experiment, _Watched(experiment, reads, (), {}))


def values_at(experiment: Experiment, paths: Iterable[Path]) -> tuple[bytes, ...]:
    """Values of an experiment in fields that were read, comparable and in their order.

    Of a table that was looked into only its presence counts: its fields are among the paths.
    """
    known_paths = list(paths)
    tables = {path[:-1] for path in known_paths}
    like = {path: _PRESENT if path in tables else b"" for path in known_paths}
    return tuple(_at(experiment, path, like[path]) for path in known_paths)


class _Watched:
    """Proxy of one table; everything that is not a plain field read counts as reading all."""

    __slots__ = ("_watched_changes", "_watched_model", "_watched_path", "_watched_reads")

    def __init__(self, model: Model, reads: Reads, path: Path, changes: Mapping[str, Any]) -> None:
        self._watched_model, self._watched_reads, self._watched_path = model, reads, path
        self._watched_changes = changes

    def model_copy(self, *, update: Mapping[str, Any]) -> "_Watched":
        """Return a changed copy: replaced fields do not count as read, the rest when accessed."""
        changes = {**self._watched_changes, **update}
        return _Watched(self._watched_model, self._watched_reads, self._watched_path, changes)

    @property  # type: ignore[misc]  # isinstance and match ask for it
    def __class__(self) -> type:
        return type(self._watched_model)

    def __getattr__(self, name: str) -> Any:
        kind = type(self._watched_model)
        if name in kind.model_fields:
            return self._field(name)
        if name in kind.__class_vars__:
            return getattr(kind, name)  # the kind of a table is noted with the table
        if not hasattr(BaseModel, name):
            attribute = inspect.getattr_static(kind, name, None)
            if isinstance(attribute, property) and attribute.fget is not None:
                return attribute.fget(self)
            if isinstance(attribute, types.FunctionType):
                return types.MethodType(attribute, self)
        return getattr(self._whole(), name)

    def _field(self, name: str) -> Any:
        if name in self._watched_changes:
            return self._watched_changes[name]
        value, path = getattr(self._watched_model, name), (*self._watched_path, name)
        if isinstance(value, Model) and _only_kind(type(self._watched_model), name):
            self._watched_reads.note(path, type(value))
            return _Watched(value, self._watched_reads, path, {})
        self._watched_reads.note(path, value)
        return value

    def _whole(self) -> Model:
        self._watched_reads.note(self._watched_path, self._watched_model)
        changes = {
            name: value._whole() if type(value) is _Watched else value
            for name, value in self._watched_changes.items()
        }
        return self._watched_model.model_copy(update=changes)

    def __eq__(self, other: object) -> bool:
        return self._whole() == other

    def __hash__(self) -> int:
        return hash(self._whole())

    def __repr__(self) -> str:
        return repr(self._whole())

    def __reduce_ex__(self, protocol: Any) -> Any:
        return self._whole().__reduce_ex__(protocol)


def _only_kind(kind: type[BaseModel], name: str) -> bool:
    """Return True if a field has a single kind of table; several kinds are read by `type()`."""
    return len(models_of(kind.model_fields[name])) == 1


def _at(experiment: Experiment, path: Path, like: bytes) -> bytes:
    """Value at a path in the form in which `like` is given; empty if it does not exist."""
    node: Any = experiment
    for name in path:
        node = getattr(node, name, None)
    if like.startswith(_PRESENT) and isinstance(node, Model):
        return _presence(type(node))
    return _content(path, node)


def _presence(kind: type) -> bytes:
    return _PRESENT + kind.__name__.encode()


def _content(path: Path, value: Any) -> bytes:
    """Canonical bytes of a value; a named file counts by its content."""
    if path and path[-1] == "file":
        value = with_file_contents({"file": value})
    elif isinstance(value, (Model, dict)):
        value = with_file_contents(to_jsonable_python(value))
    return to_json(value)


Result = TypeVar("Result")
_serial = itertools.count()


@dataclass(frozen=True, eq=False)
class CachedResult(Generic[Result]):
    """A result with the fields and inputs it was computed from.

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
        InputError : raised by the stage for these inputs, now or before
        """
        if isinstance(self.outcome, InputError):
            raise self.outcome
        return self.outcome


class Memo(Generic[Result]):
    """Results of one stage, the least recently used forgotten first.

    Several threads may use it; two that need the same result at the same time both compute it.

    Parameters
    ----------
    name : name of the stage, for counting
    capacity : how many results are kept; one is enough when cases come sorted by their stages
    """

    def __init__(self, name: str, capacity: int = 1) -> None:
        self.name, self.computed, self.recalled = name, 0, 0
        self._results: deque[CachedResult[Result]] = deque(maxlen=capacity)
        self._lock = threading.Lock()

    @property
    def requests(self) -> int:
        """Number of requests for a result."""
        return self.computed + self.recalled

    @property
    def latest_reads(self) -> Reads | None:
        """Fields that the latest computation looked at."""
        return self._results[-1].reads if self._results else None

    def recall(
        self,
        experiment: Experiment,
        inputs: Hashable,
        compute: Callable[[Experiment], Result],
    ) -> CachedResult[Result]:
        """Return the result for an experiment, computed only if no kept one is the same.

        Parameters
        ----------
        inputs : identifies the results of earlier stages: their tokens, or digests of their
            contents
        compute : the stage. It may look at the experiment that it is handed, and at its inputs,
            only
        """
        with self._lock:
            result = self._taken(experiment, inputs)
        if result is None:
            result = _kept(experiment, inputs, compute)
            with self._lock:
                self._results.append(result)
        result.value  # noqa: B018  # raises the stage's error
        return result

    def _taken(self, experiment: Experiment, inputs: Hashable) -> CachedResult[Result] | None:
        """Return a kept result, now the latest used, or make room for the one to be computed."""
        for cached in self._results:
            if cached.inputs == inputs and cached.reads.hold_for(experiment):
                self.recalled += 1
                self._results.remove(cached)
                self._results.append(cached)
                return cached
        self.computed += 1
        if len(self._results) == self._results.maxlen:
            self._results.popleft()  # before the next is made: two may not fit into memory
        return None


def _kept(
    experiment: Experiment, inputs: Hashable, compute: Callable[[Experiment], Result]
) -> CachedResult[Result]:
    reads = Reads()
    try:
        outcome: Result | InputError = compute(watched(experiment, reads))
    except InputError as error:
        outcome = error.with_traceback(None)
    return CachedResult(outcome, next(_serial), inputs, reads)


# Stages in their order, and how many results of each are kept: a pressed face has a few MB, a stack
# of frames at full size 600 MB. One is enough if cases are sorted by their stages. First the
# calibration of a photometric sensor: it takes longer than all later stages.
_CAPACITY = {
    "sensor": 2,
    "references": 2,
    "calibrations": 2,
    "shape": 8,
    "press": 8,
    "texture": 8,
    "geometry": 1,
    "view": 1,
    "trace": 1,
    "prediction": 1,
    "photons": 1,
    "tables": 8,
    "frames": 1,
    "capture": 1,
    "reconstruction": 1,
    "image": 1,
}


class Memory:
    """Cache of the stages of measurements for later measurements; empty at first.

    Attributes
    ----------
    calibrations : folder in which calibrations of photometric sensors are kept for other processes,
        see `kept_calibrations`; None: they are not
    """

    def __init__(self) -> None:
        self.calibrations: Folder | None = None
        self._memos: dict[str, Memo[Any]] = {n: Memo(n, most) for n, most in _CAPACITY.items()}

    def recall(
        self,
        stage: str,
        experiment: Experiment,
        inputs: Hashable,
        compute: Callable[[Experiment], Result],
    ) -> CachedResult[Result]:
        """Return a stage's result, computed only if no kept one is the same; see `Memo.recall`."""
        return self._memos[stage].recall(experiment, inputs, compute)

    def requests(self) -> dict[str, int]:
        """Return the number of requests for each stage's result."""
        return {name: memo.requests for name, memo in self._memos.items()}

    def stages(self) -> Iterator[tuple[str, int, int, tuple[Path, ...]]]:
        """Yield name, times computed, times recalled and fields read of every stage in order."""
        for memo in self._memos.values():
            reads = memo.latest_reads
            yield memo.name, memo.computed, memo.recalled, reads.paths if reads else ()
