"""Schema of configuration documents: list of their keys, and messages on invalid documents.

Each message is one line with key, found value, allowed values and remedy. Keys and ranges are read
from the models.
"""

import difflib
import itertools
import types
import typing
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from twin.assets import likely_material
from twin.config.base import ConfigError
from twin.config.bounds import Because
from twin.config.kinds import NameOf, OneOf, TablesOf, kind_of
from twin.config.materials import MATERIALS
from twin.config.models import Experiment, Layer

_MOST_PROBLEMS = 20

Document = TypeVar("Document", bound=BaseModel)
Loc = tuple[int | str, ...]

_WRONG_KIND = {"union_tag_invalid", "union_tag_not_found"}
_NO_TABLE = {"model_type", "model_attributes_type", "dict_type"}
_OUTSIDE = {"greater_than", "greater_than_equal", "less_than", "less_than_equal"}
# Names that pydantic inserts into paths for unions of plain values, such as camera.exposure_ms.
_SCALAR_TAGS = {"constrained-float", "float", "literal['auto']"}


def validated(document: type[Document], tree: Any, before: str = "") -> Document:
    """Return the document of nested tables, validated.

    Raises
    ------
    ConfigError : one line per problem, which starts with `before`
    """
    try:
        return document.model_validate(tree)
    except ValidationError as error:
        lines = explain(error, document)
        if (more := len(lines) - _MOST_PROBLEMS) > 0:
            lines = [*lines[:_MOST_PROBLEMS], f"{more} more problems"]
        raise ConfigError("\n".join(before + line for line in lines)) from None


def explain(error: ValidationError, document: type[BaseModel]) -> list[str]:
    """Return pydantic's errors on a document as lines of text; suggest keys for misspelt keys.

    A misspelt required key causes two errors: an unknown key and a missing key. The second line is
    omitted if the first line suggests the missing key.
    """
    lines: list[str] = []
    suggested, outside = set(), set()
    for item in error.errors(include_url=False):
        if item["type"] == "extra_forbidden":
            parent, key = _path(item["loc"][:-1], document), str(item["loc"][-1])
            # Limits the run time: suggestions for 100 000 unknown keys take minutes.
            shown = len(lines) < _MOST_PROBLEMS
            guess = _closest(key, item["loc"][:-1], document) if shown else None
            suggested.add(f"{parent}.{guess}".lstrip("."))
            where = f"in [{parent}]" if parent else "at the top level"
            used = item["input"] if key == "use" and isinstance(item["input"], str) else ""
            named = _material_hint(used, parent) if used and parent else ""
            hint = f"; did you mean '{guess}'?" if guess else named or "; remove it"
            lines.append(f"unknown key '{key}' {where}{hint}")
    for item in error.errors(include_url=False):
        path = _path(item["loc"], document)
        if item["type"] == "missing" and path not in suggested:
            lines.append(f"{path}: missing; add it")
        elif item["type"] in _WRONG_KIND:
            lines.append(_kind_line(path, item["ctx"], item["input"]))
        elif item["type"] not in ("missing", "extra_forbidden"):
            prefix = f"{path}: found {_short(item['input'])}, " if path else ""
            whole = _whole_range(item["loc"], document) if item["type"] in _OUTSIDE else ""
            if item["type"] in _NO_TABLE and isinstance(item["input"], str):
                whole = f"allowed a table{_material_hint(item['input'], path)}"
            if item["type"] == "literal_error" and path in outside:
                continue  # the number's range was reported already
            outside |= {path} if item["type"] in _OUTSIDE else set()
            lines.append(f"{prefix}{whole or _allowed(item['msg'])}")
    return lines


def _kind_line(path: str, context: Mapping[str, Any], table: Any) -> str:
    """Return the line of text on a table with an unknown or missing kind."""
    discriminator = str(context["discriminator"]).strip("'")
    key = f"{path}.{discriminator}"
    if "tag" not in context:
        used = table.get("use") if isinstance(table, dict) else None
        hint = _material_hint(used, path) if isinstance(used, str) else ""
        return f"{key}: missing in {_short(table)}{hint or '; add it'}"
    expected = str(context["expected_tags"])
    kinds = [name.strip(" '") for name in expected.split(",")]
    close = difflib.get_close_matches(context["tag"], kinds, n=1)
    hint = f"; did you mean '{close[0]}'?" if close else _material_hint(context["tag"], path)
    return f"{key}: found '{context['tag']}', allowed: {expected}{hint}"


