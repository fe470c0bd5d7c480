"""Configuration tables with a key `kind`, validated by the registered model of that kind.

    Material = Annotated[BaseMaterial, OneOf(MATERIALS)]
    Code = Annotated[str, NameOf(CODES)]
    Settings = Annotated[dict[str, Model], TablesOf(settings_models)]

A field of the first type takes a table; its key `kind` names the registered model that validates
the table. The schema of a document with such a field is built on first use, and again after each
plug-in. Such a document, and every document that contains it, has the decorator
`@follows(REGISTRY)` and sets `defer_build`. A field of the second type takes the name of a
registered kind. A field of the third type takes tables by the name of a kind, each validated by the
data model of that kind.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, TypeVar

from pydantic import (
    BaseModel,
    ConfigDict,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    create_model,
)
from pydantic_core import CoreSchema, core_schema

from reconstruction.errors import InputError
from reconstruction.registry import PluginError, Registry

Document = TypeVar("Document", bound=type[BaseModel])

_FOLLOWERS: dict[Registry[Any], list[type[BaseModel]]] = {}


def kind_of(model: type[BaseModel]) -> str:
    """Return the name of a model's kind: the default value of its field `kind`.

    Raises
    ------
    PluginError : the model sets no `kind`
    """
    field = getattr(model, "model_fields", {}).get("kind")
    if field is None or not isinstance(field.default, str):
        name = getattr(model, "__name__", model)
        raise PluginError(f"{name}: found no kind; set kind: Literal['NAME'] = 'NAME' in the model")
    return field.default


@dataclass(frozen=True)
class OneOf:
    """Annotation of a field that takes a table of any model in a registry, selected by `kind`.

    Attributes
    ----------
    registry : registry of the models
    without : kinds that are not allowed in this field
    default : kind of a table without the key `kind`; empty: each table must have the key
    """

    registry: Registry[Any]
    without: tuple[str, ...] = ()
    default: str = ""

    @property
    def models(self) -> dict[str, type[BaseModel]]:
        """The allowed models by the name of their kind, in alphabetical order."""
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
    """Return the default kind of each table of a document, by the key of the table.

    Tables without a default kind are left out.
    """
    return {
        name: marker.default
        for name, field in document.model_fields.items()
        for marker in field.metadata
        if isinstance(marker, OneOf) and marker.default
    }


@dataclass(frozen=True)
class NameOf:
    """Annotation of a text field that takes the name of a registered kind.

    Kinds that are registered later are allowed, too.

    Attributes
    ----------
    registry : registry of the kinds
    also : text that is allowed in addition, such as 'auto', without loading the registry
    """

    registry: Registry[Any]
    also: str = ""

    @property
    def allowed(self) -> str:
        """Allowed names as text: quoted and separated by vertical bars."""
        return " | ".join(f"'{name}'" for name in self._names)

    @property
    def meaning(self) -> str:
        """Name and summary of each kind as text, separated by semicolons."""
        return "; ".join(f"{name}: {kind.summary}" for name, kind in self.registry.items())

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self._known, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        return handler(schema) | {"enum": self._names}

    @property
    def _names(self) -> list[str]:
        return [*filter(None, [self.also]), *self.registry.names()]

    def _known(self, name: str) -> str:
        if self.also and name == self.also:
            return name
        try:
            self.registry[name]
        except InputError as error:
            # The key of the field replaces the name of the registry in the message.
            text = str(error).partition("', ")[2]
            also = f"allowed: {self.also}, " if self.also else "allowed: "
            raise ValueError(text.replace("allowed: ", also, 1)) from None
        return name


@dataclass(frozen=True)
class TablesOf:
    """Marks tables by the name of a kind, such as `[mechanics.settings.winkler]`.

    Attributes
    ----------
    models : returns the data model of each name; is not called for a document without such a table
    """

    models: Callable[[], dict[str, type[BaseModel]]]

    @property
    def table(self) -> type[BaseModel]:
        """Data model of the table that contains all of them, each at its defaults."""
        return _table_of(tuple(self.models().items()))

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self._validated)

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        return handler(self.table.__pydantic_core_schema__)

    def _validated(self, tables: Any) -> dict[str, BaseModel]:
        if not isinstance(tables, dict):
            raise ValueError("allowed tables by name")
        if not tables:
            return {}
        table = self.table.model_validate(tables)
        return {name: getattr(table, name) for name in tables}


@cache
def _table_of(models: tuple[tuple[str, type[BaseModel]], ...]) -> type[BaseModel]:
    fields: dict[str, Any] = {name: (model, model()) for name, model in models}
    return create_model("Settings", __config__=ConfigDict(extra="forbid"), **fields)


def follows(*registries: Registry[Any]) -> Callable[[Document], Document]:
    """Return a decorator of documents that have fields with the kinds of registries.

    The schema of the decorated class is built again when a registry gets a new kind.
    """

    def enter(document: Document) -> Document:
        for registry in registries:
            if registry not in _FOLLOWERS:
                _FOLLOWERS[registry] = []
                registry.on_change(partial(_build_again, _FOLLOWERS[registry]))
            _FOLLOWERS[registry].append(document)
        return document

    return enter


def _build_again(documents: list[type[BaseModel]]) -> None:
    # All schemas are deleted first, because a document would reuse the old schema of a document
    # inside it.
    for document in documents:
        if "__pydantic_core_schema__" in document.__dict__:
            del document.__pydantic_core_schema__
    for document in documents:
        document.model_rebuild(force=True)
