"""An experiment in at most 20 lines: the values that differ from the defaults of their keys.

Each table takes one line, or up to three if there is room. Values that were set in the experiment
itself precede those of its data files. Keys without a default are shown as well.
"""

from collections.abc import Iterator, Mapping
from textwrap import wrap
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from twin.config.base import SET_HERE

if TYPE_CHECKING:
    from twin.config.models import Experiment

MOST_LINES = 20
WIDTH = 100
_MARGIN = 13
_IN_HEADING = {"schema_version", "name", "description", "modality", "provenance"}
Item = tuple[str, Any]


def overview(experiment: "Experiment") -> str:
    """Return name, description and method, then one paragraph per table with changed values."""
    head = f"experiment {experiment.name} ({experiment.modality})"
    head += f": {experiment.description}" if experiment.description else ""
    tables = dict[str, list[Item]]()
    for path, value in _changed(experiment, ""):
        if path not in _IN_HEADING:
            table, _, _ = path.partition(".")
            tables.setdefault(table, []).append((path, value))
    for lines_each in (3, 2, 1):
        lines = [
            line
            for name, items in tables.items()
            for line in _paragraph(name, _sorted(name, items, experiment.provenance), lines_each)
        ]
        if len(lines) < MOST_LINES:
            break
    return "\n".join([_shortened(head, WIDTH), *lines])


def _changed(model: BaseModel, before: str) -> Iterator[Item]:
    """Yield path and value of the fields that have no default or another value than it."""
    for name, field in type(model).model_fields.items():
        value, path = getattr(model, name), f"{before}{name}"
        if name == "kind" and before:
            yield path, value
        elif path not in _IN_HEADING and not _is_default(value, field):
            yield from _inside(value, path)


def _inside(value: Any, path: str) -> Iterator[Item]:
    if isinstance(value, BaseModel):
        yield from _changed(value, f"{path}.")
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from _inside(item, f"{path}.{key}")
    elif isinstance(value, tuple) and value and isinstance(value[0], BaseModel):
        yield path, tuple(getattr(item, "name", item) for item in value)
    else:
        yield path, value


def _is_default(value: Any, field: FieldInfo) -> bool:
    if field.is_required():
        return False
    default = field.get_default(call_default_factory=True, validated_data={})
    if isinstance(value, BaseModel) and isinstance(default, Mapping):
        return not default and not value.model_dump(exclude_defaults=True)
    return bool(value == default)


def _sorted(table: str, items: list[Item], provenance: Mapping[str, Any]) -> list[Item]:
    """Return the kind first, then values of the experiment itself, then those of its files."""

    def is_of_a_file(item: Item) -> bool:
        origin = provenance.get(item[0])
        return origin is not None and not origin.source.startswith(SET_HERE)

    return sorted(items, key=lambda item: (item[0] != f"{table}.kind", is_of_a_file(item)))


def _paragraph(table: str, items: list[Item], most_lines: int) -> list[str]:
    """Return the values of a table as lines; the last one gives the number of omitted values."""
    texts = [_text(table, *item) for item in items]
    for shown in range(len(texts), -1, -1):
        more = len(texts) - shown
        listed = [*texts[:shown], *([f"and {more} more"] if more else [])]
        lines = wrap(", ".join(listed), WIDTH - _MARGIN, break_on_hyphens=False)
        if len(lines) <= most_lines:
            break
    names = [table, *[""] * len(lines)]
    return [f"{name:{_MARGIN}}{line}" for name, line in zip(names, lines, strict=False)]


def _text(table: str, path: str, value: Any) -> str:
    key = path.removeprefix(f"{table}.")
    shown = _shortened(_value(value), 60)
    return shown if key in ("kind", table) else f"{key}={shown}"


def _value(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{' '.join(map(_value, value))}]"
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "absent"}[value]
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _shortened(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most - 3]}..."
