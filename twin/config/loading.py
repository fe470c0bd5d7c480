"""Experiment files: read one, resolve the data files it uses, validate the whole, write it.

Any table may say `use = "scenes/..."`, `use = "materials/..."` or, with a file of one's own,
`use = "./coat.toml"`: that file is the base on which the table's own keys are laid. Names that
begin with `./` or `../` are found from the file that they stand in, meshes and tables alike.

A value may be that of another key: `thickness_mm = "= elastomer.thickness_mm"`. Such links are kept
in `[links]` and hold when the other key is varied; setting the key itself ends its link.

The result names no data file any more; it can be written, read back and rerun anywhere.

Validation problems are told in one line each: what, where, found, allowed, what to do.
The keys of a file are read off the models, too: no second list to keep true.
"""

import difflib
import types
import typing
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any, TypeVar

import tomli_w
from pydantic import BaseModel, ValidationError
from pydantic_core import PydanticUndefined

from reconstruction import reading
from reconstruction.errors import InputError
from reconstruction.reading import shown
from twin.assets import asset_path, scene_file
from twin.config.base import AssetCycleError, ConfigError
from twin.config.methods import TRAITS, Method
from twin.config.models import Conductor, Decode, Dielectric, Diffuse, Experiment, Layer, Plastic
from twin.config.quantities import (
    check_ranges,
    convert_units,
    is_quantity,
    split_quantities,
    value_at,
)

ABSENT = "absent"
"""Says that a key is not there, so that its default holds: TOML knows no null."""
# Files that use two files each, which use two each, would lay down thousands of tables.
MOST_USED_FILES = 200
_MOST_PROBLEMS = 20


def load_experiment(path: str | Path, overrides: Mapping[str, Any] | None = None) -> Experiment:
    """Load and validate an experiment.

    Parameters
    ----------
    path : a TOML file, or the name of a shipped one ("paper/two_balls")
    overrides : values by dotted path ("camera.binning") laid over the file

    Raises
    ------
    ConfigError : with one line per problem: what, where, found, allowed
    """
    file = scene_file(path)
    tree = resolve_uses(read_toml(file), (file,))
    for dotted, value in (overrides or {}).items():
        _assign(tree, dotted, value)
    return validate_experiment(tree, where=str(path))


def validate_experiment(tree: Mapping[str, Any], where: str = "experiment") -> Experiment:
    """Build an experiment from nested tables; every problem at once, one line each."""
    values, origins = split_quantities(convert_units(_linked(tree, where)))
    stated = values.pop("provenance", {})
    if not isinstance(stated, dict):
        raise ConfigError(f"{where}: provenance: found a value, allowed a table")
    values["provenance"] = stated | {key: origin.model_dump() for key, origin in origins.items()}
    experiment = validated(Experiment, values, f"{where}: ")
    check_ranges(values, experiment.provenance, where)
    return experiment


def decode_settings(**values: Any) -> Decode:
    """Validate the settings of the decoder alone, for captures that come without an experiment."""
    return validated(Decode, values, "decode.")


def vary(experiment: Experiment, changes: Mapping[str, Any]) -> Experiment:
    """Copy an experiment with values by dotted path replaced, validated again as a whole."""
    tree = experiment.model_dump(mode="python")
    for dotted, value in changes.items():
        _assign(tree, dotted, value)
    return validate_experiment(tree, where=experiment.name)


def by_method(method: Method) -> dict[str, Any]:
    """Return the changes that make an experiment one by another method.

    A bare specimen is seen through air, whatever the gel is seen through.
    """
    bare = {} if TRAITS[method].presses else {"layers": ABSENT}
    return {"modality": method} | bare


