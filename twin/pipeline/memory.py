"""Cache the latest results of each stage, and reuse a result if all fields that it used are equal.

A stage receives a proxy of the experiment, which records every field that the stage reads, with its
value. Stages are deterministic. A stage therefore returns the same bytes for every experiment with
the same values in these fields. No list of the fields on which a stage depends is maintained by
hand, and none can become outdated. (Mokhov, Mitchell, Peyton Jones: Build systems a la carte, ICFP
2018, call this a constructive trace.)
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

# Prefix of the record of a table of which fields were read one by one: no JSON text starts with it.
_PRESENT = b"table "


class Reads:
    """Fields of an experiment that a stage read, each with its value.

    A table is an object of the experiment with fields of its own, such as `camera`. A path is the
    tuple of the names that lead to a field or table.
    """

    def __init__(self) -> None:
        self._values: dict[Path, bytes] = {}

    @property
    def paths(self) -> tuple[Path, ...]:
        """Paths of the fields that were read, sorted.

        A table that may be of several kinds is one entry; its fields are not listed.
        """
        return tuple(sorted(self._values))

    def note(self, path: Path, value: Any) -> None:
        """Record that a field was read.

        Parameters
        ----------
        value : value of the field; for a table of which fields are read one by one its class
        """
        if not isinstance(value, type):
            self._values[path] = _content(path, value)
        elif path not in self._values:  # an entry with the table's whole content is not replaced
            self._values[path] = _presence(value)

    @classmethod
    def union(cls, parts: Iterable["Reads"]) -> "Reads":
        """Return the fields that at least one of several stages of one experiment read."""
        together = cls()
        for part in parts:
            for path, value in part._values.items():
                # A table's content is more specific than its presence.
                if not value.startswith(_PRESENT) or path not in together._values:
                    together._values[path] = value
        return together

    def as_json(self) -> list[Any]:
        """Return path and value of every field as a list that JSON can store, for `from_json`."""
        return [[list(path), value.decode()] for path, value in sorted(self._values.items())]

    @classmethod
    def from_json(cls, content: Iterable[Any]) -> "Reads":
        """Return the fields from the output of `as_json`."""
        reads = cls()
        reads._values = {tuple(path): value.encode() for path, value in content}
        return reads

    def hold_for(self, experiment: Experiment) -> bool:
        """Return True if an experiment has the recorded values in all recorded fields."""
        return all(_at(experiment, path, value) == value for path, value in self._values.items())


def watched(experiment: Experiment, reads: Reads) -> Experiment:
    """Return a proxy of an experiment that records in `reads` every field that is read."""
    return cast(Experiment, _Watched(experiment, reads, (), {}))


def values_at(experiment: Experiment, paths: Iterable[Path]) -> tuple[bytes, ...]:
    """Return the values of an experiment at paths of `Reads`, in their order, for comparison.

    The value of a table is only its kind if fields of the table are among the paths.
    """
    known_paths = list(paths)
    tables = {path[:-1] for path in known_paths}
    like = {path: _PRESENT if path in tables else b"" for path in known_paths}
    return tuple(_at(experiment, path, like[path]) for path in known_paths)


class _Watched:
    """Proxy of one table of an experiment that records which fields are read.

    Methods and properties of the table's class run on the proxy. Every other access, such as a
    comparison or a method of pydantic, is recorded as reading the whole table.
    """

    __slots__ = ("_watched_changes", "_watched_model", "_watched_path", "_watched_reads")

    def __init__(self, model: Model, reads: Reads, path: Path, changes: Mapping[str, Any]) -> None:
        self._watched_model, self._watched_reads, self._watched_path = model, reads, path
        self._watched_changes = changes

    def model_copy(self, *, update: Mapping[str, Any]) -> "_Watched":
        """Return a proxy with some fields replaced; reading a replaced field is not recorded."""
        changes = {**self._watched_changes, **update}
        return _Watched(self._watched_model, self._watched_reads, self._watched_path, changes)

    @property  # type: ignore[misc]  # read by isinstance and match
    def __class__(self) -> type:
        return type(self._watched_model)

    def __getattr__(self, name: str) -> Any:
        kind = type(self._watched_model)
        if name in kind.model_fields:
            return self._field(name)
        if name in kind.__class_vars__:
            return getattr(kind, name)  # the kind of a table is recorded with the table
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
    """Return True if a field can contain only one kind of table."""
    return len(models_of(kind.model_fields[name])) == 1


def _at(experiment: Experiment, path: Path, like: bytes) -> bytes:
    """Return the value of an experiment at a path as bytes, for comparison with `like`.

    If `like` records the kind of a table, the bytes are those of the kind, else of the content. A
    path that does not exist has the content None.
    """
    node: Any = experiment
    for name in path:
        node = getattr(node, name, None)
    if like.startswith(_PRESENT) and isinstance(node, Model):
        return _presence(type(node))
    return _content(path, node)


def _presence(kind: type) -> bytes:
    return _PRESENT + kind.__name__.encode()


def _content(path: Path, value: Any) -> bytes:
    """Return the canonical bytes of a value; the name of a file is replaced by its content."""
    if path and path[-1] == "file":
        value = with_file_contents({"file": value})
    elif isinstance(value, (Model, dict)):
        value = with_file_contents(to_jsonable_python(value))
    return to_json(value)


Result = TypeVar("Result")
_serial = itertools.count()


@dataclass(frozen=True, eq=False)
class CachedResult(Generic[Result]):
    """Result of one stage, with the fields and inputs from which it was computed.

    Attributes
    ----------
    outcome : the result, or the error that the stage raised
    token : unique number by which a later stage identifies this result as its input
    inputs : identifies the results of earlier stages that were used
    reads : fields of the experiment that the stage read
    """

    outcome: Result | InputError
    token: int
    inputs: Hashable
    reads: Reads

    @property
    def value(self) -> Result:
        """Result of the stage.

        Raises
        ------
        InputError : the error that the stage raised for these inputs when it was computed
        """
        if isinstance(self.outcome, InputError):
            raise self.outcome
        return self.outcome


class Memo(Generic[Result]):
    """Cache of the results of one stage; the least recently used result is removed first.

    Several threads may use the cache. If two need the same result at the same time, both compute
    it.

    Parameters
    ----------
    name : name of the stage
    capacity : largest number of results; one is enough if cases are sorted by their stages
    """

    def __init__(self, name: str, capacity: int = 1) -> None:
        self.name, self.computed, self.recalled = name, 0, 0
        self._results: deque[CachedResult[Result]] = deque(maxlen=capacity)
        self._lock = threading.Lock()

    @property
    def requests(self) -> int:
        """Number of requests for a result, computed or taken from the cache."""
        return self.computed + self.recalled

    @property
    def latest_reads(self) -> Reads | None:
        """Fields that were read for the most recently used result; None if there is no result."""
        return self._results[-1].reads if self._results else None

    def recall(
        self,
        experiment: Experiment,
        inputs: Hashable,
        compute: Callable[[Experiment], Result],
    ) -> CachedResult[Result]:
        """Return the result of the stage for an experiment, from the cache if possible.

        Parameters
        ----------
        inputs : identifies the results of earlier stages: their tokens, or digests of their
            contents
        compute : function that computes the result. It may read only the experiment that it
            receives, and the results that `inputs` identifies

        Raises
        ------
        InputError : the stage raises it for these inputs
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
        """Return the cached result, marked as the most recently used; None if it is not cached.

        If it is not cached and the cache is full, the least recently used result is removed.
        """
        for cached in self._results:
            if cached.inputs == inputs and cached.reads.hold_for(experiment):
                self.recalled += 1
                self._results.remove(cached)
                self._results.append(cached)
                return cached
        self.computed += 1
        if len(self._results) == self._results.maxlen:
            self._results.popleft()  # before the next is computed: both may need too much memory
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


# Stages in their order, and the number of cached results of each: a pressed face has a few MB, a
# stack of frames at full size 600 MB. One result is enough if cases are sorted by their stages. The
# calibration of a photometric sensor is first, because it takes longer than all later stages.
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
    """Cache of the stage results of measurements, for later measurements.

    A new memory is empty. Measurements that receive the same memory share results.

    Attributes
    ----------
    calibrations : folder in which calibrations of photometric sensors are stored for other
        processes, see `kept_calibrations`; None: they are not stored
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
        """Return the result of a stage, from the cache if possible; see `Memo.recall`."""
        return self._memos[stage].recall(experiment, inputs, compute)

    def requests(self) -> dict[str, int]:
        """Return the number of requests for results of each stage, by name of the stage."""
        return {name: memo.requests for name, memo in self._memos.items()}

    def stages(self) -> Iterator[tuple[str, int, int, tuple[Path, ...]]]:
        """Yield (name, number computed, number from the cache, paths read) for every stage.

        The stages are in their order. The paths are those of the most recently used result.
        """
        for memo in self._memos.values():
            reads = memo.latest_reads
            yield memo.name, memo.computed, memo.recalled, reads.paths if reads else ()