def _material_hint(word: str, path: str) -> str:
    """Return the hint, after a semicolon, to write the file of a named material; empty if none."""
    file = likely_material(word, path, Experiment.model_fields)
    return f'; did you mean {path.rpartition(".")[2]} = {{ use = "{file}" }}?' if file else ""


def _whole_range(loc: Loc, document: type[BaseModel]) -> str:
    """Return the range of a number and its reason as text; empty if no reason is stated."""
    for metadata in _metadata_at(loc, document):
        reasons = [item.reason for item in metadata if isinstance(item, Because)]
        if reasons:
            return f"allowed {_limits(metadata)} ({reasons[0]})"
    return ""


def limits_at(path: str, document: type[BaseModel] = Experiment) -> tuple[float, ...]:
    """Return all limits, lower and upper, of the numbers at a dotted path as one flat tuple.

    The result does not distinguish between lower and upper limits, and is empty without limits.
    """
    return tuple(
        getattr(item, name)
        for metadata in _metadata_at(tuple(path.split(".")), document)
        for item in metadata
        for name in ("gt", "ge", "lt", "le")
        if hasattr(item, name)
    )


def keys_of_kind(path: str, kind: Any, document: type[BaseModel] = Experiment) -> set[str]:
    """Return the keys of a table of the given kind at a dotted path; empty if no such kind."""
    models = _walk(tuple(path.split(".")), document)[1]
    return {
        key
        for model in models
        if "kind" in model.model_fields and kind_of(model) == kind
        for key in model.model_fields
    }


def _metadata_at(loc: Loc, document: type[BaseModel]) -> list[list[Any]]:
    """Return the metadata of each annotated type that the field at a location may have."""
    named = [part for part in loc if isinstance(part, str) and part not in _SCALAR_TAGS]
    fields = (model.model_fields.get(named[-1]) for model in _walk(tuple(named[:-1]), document)[1])
    return [metadata for field in fields if field for metadata in _annotated(field)]


def _annotated(field: FieldInfo) -> Iterator[list[Any]]:
    """Yield the metadata of a field, and of each annotated type in its union or list."""
    yield field.metadata
    inside = [field.annotation]
    while inside:
        annotation = inside.pop()
        if typing.get_origin(annotation) is typing.Annotated:
            inner, *metadata = typing.get_args(annotation)
            yield _flat(metadata)
            inside.append(inner)
        else:
            inside += typing.get_args(annotation)


def _flat(metadata: Iterable[Any]) -> list[Any]:
    """Return metadata in which every `Field` is replaced by the metadata of that field."""
    return [part for item in metadata for part in getattr(item, "metadata", [item])]


def _allowed(message: str) -> str:
    text = message.removeprefix("Value error, ").removeprefix("Input ")
    return text[0].lower() + text[1:]


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _path(loc: Loc, document: type[BaseModel]) -> str:
    """Return the dotted path of a key as in a file, without the tags of pydantic for unions."""
    return ".".join(_walk(loc, document)[0])


def _closest(key: str, loc: Loc, document: type[BaseModel]) -> str | None:
    names = [name for model in _walk(loc, document)[1] for name in model.model_fields]
    matches = difflib.get_close_matches(key, names, n=1, cutoff=0.6)
    return matches[0] if matches else None


def _walk(loc: Loc, document: type[BaseModel]) -> tuple[list[str], list[type[BaseModel]]]:
    """Follow a location, as pydantic gives it, in a document; return its path and its models."""
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
    """Return the types that the field `part` of a model, or an entry of a table, may have."""
    if typing.get_origin(place) is dict:
        return _options(typing.get_args(place)[1])
    if typing.get_origin(place) is tuple:
        return _options(typing.get_args(place)[0])
    field = place.model_fields.get(part) if _models([place]) else None
    return _options_of(field) if field is not None else []


def _options_of(field: FieldInfo) -> list[Any]:
    """Return the types that a field may have: the kinds of its registry, if there is one."""
    return _kinds_in(field.metadata) or _options(field.annotation)


def _options(annotation: Any) -> list[Any]:
    if typing.get_origin(annotation) is typing.Annotated:
        inner, *metadata = typing.get_args(annotation)
        return _kinds_in(metadata) or _options(inner)
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return [option for part in typing.get_args(annotation) for option in _options(part)]
    return [annotation]


