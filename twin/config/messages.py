"""Validation problems in one line each: what, where, found, allowed, what to do."""

import difflib
import typing
from typing import Any

from pydantic import BaseModel, ValidationError

from twin.config.models import Experiment


def explain(error: ValidationError) -> list[str]:
    """Turn pydantic's report into plain lines; a misspelt key gets a suggestion.

    A typo shows up twice (an unknown key and, for required fields, a missing one): the second
    line is dropped when the suggestion already names it.
    """
    lines, suggested = [], set()
    for item in error.errors(include_url=False):
        if item["type"] == "extra_forbidden":
            parent, key = _path(item["loc"][:-1]), str(item["loc"][-1])
            guess = _closest(key, item["loc"][:-1])
            suggested.add(f"{parent}.{guess}".lstrip("."))
            where = f"in [{parent}]" if parent else "at the top level"
            hint = f"; did you mean '{guess}'?" if guess else "; remove it"
            lines.append(f"unknown key '{key}' {where}{hint}")
    for item in error.errors(include_url=False):
        path = _path(item["loc"])
        if item["type"] == "missing" and path not in suggested:
            lines.append(f"{path}: missing; add it")
        elif item["type"] not in ("missing", "extra_forbidden"):
            lines.append(f"{path}: found {_short(item['input'])}, {_allowed(item['msg'])}")
    return lines


def _allowed(message: str) -> str:
    text = message.removeprefix("Value error, ").removeprefix("Input ")
    return text[0].lower() + text[1:]


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _path(loc: tuple[int | str, ...]) -> str:
    """Dotted path without the tags that pydantic inserts for unions (specimen.two_balls.x_mm)."""
    known = _kinds()
    return ".".join(str(part) for part in loc if part not in known)


def _kinds() -> set[str]:
    return {"ball", "two_balls", "constrained-float", "literal['auto']", "float"}


def _closest(key: str, loc: tuple[int | str, ...]) -> str | None:
    names = _field_names(Experiment, list(loc))
    found = difflib.get_close_matches(key, names, n=1, cutoff=0.6)
    return found[0] if found else None


def _field_names(model: type[BaseModel], loc: list[int | str]) -> list[str]:
    """Names of the fields of the model found at `loc`, following unions by their tag."""
    if not loc:
        return list(model.model_fields)
    field = model.model_fields.get(str(loc[0]))
    if field is None:
        return []
    options = typing.get_args(field.annotation) or (field.annotation,)
    models = [m for m in options if isinstance(m, type) and issubclass(m, BaseModel)]
    rest = loc[1:]
    if len(models) > 1 and rest:
        tagged = [m for m in models if m.model_fields["kind"].default == rest[0]]
        models, rest = tagged or models, rest[1:]
    return [name for m in models for name in _field_names(m, rest)]
