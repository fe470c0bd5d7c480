"""Tables with a `kind`: one of the models that a registry holds.

    Material = Annotated[BaseMaterial, OneOf(MATERIALS)]

A field of this type takes a table whose key `kind` names a registered model, and is checked by that
model. A document with such a field is built when it is first used, and again after each plug-in: it
stands under `@follows(REGISTRY)` and sets `defer_build`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from pydantic import BaseModel, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from reconstruction.registry import Registry

Document = TypeVar("Document", bound=type[BaseModel])


def kind_of(model: type[BaseModel]) -> str:
    """Return the `kind` of a model: the default of that field."""
    return str(model.model_fields["kind"].default)


@dataclass(frozen=True)
class OneOf:
    """Marks a type as one of the models of a registry, told apart by their `kind`.

    Attributes
    ----------
    without : kinds that are not allowed here
    """

    registry: Registry[Any]
    without: tuple[str, ...] = ()

    @property
    def models(self) -> dict[str, type[BaseModel]]:
        """The allowed models by kind, in alphabetical order."""
        return {name: kind for name, kind in self.registry.items() if name not in self.without}

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        choices = {name: handler.generate_schema(model) for name, model in self.models.items()}
        return core_schema.tagged_union_schema(choices, discriminator="kind")


def follows(*registries: Registry[Any]) -> Callable[[Document], Document]:
    """Build the decorated document again when a registry gets another kind.

    A kind that holds other kinds is built before the documents that hold it: they copy its schema.
    """

    def enter(document: Document) -> Document:
        model: type[BaseModel] = document
        is_kind = "kind" in model.model_fields
        for registry in registries:
            registry.on_change(lambda: document.model_rebuild(force=True), first=is_kind)
        return document

    return enter