def _kinds_in(metadata: Iterable[Any]) -> list[Any]:
    kinds: list[Any] = []
    for item in metadata:
        kinds += item.models.values() if isinstance(item, OneOf) else []
        kinds += [item.table] if isinstance(item, TablesOf) else []
    return kinds


@dataclass(frozen=True)
class Key:
    """One key of an experiment file; path, allowed values, default and meaning are texts."""

    path: str
    allowed: str
    default: str
    meaning: str


def experiment_keys() -> Iterator[Key]:
    """Yield every key of an experiment file; keys of materials and layers come last."""
    yield from list_keys(Experiment)
    for kind, material in MATERIALS.items():
        yield from list_keys(material, f"specimen.material({kind}).")
    yield from list_keys(Layer, "layers.NAME.")


def list_keys(model: type[BaseModel], prefix: str = "") -> Iterator[Key]:
    """Yield every key of a model and of the models in its fields, in the order of the fields."""
    for name, field in model.model_fields.items():
        inner = models_of(field)
        if inner and set(inner) <= set(MATERIALS):
            inner = []
        if name == "provenance":
            continue
        if not inner:
            limits = _limits(field.metadata)
            text = ", ".join(filter(None, [_type_name(field.annotation), limits]))
            allowed = " | ".join(names.allowed for names in _names_in(field)) or text
            default = field.get_default(call_default_factory=True, validated_data={})
            default = "required" if field.is_required() else str(default)
            yield Key(f"{prefix}{name}", allowed, default, _meaning(field))
        for part in inner:
            tag = f"({part.model_fields['kind'].default})" if len(inner) > 1 else ""
            yield from list_keys(part, f"{prefix}{name}{tag}.")


def _meaning(field: FieldInfo) -> str:
    """Return the description of a key, and the reasons for its range, as text."""
    metadata = itertools.chain.from_iterable(_annotated(field))
    reasons = [item.reason for item in metadata if type(item) is Because]
    ranges = [f"range: {reason}" for reason in dict.fromkeys(reasons)]
    names = [marker.meaning for marker in _names_in(field)]
    return "; ".join(filter(None, [field.description, *names, *ranges]))


def _names_in(field: FieldInfo) -> list[NameOf]:
    return [item for item in field.metadata if isinstance(item, NameOf)]


def models_of(field: FieldInfo) -> list[type[BaseModel]]:
    """Return the models of the tables that a field may be; for a dict those of its values."""
    if typing.get_origin(field.annotation) is dict:
        # The keys are arbitrary names; the caller lists the tables under a placeholder.
        return _kinds_in(field.metadata)
    if typing.get_origin(field.annotation) is tuple:
        return _models(_options(typing.get_args(field.annotation)[0]))
    return _models(_options_of(field))


def _type_name(annotation: Any) -> str:
    if typing.get_origin(annotation) is typing.Literal:
        return " | ".join(repr(value) for value in typing.get_args(annotation))
    if typing.get_origin(annotation) is typing.Annotated:
        inner, *metadata = typing.get_args(annotation)
        return ", ".join(filter(None, [_type_name(inner), _limits(_flat(metadata))]))
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        kind = annotation.model_fields["kind"].default
        return "table" if kind is PydanticUndefined else f"table ({kind})"
    if typing.get_origin(annotation) in (dict, tuple):
        return _collection_name(annotation)
    parts = [part for part in typing.get_args(annotation) if part is not type(None)]
    if parts:
        return " | ".join(_type_name(part) for part in parts)
    names = {float: "number", int: "integer", bool: "true | false", str: "text"}
    return names.get(annotation, str(annotation))


def _collection_name(annotation: Any) -> str:
    if typing.get_origin(annotation) is dict:
        return "tables by name"
    items = typing.get_args(annotation)
    count = "" if Ellipsis in items else f"{len(items)} "
    if typing.get_origin(items[0]) is typing.Literal:
        return f"list of {_type_name(items[0])}"
    _, _, limits = _type_name(items[0]).partition(", ")
    return ", ".join(filter(None, [f"{count}numbers", limits]))


def _limits(metadata: Iterable[Any]) -> str:
    return ", ".join(filter(None, map(_limit, metadata)))


def _limit(item: Any) -> str:
    for name, sign in (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<=")):
        if hasattr(item, name):
            return f"{sign} {getattr(item, name):g}"
    return ""
