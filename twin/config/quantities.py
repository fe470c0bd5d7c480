"""Numbers in data files, with their unit, source and valid range.

    thickness_mm = { value = 2.0, range = [1.0, 5.0], source = "assumed: ..." }

The value is stored in the experiment. Source and range are stored in the table `provenance` of the
experiment, by dotted path. A value outside the range of its source gives a warning. A value outside
the physical range of its key (`twin.config.bounds`) is an error.

A number may be written with a unit in TOML, `thickness_mm = "120 um"`. The suffix of the key is
the unit of the stored number. A text with another unit of the same quantity is converted when the
file is read. Length, time, force, pressure and power have such units.
"""

import re
from collections.abc import Iterator, Mapping
from typing import Any, Protocol

from pydantic import ValidationError

from twin.config.base import SET_HERE, ConfigError
from twin.config.models import Provenance

_UNITS = {
    "length": {"nm": 1e-9, "um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0},
    "time": {"us": 1e-6, "ms": 1e-3, "s": 1.0},
    "force": {"n": 1.0, "mn": 1e-3},
    "pressure": {"pa": 1.0, "kpa": 1e3, "mpa": 1e6},
    "power": {"mw": 1e-3, "w": 1.0},
}
_SCALE_TO_SI = {unit: (kind, si) for kind, units in _UNITS.items() for unit, si in units.items()}
_NUMBER_AND_UNIT = re.compile(
    r"^\s*([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)\s*([A-Za-zµ]+)\s*$"
)
_KEYS = {"value", "source", "range"}


def convert_units(tree: dict[str, Any], path: str = "") -> dict[str, Any]:
    """Return tables with texts such as "120 um" replaced by numbers in the unit of their key.

    Parameters
    ----------
    tree : nested tables as read from TOML
    path : dotted path of `tree`, for messages

    Raises
    ------
    ConfigError : a unit is unknown, or is of another quantity than the key
    """
    return {key: _convert(key, value, f"{path}{key}") for key, value in tree.items()}


def _convert(key: str, value: Any, path: str) -> Any:
    if isinstance(value, dict):
        inner = convert_units(value, f"{path}.")
        if "value" in value and "source" in value:  # a quantity: its key states the unit
            inner["value"] = _convert(key, value["value"], path)
        return inner
    unit = key.rsplit("_", 1)[-1]
    if not isinstance(value, str) or unit not in _SCALE_TO_SI or "_" not in key:
        return value
    match = _NUMBER_AND_UNIT.match(value)
    return _rescale(float(match[1]), match[2], unit, path) if match else value


def _rescale(number: float, written: str, unit: str, path: str) -> float:
    quantity, scale = _SCALE_TO_SI[unit]
    kind_and_scale = _SCALE_TO_SI.get(written.replace("µ", "u").lower())
    if kind_and_scale is None or kind_and_scale[0] != quantity:
        allowed = ", ".join(_UNITS[quantity])
        raise ConfigError(f"{path}: found unit '{written}', allowed for a {quantity}: {allowed}")
    # Rounded to 15 digits, so that "120 um" becomes the same number as 0.12.
    return float(f"{number * kind_and_scale[1] / scale:.15g}")


def is_quantity(node: Any) -> bool:
    """Return True if a table is a number with source and range: keys value, source, range."""
    return isinstance(node, dict) and "value" in node and node.keys() <= _KEYS


def split_quantities(
    tree: dict[str, Any], prefix: str = ""
) -> tuple[dict[str, Any], dict[str, Provenance]]:
    """Return tables with plain values, and the provenance of the values by dotted path.

    Raises
    ------
    ConfigError : a quantity has no source
    """
    values: dict[str, Any] = {}
    provenance: dict[str, Provenance] = {}
    for key, node in tree.items():
        path = f"{prefix}{key}"
        if is_quantity(node):
            values[key], provenance[path] = node["value"], _provenance(node, path)
        elif isinstance(node, dict):
            values[key], inner = split_quantities(node, f"{path}.")
            provenance |= inner
        else:
            values[key] = node
    return values, provenance


def _provenance(node: dict[str, Any], path: str) -> Provenance:
    if "source" not in node:
        raise ConfigError(f"{path}: a quantity needs a source, for example 'assumed: reason'")
    try:
        return Provenance.model_validate({k: v for k, v in node.items() if k != "value"})
    except ValidationError as error:
        faults = (
            f"{path}.{'.'.join(map(str, fault['loc']))}: found {fault['input']!r}, allowed "
            f"{'a text' if fault['loc'][0] == 'source' else 'two numbers, low and high'}"
            for fault in error.errors()
        )
        raise ConfigError("\n".join(faults)) from None


class Sourced(Protocol):
    """Values with their provenance by dotted path, such as an `Experiment`."""

    @property
    def provenance(self) -> Mapping[str, Provenance]:
        """Source and range of each number that a data file states."""


def outside_sources(values: Sourced) -> tuple[str, ...]:
    """Return a warning for each value outside the range of its source, which the warning names."""
    return tuple(
        f"{path} = {value:g} is outside {_span(origin)}, the range of its source "
        f"({origin.source.removeprefix(SET_HERE)}); {_remedy(path, value, origin)}"
        for path, value, origin in _outside(values, values.provenance)
    )


def check_ranges(values: dict[str, Any], provenance: Mapping[str, Provenance], where: str) -> None:
    """Check the values of a file that states value and range of each number in the same table.

    Raises
    ------
    ConfigError : one line per value outside its range, which starts with `where`
    """
    problems = [
        f"{where}: {path}: found {value:g}, allowed {_span(origin)} ({origin.source}); give "
        f"another value, or {_remedy(path, value, origin)}"
        for path, value, origin in _outside(values, provenance)
    ]
    if problems:
        raise ConfigError("\n".join(problems))


def _outside(
    values: Any, provenance: Mapping[str, Provenance]
) -> Iterator[tuple[str, float, Provenance]]:
    """Yield path, value and origin of each number outside the range of its origin."""
    for path, origin in provenance.items():
        value = value_at(values, path)
        if origin.range is None or not isinstance(value, (int, float)):
            continue
        if not origin.range[0] <= value <= origin.range[1]:
            yield path, value, origin


def _span(origin: Provenance) -> str:
    low, high = origin.range or (0.0, 0.0)
    return f"{low:g} to {high:g}"


def _remedy(path: str, value: float, origin: Provenance) -> str:
    """Return the TOML line that states a value with a range and a source of the user."""
    (table, _, key), (low, high) = path.rpartition("."), origin.range or (value, value)
    return (
        f"write in [{table}] {key} = {{ value = {value:g}, range = [{min(low, value):g}, "
        f'{max(high, value):g}], source = "reason" }}'
    )


def value_at(values: Any, path: str) -> Any:
    """Return the value at a dotted path of nested tables or models; None if there is none."""
    node: Any = values
    for key in path.split("."):
        node = node.get(key) if isinstance(node, dict) else getattr(node, key, None)
    return node
