"""Tables with a `kind`: one of the models that a registry holds.

    Material = Annotated[BaseMaterial, OneOf(MATERIALS)]

A field of this type takes a table whose key `kind` names a registered model, and is checked by that
model. A document with such a field is built when it is first used, and again after each plug-in: it
stands under `@follows(REGISTRY)` and sets `defer_build`, and so does every document that contains
such a document.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, TypeVar

from pydantic import BaseModel, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from reconstruction.registry import Registry

Document = TypeVar("Document", bound=type[BaseModel])

_FOLLOWERS: dict[Registry[Any], list[type[BaseModel]]] = {}


def kind_of(model: type[BaseModel]) -> str:
    """Return the `kind` of a model: the default of that field."""
    return str(model.model_fields["kind"].default)


@dataclass(frozen=True)
class OneOf:
    """Marks a type as one of the models of a registry, told apart by their `kind`.

    Attributes
    ----------
    without : kinds that are not allowed here
    default : kind of a table that names none; empty: each table must name its kind
    """

    registry: Registry[Any]
    without: tuple[str, ...] = ()
    default: str = ""

    @property
    def models(self) -> dict[str, type[BaseModel]]:
        """The allowed models by kind, in alphabetical order."""
        return {name: kind for name, kind in self.registry.items() if name not in self.without}

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        choices = {name: handler.generate_schema(model) for name, model in self.models.items()}
        schema = core_schema.tagged_union_schema(choices, discriminator="kind")
        if not self.default:
            return schema
        return core_schema.no_info_before_validator_function(self._with_kind, schema)

    def _with_kind(self, table: Any) -> Any:
        return {"kind": self.default, **table} if isinstance(table, dict) else table


@cache
def default_kinds(document: type[BaseModel]) -> dict[str, str]:
    """Return the kind that a table of a document has where it names none, by the table's key."""
    return {
        name: marker.default
        for name, field in document.model_fields.items()
        for marker in field.metadata
        if isinstance(marker, OneOf) and marker.default
    }


def follows(*registries: Registry[Any]) -> Callable[[Document], Document]:
    """Build the decorated document again when a registry gets another kind."""

    def enter(document: Document) -> Document:
        for registry in registries:
            if registry not in _FOLLOWERS:
                _FOLLOWERS[registry] = []
                registry.on_change(partial(_build_again, _FOLLOWERS[registry]))
            _FOLLOWERS[registry].append(document)
        return document

    return enter


def _build_again(documents: list[type[BaseModel]]) -> None:
    # First all are forgotten: one that contains another would be built with its old schema.
    for document in documents:
        if "__pydantic_core_schema__" in document.__dict__:
            del document.__pydantic_core_schema__
    for document in documents:
        document.model_rebuild(force=True)
