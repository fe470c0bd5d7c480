"""Experiment files: read a file, resolve the data files that it uses, validate, write.

Any table may set `use = "scenes/..."`, `use = "materials/..."` or, for a user's file,
`use = "./coat.toml"`. The keys of the table override those of the used file. Names of files that
start with `./` or `../` are relative to the file that contains the name.

A value may be linked to another key: `thickness_mm = "= elastomer.thickness_mm"`. Links are stored
in `[links]`. The value follows later changes of the other key. Setting the value itself removes
its link.

The resolved experiment does not refer to any data file. It can be saved, loaded and run on any
machine.
"""

import difflib
import math
from collections.abc import Iterator, Mapping
from copy import deepcopy
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any

import tomli_w

from reconstruction import reading
from reconstruction.errors import InputError, require_instance
from reconstruction.reading import shown
from twin.assets import asset_path, scene_file
from twin.config.base import SET_HERE, AssetCycleError, ConfigError
from twin.config.kinds import default_kinds
from twin.config.methods import TRAITS, Method
from twin.config.models import Decode, Experiment
from twin.config.optics import Optics
from twin.config.quantities import (
    convert_units,
    is_quantity,
    split_quantities,
    value_at,
)
from twin.config.rig import derived_keys
from twin.config.schema import keys_of_kind, validated

ABSENT = "absent"
"""Value that removes a key, so that the default of the key applies; TOML has no null."""
# Limit, because files that use two files each, over many levels, would expand to thousands of
# tables.
MOST_USED_FILES = 200


def load_experiment(path: str | Path, overrides: Mapping[str, Any] | None = None) -> Experiment:
    """Load and validate an experiment from a file, or a shipped experiment.

    Parameters
    ----------
    path : a TOML file, or the name of a shipped experiment ("paper/two_balls")
    overrides : values by dotted path ("camera.binning") that replace those of the file

    Raises
    ------
    ConfigError : with one line per problem: key, found, allowed, remedy
    """
    file = scene_file(path)
    own = read_toml(file)
    tree = resolve_uses(own, (file,))
    changes = {} if overrides is None else overrides
    _assign_all(tree, changes)
    stated = _own_tables(own)
    _assign_all(stated, changes)
    return validate_experiment(tree, where=str(path), stated=stated)


def require_experiment(value: object) -> None:
    """Raise InputError if a value is not an `Experiment`."""
    remedy = "give an experiment, as twin.load_experiment returns it"
    require_instance("experiment", value, Experiment, remedy)


def validate_experiment(
    tree: Mapping[str, Any], where: str = "experiment", stated: Mapping[str, Any] | None = None
) -> Experiment:
    """Return the experiment of nested tables; raise ConfigError with one line per problem.

    Parameters
    ----------
    stated : the tables that the user wrote, without those of used files: a key in them must not
        contradict the value that follows from [optics]; None: no key is checked
    """
    linked = _linked(tree, where)
    if "optics" in linked:
        linked = _with_derived_keys(linked, where, {} if stated is None else stated)
    values, origins = split_quantities(convert_units(linked))
    sources = values.pop("provenance", {})
    if not isinstance(sources, dict):
        raise ConfigError(f"{where}: provenance: found a value, allowed a table")
    values["provenance"] = sources | {key: origin.model_dump() for key, origin in origins.items()}
    return validated(Experiment, values, f"{where}: ")


def decode_settings(**values: Any) -> Decode:
    """Return validated settings of the decoder, for captures without an experiment."""
    return validated(Decode, values, "decode.")


def vary(experiment: Experiment, changes: Mapping[str, Any]) -> Experiment:
    """Return a validated copy of an experiment with some values replaced.

    Parameters
    ----------
    changes : new values by the dotted path of their key, for example {"camera.binning": 2}

    Raises
    ------
    ConfigError : a path does not exist, or the changed experiment is invalid
    """
    require_experiment(experiment)
    tree, stated = experiment.model_dump(mode="python"), dict[str, Any]()
    _assign_all(tree, changes)
    _assign_all(stated, changes)
    return validate_experiment(tree, where=experiment.name, stated=stated)


def as_built(experiment: Experiment) -> Experiment:
    """Return the experiment with the numbers of its rig, without the requests of [optics].

    A rig that deviates from its design, as a drawn one does, keeps its other numbers.
    """
    return experiment.model_copy(update={"optics": Optics()})


