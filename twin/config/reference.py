"""The experiment file's reference, read off the models: no second list to keep true."""

import typing
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from twin.config.models import Conductor, Dielectric, Diffuse, Experiment, Layer, Plastic


@dataclass(frozen=True)
class Key:
    """One key of an experiment file."""

    path: str
    allowed: str
    default: str
    meaning: str


def experiment_keys() -> Iterator[Key]:
    """Yield every key of an experiment file, the materials' once at the end."""
    yield from list_keys(Experiment)
    for material in (Conductor, Dielectric, Diffuse, Plastic):
        kind = material.model_fields["kind"].default
        yield from list_keys(material, f"specimen.material({kind}).")
    yield from list_keys(Layer, "layers.NAME.")


def list_keys(model: type[BaseModel], prefix: str = "") -> Iterator[Key]:
    """Yield every key of a model and of the models inside it, in file order."""
    for name, field in model.model_fields.items():
        inner = [] if name == "material" else _models_in(field.annotation)
        if name == "provenance":
            continue
        if not inner:
            yield Key(f"{prefix}{name}", _allowed(field), _default(field), field.description or "")
        for part in inner:
            tag = f"({part.model_fields['kind'].default})" if len(inner) > 1 else ""
            yield from list_keys(part, f"{prefix}{name}{tag}.")


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if typing.get_origin(annotation) is dict:
        return []  # named parts, each one of the kinds listed beside it
    found = typing.get_args(annotation) or (annotation,)
    return [part for part in found if isinstance(part, type) and issubclass(part, BaseModel)]


def _allowed(field: FieldInfo) -> str:
    limits = [_limit(item) for item in field.metadata]
    return ", ".join([_type_name(field.annotation), *filter(None, limits)])


def _type_name(annotation: Any) -> str:
    if typing.get_origin(annotation) is typing.Literal:
        return " | ".join(repr(value) for value in typing.get_args(annotation))
    if typing.get_origin(annotation) is typing.Annotated:
        inner, *metadata = typing.get_args(annotation)
        limits = [_limit(item) for extra in metadata for item in getattr(extra, "metadata", [])]
        return ", ".join([_type_name(inner), *filter(None, limits)])
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return f"table ({annotation.model_fields['kind'].default})"
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
    return "numbers" if Ellipsis in items else f"{len(items)} numbers"


def _limit(item: Any) -> str:
    for name, sign in (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<=")):
        if hasattr(item, name):
            return f"{sign} {getattr(item, name):g}"
    return ""


def _default(field: FieldInfo) -> str:
    return "required" if field.default is PydanticUndefined else str(field.default)