def _linked(tree: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Give every linked key the value of the key that it names, and list the links in [links]."""
    told = tree.get("links", {})
    if not isinstance(told, dict):
        raise ConfigError(f"{where}: links: found a value, allowed a table")
    links = {**told, **dict(_links_in(tree, ""))}
    try:
        order = [*TopologicalSorter({key: [named] for key, named in links.items()}).static_order()]
    except CycleError as error:
        circle = " = ".join(error.args[1])
        raise ConfigError(f"{where}: links lead back to themselves: {circle}") from None
    linked = _own_tables(tree)
    linked.pop("links", None)
    for key in order:
        if key in links:
            _assign(linked, key, _quantity_of(linked, key, links[key], where))
    return linked | ({"links": links} if links else {})


def _own_tables(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Copy nested tables; the values in them are never changed, only replaced."""
    return {k: _own_tables(node) if isinstance(node, dict) else node for k, node in tree.items()}


def _links_in(tree: Mapping[str, Any], before: str) -> Iterator[tuple[str, str]]:
    for key, node in tree.items():
        value = node["value"] if is_quantity(node) else node
        if isinstance(value, str) and value.startswith("=") and before + key != "description":
            yield f"{before}{key}", value.removeprefix("=").strip()
        elif isinstance(value, dict) and before + key not in ("links", "provenance"):
            yield from _links_in(value, f"{before}{key}.")


def _quantity_of(tree: dict[str, Any], key: str, named: Any, where: str) -> dict[str, Any]:
    found = value_at(tree, str(named))
    found = found["value"] if is_quantity(found) else found
    if found is None or isinstance(found, dict):
        what = "a table" if found is not None else "no value"
        raise ConfigError(f"{where}: {key} = '= {named}': found {what} there; name a key with one")
    return {"value": found, "source": f"as {named}"}


def read_toml(file: Path) -> dict[str, Any]:
    """Read a TOML file; one line says what is wrong with it."""
    try:
        return reading.read_toml(file)
    except InputError as error:
        raise ConfigError(str(error)) from None


def resolve_uses(
    tree: dict[str, Any], trail: tuple[Path, ...], used_files: list[Path] | None = None
) -> dict[str, Any]:
    """Lay tables over the data files that they `use`.

    Parameters
    ----------
    trail : the files that led here
    used_files : all that were laid down so far; None: none yet
    """
    laid = [] if used_files is None else used_files
    here = trail[-1]
    own = {
        key: resolve_uses(node, trail, laid) if isinstance(node, dict) else _from_here(node, here)
        for key, node in tree.items()
        if key != "use" or "/" not in str(node)  # decode.use = "column" is a value, no file
    }
    used = tree.get("use")
    if not isinstance(used, str) or "/" not in used:
        return own
    return _overlay(_load_used(used, trail, laid), own)


def _load_used(name: str, trail: tuple[Path, ...], laid: list[Path]) -> dict[str, Any]:
    file = _used_file(name, trail[-1])
    if file.resolve() in {one.resolve() for one in trail}:
        raise AssetCycleError(f"{trail[-1]}: use = '{name}' leads back to itself: remove one use")
    laid.append(file)
    if len(laid) > MOST_USED_FILES:
        raise ConfigError(
            f"{trail[0]}: use: found more than {MOST_USED_FILES} files, counted as often as they "
            f"are used, at {shown(trail[-1])}; use fewer"
        )
    tree = resolve_uses(read_toml(file), (*trail, file), laid)
    tree.pop("description", None)
    tree.pop("name", None)
    return tree


def _used_file(name: str, here: Path) -> Path:
    collection, _, rest = name.partition("/")
    if collection in ("scenes", "materials"):
        return asset_path("scenes" if collection == "scenes" else "materials", rest)
    if not _is_own(name):
        raise ConfigError(
            f"{here}: use = '{name}': must start with scenes/ or materials/, or with ./ for a file "
            "found from this one"
        )
    file = Path(_from_here(name, here))
    if not reading.is_regular(file):
        beside = sorted(path.name for path in file.parent.glob("*.toml"))
        close = difflib.get_close_matches(file.name, beside, n=1)
        hint = f"; did you mean {close[0]}?" if close else ""
        raise ConfigError(f"{here}: use = '{name}': there is no file {file}{hint}")
    return file


def _is_own(name: Any) -> bool:
    return isinstance(name, str) and name.startswith(("./", "../"))


def _from_here(value: Any, here: Path) -> Any:
    """Return a name that begins with ./ or ../ as the path from where the program runs."""
    return str(here.parent / value) if _is_own(value) else value


def _overlay(base: dict[str, Any], top: dict[str, Any]) -> dict[str, Any]:
    """Lay `top` over `base`; a plain value over a quantity keeps the quantity's valid range."""
    merged = dict(base)
    for key, node in top.items():
        under = merged.get(key)
        if is_quantity(node) or not isinstance(under, dict):
            merged[key] = node
        elif is_quantity(under):
            merged[key] = {**under, "value": node, "source": "set in the experiment"}
        elif isinstance(node, dict) and _same_kind(under, node):
            merged[key] = _overlay(under, node)
        else:
            merged[key] = node
    return merged


def _same_kind(base: dict[str, Any], top: dict[str, Any]) -> bool:
    """Tell whether two tables may share keys: a nut takes no diameter from a ball."""
    return "kind" not in base or top.get("kind", base["kind"]) == base["kind"]


def _assign(tree: dict[str, Any], dotted: str, value: Any) -> None:
    *parents, leaf = dotted.split(".")
    if len(parents) > reading.MOST_NESTED:
        raise ConfigError(
            f"{shown(dotted)}: found a path of {len(parents) + 1} keys, allowed up to "
            f"{reading.MOST_NESTED}"
        )
    node = tree
    for key in parents:
        node = node.setdefault(key, {})
        if not isinstance(node, dict):
            raise ConfigError(f"{dotted}: '{key}' is a value, not a table")
    if isinstance(tree.get("links"), dict):
        tree["links"] = {k: v for k, v in tree["links"].items() if not _sets(dotted, value, k)}
    if value == ABSENT:
        node.pop(leaf, None)
    else:
        node.update(_overlay(node, {leaf: value}))


def _sets(dotted: str, value: Any, key: str) -> bool:
    """Tell whether a value, a table perhaps, laid at a path sets a key, or takes it away."""
    if value == ABSENT:
        return key == dotted or key.startswith(f"{dotted}.")
    if isinstance(value, dict) and not is_quantity(value):
        inside = key.removeprefix(f"{dotted}.")
        return inside != key and value_at(value, inside) is not None
    return dotted == key


def to_toml(experiment: Experiment) -> str:
    """Return the resolved experiment as TOML text (values that are None are left out)."""
    return tomli_w.dumps(_without_none(experiment.model_dump(mode="json")))


def _without_none(node: Any) -> Any:
    if isinstance(node, dict):
        return {key: _without_none(value) for key, value in node.items() if value is not None}
    return [_without_none(one) for one in node] if isinstance(node, list) else node


Document = TypeVar("Document", bound=BaseModel)
Loc = tuple[int | str, ...]

# Branches of a union of plain values, such as camera.exposure_ms.
_SCALAR_TAGS = {"constrained-float", "float", "literal['auto']"}


def validated(document: type[Document], tree: Any, before: str = "") -> Document:
    """Build a document from nested tables; every problem at once, one line each after `before`."""
    try:
        return document.model_validate(tree)
    except ValidationError as error:
        lines = explain(error, document)
        if (more := len(lines) - _MOST_PROBLEMS) > 0:
            lines = [*lines[:_MOST_PROBLEMS], f"{more} more problems"]
        raise ConfigError("\n".join(before + line for line in lines)) from None


def explain(error: ValidationError, document: type[BaseModel]) -> list[str]:
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
        inner = [] if name == "material" else _parts_of(field.annotation)
        if name == "provenance":
            continue
        if not inner:
            limits = [_limit(item) for item in field.metadata]
            allowed = ", ".join([_type_name(field.annotation), *filter(None, limits)])
            required = field.default is PydanticUndefined
            default = "required" if required else str(field.default)
            yield Key(f"{prefix}{name}", allowed, default, field.description or "")
        for part in inner:
            tag = f"({part.model_fields['kind'].default})" if len(inner) > 1 else ""
            yield from list_keys(part, f"{prefix}{name}{tag}.")


def _parts_of(annotation: Any) -> list[type[BaseModel]]:
    if typing.get_origin(annotation) is dict:
        return []  # named parts, each one of the kinds listed beside it
    return _models(list(typing.get_args(annotation) or (annotation,)))


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