def by_method(method: Method) -> dict[str, Any]:
    """Return the changes that convert an experiment to another method.

    A method without a press images the bare specimen through air: it has no layers.
    """
    bare = {} if TRAITS[method].presses else {"layers": ABSENT}
    return {"modality": method} | bare


def _linked(tree: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return tables with every linked key set to the value of the key that it names.

    All links are listed in the table `links`.
    """
    listed = tree.get("links", {})
    if not isinstance(listed, dict):
        raise ConfigError(f"{where}: links: found a value, allowed a table")
    for key, named in listed.items():
        if not isinstance(named, str):
            raise ConfigError(f"{where}: links.{key}: found {named!r}, allowed the name of a key")
    links = {**listed, **dict(_links_in(tree, ""))}
    try:
        order = [*TopologicalSorter({key: [named] for key, named in links.items()}).static_order()]
    except CycleError as error:
        circle = " = ".join(error.args[1])
        raise ConfigError(f"{where}: found a cycle of links: {circle}; remove one") from None
    linked = _own_tables(tree)
    linked.pop("links", None)
    for key in order:
        if key in links:
            _assign(linked, key, _quantity_of(linked, key, links[key], where))
    return linked | ({"links": links} if links else {})


def _with_derived_keys(
    linked: dict[str, Any], where: str, stated: Mapping[str, Any]
) -> dict[str, Any]:
    """Return tables with the keys of camera and projector that follow from [optics].

    Raises
    ------
    ConfigError : a request cannot be met, or `stated` has another value of such a key
    """
    derived = derived_keys(_plain(linked), where)
    written, problems = _plain(stated) if derived else {}, []
    for path, key in derived.items():
        value = value_at(written, path)
        if not _is_same(value, key.value):
            problems.append(
                f"{where}: {path}: found {value}, allowed {key.value:.6g}, {key.source}; remove "
                "this key, or those of [optics] from which it follows"
            )
        _assign(linked, path, {"value": key.value, "source": key.source})
    if problems:
        raise ConfigError("\n".join(problems))
    return _linked(linked, where)


def _is_same(value: Any, derived: float) -> bool:
    """Return True if a key is not stated, or has the derived value, or is another kind of error."""
    if isinstance(value, (int, float)):
        return math.isclose(value, derived, rel_tol=1e-9, abs_tol=1e-9)
    return not isinstance(value, str)


def _plain(tree: Mapping[str, Any]) -> dict[str, Any]:
    return split_quantities(convert_units(dict(tree)))[0]


def _own_tables(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy of nested tables; the values in them are not copied."""
    return {k: _own_tables(node) if isinstance(node, dict) else node for k, node in tree.items()}


def _links_in(tree: Mapping[str, Any], before: str) -> Iterator[tuple[str, str]]:
    for key, node in tree.items():
        value = node["value"] if is_quantity(node) else node
        if isinstance(value, str) and value.startswith("=") and before + key != "description":
            yield f"{before}{key}", value.removeprefix("=").strip()
        elif isinstance(value, dict) and before + key not in ("links", "provenance"):
            yield from _links_in(value, f"{before}{key}.")


def _quantity_of(tree: dict[str, Any], key: str, named: Any, where: str) -> dict[str, Any]:
    node = value_at(tree, str(named))
    value = node["value"] if is_quantity(node) else node
    if value is None or isinstance(value, dict):
        kind = "a table" if value is not None else "no value"
        raise ConfigError(f"{where}: {key} = '= {named}': found {kind} there; name a key with one")
    return {"value": value, "source": f"as {named}"}


def read_toml(file: Path) -> dict[str, Any]:
    """Return the tables of a TOML file; raise ConfigError with one line if the file is invalid."""
    try:
        return reading.read_toml(file)
    except InputError as error:
        raise ConfigError(str(error)) from None


def resolve_uses(
    tree: dict[str, Any], trail: tuple[Path, ...], used_files: list[Path] | None = None
) -> dict[str, Any]:
    """Return tables merged with the data files that they `use`; keys of the tables override.

    Parameters
    ----------
    trail : the chain of files, each used by the one before, up to the file that contains `tree`
    used_files : list of all files used so far, to which further files are appended; None: empty
    """
    laid = [] if used_files is None else used_files
    here = trail[-1]
    own = {
        key: resolve_uses(node, trail, laid) if isinstance(node, dict) else _from_here(node, here)
        for key, node in tree.items()
        if key != "use" or "/" not in str(node)  # decode.use = "column" is a value, not a file
    }
    used = tree.get("use")
    if not isinstance(used, str) or "/" not in used:
        return own
    return _overlay(_load_used(used, trail, laid), own)


def _load_used(name: str, trail: tuple[Path, ...], laid: list[Path]) -> dict[str, Any]:
    file = _used_file(name, trail[-1])
    if file.resolve() in {path.resolve() for path in trail}:
        raise AssetCycleError(f"{trail[-1]}: use = '{name}' is cyclic: remove one use")
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
            "relative to this file"
        )
    file = Path(_from_here(name, here))
    if not reading.is_regular(file):
        siblings = sorted(path.name for path in file.parent.glob("*.toml"))
        close = difflib.get_close_matches(file.name, siblings, n=1)
        hint = f"; did you mean {close[0]}?" if close else ""
        raise ConfigError(f"{here}: use = '{name}': there is no file {file}{hint}")
    return file


