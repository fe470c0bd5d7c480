"""Tables with a `kind`: models of a registry as fields of documents."""

from collections.abc import Callable
from typing import Annotated, Literal

import pytest
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from reconstruction.registry import PluginError, Registry
from twin.config.base import Model
from twin.config.elastomer_models import MODELS, ModelFields
from twin.config.kinds import OneOf, TablesOf, follows, kind_of
from twin.config.schema import explain, list_keys


class Body(Model):
    kind: str
    x_mm: float = 0.0


def house() -> tuple[Registry[type[Body]], type[BaseModel]]:
    """Return a registry with two kinds, one of which contains others, and a document."""
    registry: Registry[type[Body]] = Registry("bodies", "tests", kind_of)

    @follows(registry)
    class Document(Model):
        model_config = ConfigDict(defer_build=True)
        body: Annotated[Body, OneOf(registry)]

    @registry.register
    class Cube(Body):
        kind: Literal["cube"] = "cube"
        edge_mm: float = 1.0

    @registry.register
    @follows(registry)
    class Heap(Body):
        model_config = ConfigDict(defer_build=True)
        kind: Literal["heap"] = "heap"
        parts: dict[str, Annotated[Body, OneOf(registry, without=("heap",))]]

    registry._is_complete = True  # the package `tests` is no home of kinds
    return registry, Document


def problem(check: Callable[[], object], document: type[BaseModel]) -> str:
    with pytest.raises(ValidationError) as caught:
        check()
    (line,) = explain(caught.value, document)
    return line


def test_a_table_is_checked_by_the_model_of_its_kind() -> None:
    _, document = house()
    tree = {"body": {"kind": "heap", "parts": {"a": {"kind": "cube", "edge_mm": 2.0}}}}
    loaded = document.model_validate(tree)
    assert loaded.body.parts["a"].edge_mm == 2.0  # type: ignore[attr-defined]
    assert document.model_validate(loaded.model_dump()) == loaded
    choices = document.model_json_schema()["properties"]["body"]["discriminator"]["mapping"]
    assert set(choices) == {"cube", "heap"}


def test_wrong_kinds_and_keys_are_one_line() -> None:
    _, document = house()
    for table, line in (
        ({"kind": "cub"}, "body.kind: found 'cub', allowed: 'cube', 'heap'; did you mean 'cube'?"),
        ({"edge_mm": 1.0}, "body.kind: missing in {'edge_mm': 1.0}; add it"),
        ({"kind": "cube", "edg_mm": 1}, "unknown key 'edg_mm' in [body]; did you mean 'edge_mm'?"),
        (
            {"kind": "heap", "parts": {"a": {"kind": "heap", "parts": {}}}},
            "body.parts.a.kind: found 'heap', allowed: 'cube'",
        ),
    ):
        assert problem(lambda t=table: document.model_validate({"body": t}), document) == line


def test_a_kind_registered_later_is_known_in_documents_and_within_other_kinds() -> None:
    registry, document = house()
    document.model_validate({"body": {"kind": "cube"}})

    @registry.register
    class Cone(Body):
        kind: Literal["cone"] = "cone"
        height_mm: float = 1.0

    loaded = document.model_validate({"body": {"kind": "heap", "parts": {"a": {"kind": "cone"}}}})
    assert type(loaded.body.parts["a"]) is Cone  # type: ignore[attr-defined]
    assert type(document.model_validate({"body": {"kind": "cone"}}).body) is Cone  # type: ignore[attr-defined]
    assert "body(cone).height_mm" in {key.path for key in list_keys(document)}


def test_a_model_without_a_kind_cannot_be_registered() -> None:
    registry, _ = house()

    class Nameless(Body):
        height_mm: float = 1.0

    with pytest.raises(PluginError, match=r"^Nameless: found no kind; set kind: Literal"):
        registry.register(Nameless)


class Springs(Model):
    stiffness: Annotated[float, Field(gt=0)] = 1.0


class Fluid(Model):
    viscosity: float = 2.0


def tables() -> tuple[dict[str, type[BaseModel]], type[BaseModel]]:
    """Return models by name, and a document with a table of each."""
    models: dict[str, type[BaseModel]] = {"springs": Springs}

    class Tables(Model):
        settings: Annotated[dict[str, Model], TablesOf(lambda: models)]

    return models, Tables


def test_tables_by_name_are_checked_by_the_model_of_the_name() -> None:
    models, document = tables()
    loaded = document.model_validate({"settings": {"springs": {"stiffness": 3.0}}})
    assert loaded.settings == {"springs": Springs(stiffness=3.0)}  # type: ignore[attr-defined]
    assert document.model_validate(loaded.model_dump()) == loaded
    assert loaded.model_dump(mode="json") == {"settings": {"springs": {"stiffness": 3.0}}}
    models["fluid"] = Fluid
    assert set(document.model_json_schema()["$defs"]) == {"Springs", "Fluid"}
    assert [key.path for key in list_keys(document)] == [
        "settings.springs.stiffness",
        "settings.fluid.viscosity",
    ]
    assert document.model_validate({"settings": {"fluid": {}}}).settings == {"fluid": Fluid()}  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("table", "line"),
    [
        ({"springs": {"stiffness": 0}}, "settings.springs.stiffness: found 0, should be greater"),
        (
            {"springs": {"stifness": 1}},
            "unknown key 'stifness' in [settings.springs]; did you",
        ),
        ({"spring": {}}, "unknown key 'spring' in [settings]; did you mean 'springs'?"),
        (3, "settings: found 3, allowed tables by name"),
    ],
)
def test_wrong_tables_by_name_are_one_line(table: object, line: str) -> None:
    _, document = tables()
    assert problem(lambda: document.model_validate({"settings": table}), document).startswith(line)


def test_a_document_without_tables_by_name_does_not_need_the_models() -> None:
    def absent() -> dict[str, type[BaseModel]]:
        raise AssertionError

    class Tables(Model):
        settings: Annotated[dict[str, Model], TablesOf(absent)]

    assert Tables.model_validate({"settings": {}}).settings == {}


def test_settings_of_an_elastomer_model_need_defaults() -> None:
    class Rigid(Model):
        limit: float

    class Plate(ModelFields):
        name = "plate"
        settings = Rigid

    with pytest.raises(PluginError, match="plate: settings: found no default of limit; add one"):
        MODELS.register(Plate())
