"""Find out which fields of an experiment a computation reads.

A stage is handed a watched experiment, which notes every field that is read and the value found
there. The stage is deterministic, so it takes the same course, and gives the same bytes, for every
experiment with the same values in these fields: no list of "what matters to the press" is kept by
hand, and none can go stale. (Mokhov, Mitchell, Peyton Jones: Build systems a la carte, ICFP 2018,
call this a constructive trace.)
"""

import inspect
import types
import typing
from collections.abc import Iterable, Mapping
from typing import Any, cast

from pydantic import BaseModel
from pydantic_core import to_json, to_jsonable_python

from twin.config import Experiment
from twin.config.base import Model
from twin.config.digest import with_file_contents

Path = tuple[str, ...]


class Reads:
    """The fields that were read, each with the value that was found."""

    def __init__(self) -> None:
        self._found: dict[Path, bytes] = {}

    @property
    def paths(self) -> tuple[Path, ...]:
        """What was read, in alphabetical order; a table that is one of several kinds is whole."""
        return tuple(sorted(self._found))

    def note(self, path: Path, value: Any) -> None:
        """Enter a field; of a table that is looked into only that it is there."""
        if not isinstance(value, type):
            self._found[path] = _content(path, value)
        elif path not in self._found:  # read as a whole before: that says more
            self._found[path] = _presence(value)

    def hold_for(self, experiment: Experiment) -> bool:
        """Tell whether another experiment has the same values in all these fields."""
        return all(_at(experiment, path, kept) == kept for path, kept in self._found.items())


def watched(experiment: Experiment, reads: Reads) -> Experiment:
    """Return a stand-in for an experiment that enters what is read of it into `reads`."""
    return cast(Experiment, _Watched(experiment, reads, (), {}))


def values_at(experiment: Experiment, paths: Iterable[Path]) -> tuple[bytes, ...]:
    """Values of an experiment in fields that were read, comparable and in their order.

    Of a table that was looked into only its presence counts: its fields are among the paths.
    """
    found = list(paths)
    tables = {path[:-1] for path in found}
    like = {path: b"table " if path in tables else b"" for path in found}
    return tuple(_at(experiment, path, like[path]) for path in found)


class _Watched:
    """Stand-in for one table; everything that is not a plain field read counts as reading all."""

    __slots__ = ("_watched_changes", "_watched_model", "_watched_path", "_watched_reads")

    def __init__(self, model: Model, reads: Reads, path: Path, changes: Mapping[str, Any]) -> None:
        self._watched_model, self._watched_reads, self._watched_path = model, reads, path
        self._watched_changes = changes

    def model_copy(self, *, update: Mapping[str, Any]) -> "_Watched":
        """Return a changed copy: what is replaced is not read of it, the rest when looked at."""
        changes = {**self._watched_changes, **update}
        return _Watched(self._watched_model, self._watched_reads, self._watched_path, changes)

    @property  # type: ignore[misc]  # isinstance and match ask for it
    def __class__(self) -> type:
        return type(self._watched_model)

    def __getattr__(self, name: str) -> Any:
        kind = type(self._watched_model)
        if name in kind.model_fields:
            return self._field(name)
        if not hasattr(BaseModel, name):
            found = inspect.getattr_static(kind, name, None)
            if isinstance(found, property) and found.fget is not None:
                return found.fget(self)
            if isinstance(found, types.FunctionType):
                return types.MethodType(found, self)
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
    """Tell whether a field holds one kind of table; one of several is looked at by `type()`."""
    return len(_models_in(kind.model_fields[name].annotation)) == 1


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in typing.get_args(annotation) for model in _models_in(part)]


def _at(experiment: Experiment, path: Path, like: bytes) -> bytes:
    """Value at a path in the form in which `like` is given; empty where there is nothing."""
    node: Any = experiment
    for name in path:
        node = getattr(node, name, None)
    if like.startswith(b"table ") and isinstance(node, Model):
        return _presence(type(node))
    return _content(path, node)


def _presence(kind: type) -> bytes:
    return b"table " + kind.__name__.encode()


def _content(path: Path, value: Any) -> bytes:
    """Canonical bytes of a value; a named file counts by its content."""
    if path and path[-1] == "file":
        value = with_file_contents({"file": value})
    elif isinstance(value, (Model, dict)):
        value = with_file_contents(to_jsonable_python(value))
    return to_json(value)