def _is_own(name: Any) -> bool:
    return isinstance(name, str) and name.startswith(("./", "../"))


def _from_here(value: Any, here: Path) -> Any:
    """Return a value; a file name that starts with ./ or ../ is joined to the folder of `here`."""
    return str(here.parent / value) if _is_own(value) else value


def _overlay(base: dict[str, Any], top: dict[str, Any]) -> dict[str, Any]:
    """Return `base` with the keys of `top`; a plain value keeps the range of the old quantity."""
    merged = dict(base)
    for key, node in top.items():
        under = merged.get(key)
        if is_quantity(node) or not isinstance(under, dict):
            merged[key] = node
        elif is_quantity(under):
            merged[key] = {**under, "value": node, "source": _set_here(under)}
        elif isinstance(node, dict) and _same_kind(under, node, key):
            merged[key] = _overlay(under, node)
        else:
            merged[key] = node
    return merged


def _set_here(under: Mapping[str, Any]) -> Any:
    """Return the source of a plain value that replaces a quantity: it names that of the range."""
    source = under.get("source")
    return source if str(source).startswith(SET_HERE) else f"{SET_HERE}{source}"


def _same_kind(base: dict[str, Any], top: dict[str, Any], key: str) -> bool:
    """Return True if two tables are of the same kind, so that their keys may be merged."""
    kind = base.get("kind", default_kinds(Experiment).get(key))
    return kind is None or top.get("kind", kind) == kind


def _assign_all(tree: dict[str, Any], changes: Mapping[str, Any]) -> None:
    remedy = 'give values by dotted path, for example {"camera.binning": 2}'
    require_instance("changes", changes, Mapping, remedy)
    for dotted, value in changes.items():
        require_instance("path of a change", dotted, str, remedy)
        # A copy: a later change may set a key of this table, which belongs to the caller.
        _assign(tree, dotted, deepcopy(value))


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
    if _is_absent(value):
        node.pop(leaf, None)
    else:
        if leaf == "kind" and parents:
            _drop_keys_of_other_kinds(node, ".".join(parents), value)
        node.update(_overlay(node, {leaf: value}))


def _drop_keys_of_other_kinds(node: dict[str, Any], path: str, kind: Any) -> None:
    """Delete the keys of a table that its new kind does not have."""
    if node.get("kind", default_kinds(Experiment).get(path)) == kind:
        return
    keys = keys_of_kind(path, kind)
    for key in [key for key in node if keys and key not in keys]:
        del node[key]


def _is_absent(value: Any) -> bool:
    return isinstance(value, str) and value == ABSENT


def _sets(dotted: str, value: Any, key: str) -> bool:
    """Return True if assigning a value or a table to a path sets or removes the key `key`."""
    if _is_absent(value):
        return key == dotted or key.startswith(f"{dotted}.")
    if isinstance(value, dict) and not is_quantity(value):
        inside = key.removeprefix(f"{dotted}.")
        return inside != key and value_at(value, inside) is not None
    return dotted == key


def to_toml(experiment: Experiment) -> str:
    """Return the resolved experiment as TOML text; values that are None are left out."""
    return tomli_w.dumps(_without_none(experiment.model_dump(mode="json")))


def _without_none(node: Any) -> Any:
    if isinstance(node, dict):
        return {key: _without_none(value) for key, value in node.items() if value is not None}
    return [_without_none(item) for item in node] if isinstance(node, list) else node
