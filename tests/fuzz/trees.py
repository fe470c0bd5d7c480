"""Input documents for a model: mostly valid, with faults in between."""

import copy
import types
import typing
from collections.abc import Iterable, Iterator
from typing import Any

from hypothesis import strategies as st
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from twin.config.kinds import OneOf

_HOSTILE = st.sampled_from(
    [
        None, True, False, 0, -1, 1, 10**30, -(10**400), 1e300, -1e300, 5e-324, float("nan"),
        float("inf"), float("-inf"), "", " ", "= a", "= ", "absent", "nan", "\x00", "x" * 1000,
        "[bold]", "$\\frac{$", "=cmd|' /C calc'!A0", "../..", "./x", "scenes/x", [], [[]], {},
        {"value": 1}, {"value": float("nan"), "range": [0, 1]}, {"value": 1, "source": 3},
        {"value": {"value": 1}}, {"use": "scenes/rigs/slab"}, {"kind": "ball"}, {"": 1}, {"a.b": 1},
    ]
)  # fmt: skip
_MOST_DEEP = 4


def documents(model: type[BaseModel]) -> st.SearchStrategy[dict[str, Any]]:
    """Return nested tables for a model: fields left out, odd values, unknown keys."""
    return _tables(model, 0)


def _tables(model: type[BaseModel], depth: int) -> st.SearchStrategy[dict[str, Any]]:
    fields = {
        name: st.one_of(_of_field(field, depth + 1), _HOSTILE)
        for name, field in model.model_fields.items()
    }
    known = st.fixed_dictionaries({}, optional=fields)
    extra = st.dictionaries(st.text(max_size=5), _HOSTILE, max_size=1)
    return st.tuples(known, extra).map(lambda both: both[0] | both[1])


def _of_field(field: FieldInfo, depth: int) -> st.SearchStrategy[Any]:
    return _marked(field.annotation, field.metadata, depth)


def _marked(annotation: Any, metadata: Iterable[Any], depth: int) -> st.SearchStrategy[Any]:
    """Return values for a type, or for each kind of the registry that marks it."""
    marks = [marker for marker in metadata if isinstance(marker, OneOf)]
    kinds = [kind for marker in marks for kind in marker.models.values()] or [annotation]
    return st.one_of([_values(kind, depth) for kind in kinds])


def damaged(tree: dict[str, Any]) -> st.SearchStrategy[dict[str, Any]]:
    """Return a tree with one to three of its values or tables replaced by odd values."""
    places = list(_places(tree, ()))
    faults = st.lists(st.tuples(st.sampled_from(places), _HOSTILE), min_size=1, max_size=3)
    return faults.map(lambda chosen: _with_faults(tree, chosen))


def _places(node: Any, here: tuple[Any, ...]) -> Iterator[tuple[Any, ...]]:
    children = node.items() if isinstance(node, dict) else enumerate(node)
    for key, child in children:
        yield (*here, key)
        if isinstance(child, dict | list):
            yield from _places(child, (*here, key))


def _with_faults(tree: dict[str, Any], chosen: list[tuple[tuple[Any, ...], Any]]) -> dict[str, Any]:
    changed = copy.deepcopy(tree)
    for (*parents, last), value in chosen:
        node: Any = changed
        for key in parents:
            node = node[key] if isinstance(node, dict | list) and _has(node, key) else None
        if isinstance(node, dict) or (isinstance(node, list) and _has(node, last)):
            node[last] = value
    return changed


def _has(node: Any, key: Any) -> bool:
    return key in node if isinstance(node, dict) else isinstance(key, int) and key < len(node)


def _values(kind: Any, depth: int) -> st.SearchStrategy[Any]:
    if depth > _MOST_DEEP:
        return _HOSTILE
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return _tables(kind, depth)
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if origin is not None:
        return _generic(origin, parts, depth)
    plain = {bool: st.booleans(), int: st.integers(), float: st.floats(), str: st.text(max_size=9)}
    return plain.get(kind, _HOSTILE)


def _generic(origin: Any, parts: tuple[Any, ...], depth: int) -> st.SearchStrategy[Any]:
    if origin is typing.Literal:
        return st.sampled_from(parts)
    if origin is typing.Annotated:
        return _marked(parts[0], parts[1:], depth)
    inner = [_values(part, depth) for part in parts if part is not ...]
    if origin in (typing.Union, types.UnionType):
        return st.one_of(inner)
    if origin in (tuple, list):
        return st.lists(st.one_of(inner), max_size=3)
    return st.dictionaries(st.text(max_size=8), inner[-1], max_size=2)
