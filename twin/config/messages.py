"""Validation problems in one line each: what, where, found, allowed, what to do."""

import difflib
import types
import typing
from typing import Any

from pydantic import BaseModel, ValidationError

from twin.config.models import Experiment

Loc = tuple[int | str, ...]

# Branches of a union of plain values, such as camera.exposure_ms.
_SCALAR_TAGS = {"constrained-float", "float", "literal['auto']"}


def explain(error: ValidationError, document: type[BaseModel] = Experiment) -> list[str]:
    """Turn pydantic's report on a document into plain lines; a misspelt key gets a suggestion.

    A typo shows up twice (an unknown key and, for required fields, a missing one): the second
    line is dropped when the suggestion already names it.
    """
    lines, suggested = [], set()
    for item in error.errors(include_url=False):
        if item["type"] == "extra_forbidden":
            parent, key = _path(item["loc"][:-1], document), str(item["loc"][-1])
            guess = _closest(key, item["loc"][:-1], document)
            suggested.add(f"{parent}.{guess}".lstrip("."))
            where = f"in [{parent}]" if parent else "at the top level"
            hint = f"; did you mean '{guess}'?" if guess else "; remove it"
            lines.append(f"unknown key '{key}' {where}{hint}")
    for item in error.errors(include_url=False):
        path = _path(item["loc"], document)
        if item["type"] == "missing" and path not in suggested:
            lines.append(f"{path}: missing; add it")
        elif item["type"] not in ("missing", "extra_forbidden"):
            found = f"{path}: found {_short(item['input'])}, " if path else ""
            lines.append(f"{found}{_allowed(item['msg'])}")
    return lines


def _allowed(message: str) -> str:
    text = message.removeprefix("Value error, ").removeprefix("Input ")
    return text[0].lower() + text[1:]


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _path(loc: Loc, document: type[BaseModel]) -> str:
    """Dotted path as a user writes it: without the tags that pydantic inserts for unions."""
    return ".".join(_walk(loc, document)[0])


def _closest(key: str, loc: Loc, document: type[BaseModel]) -> str | None:
    names = [name for model in _walk(loc, document)[1] for name in model.model_fields]
    found = difflib.get_close_matches(key, names, n=1, cutoff=0.6)
    return found[0] if found else None


def _walk(loc: Loc, document: type[BaseModel]) -> tuple[list[str], list[type[BaseModel]]]:
    """Follow a location from the document; return its path and the models found at its end."""
    path: list[str] = []
    here: list[Any] = [document]
    for part in map(str, loc):
        kinds = {
            m.model_fields["kind"].default: m for m in _models(here) if "kind" in m.model_fields
        }
        if len(kinds) > 1 and part in kinds:
            here = [kinds[part]]
        elif part not in _SCALAR_TAGS:
            path.append(part)
            here = [option for place in here for option in _inside(place, part)]
    return path, _models(here)


def _models(options: list[Any]) -> list[type[BaseModel]]:
    return [part for part in options if isinstance(part, type) and issubclass(part, BaseModel)]


def _inside(place: Any, part: str) -> list[Any]:
    """Types that a field of a model, or a value of a table by name, may have."""
    if typing.get_origin(place) is dict:
        return _options(typing.get_args(place)[1])
    if typing.get_origin(place) is tuple:
        return _options(typing.get_args(place)[0])
    field = place.model_fields.get(part) if _models([place]) else None
    return _options(field.annotation) if field is not None else []


def _options(annotation: Any) -> list[Any]:
    if typing.get_origin(annotation) is typing.Annotated:
        annotation = typing.get_args(annotation)[0]
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return list(typing.get_args(annotation))
    return [annotation]
