"""Lengths and times written with their unit in TOML: `thickness_mm = "120 um"`.

The key's suffix names the unit of the stored number; a string value may carry another unit of
the same quantity and is converted once, at the boundary.
"""

import re
from typing import Any

from twin.config.errors import ConfigError

_SCALE_TO_SI = {
    "nm": ("length", 1e-9),
    "um": ("length", 1e-6),
    "mm": ("length", 1e-3),
    "cm": ("length", 1e-2),
    "m": ("length", 1.0),
    "us": ("time", 1e-6),
    "ms": ("time", 1e-3),
    "s": ("time", 1.0),
    "n": ("force", 1.0),
    "mn": ("force", 1e-3),
    "pa": ("pressure", 1.0),
    "kpa": ("pressure", 1e3),
    "mpa": ("pressure", 1e6),
    "mw": ("power", 1e-3),
    "w": ("power", 1.0),
}
_NUMBER_AND_UNIT = re.compile(r"^\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*([A-Za-zµ]+)\s*$")


def convert_units(tree: dict[str, Any], path: str = "") -> dict[str, Any]:
    """Replace strings such as "120 um" by numbers in the unit of their key.

    Parameters
    ----------
    tree : dict
        Nested tables as read from TOML.
    path : str
        Dotted path of `tree`, for messages.

    Raises
    ------
    ConfigError
        The unit is unknown or measures something else than the key.
    """
    return {key: _convert(key, value, f"{path}{key}") for key, value in tree.items()}


def _convert(key: str, value: Any, path: str) -> Any:
    if isinstance(value, dict):
        inner = convert_units(value, f"{path}.")
        if "value" in value and "source" in value:  # a quantity: the unit is its own key's
            inner["value"] = _convert(key, value["value"], path)
        return inner
    unit = key.rsplit("_", 1)[-1]
    if not isinstance(value, str) or unit not in _SCALE_TO_SI or "_" not in key:
        return value
    match = _NUMBER_AND_UNIT.match(value)
    return _rescale(float(match[1]), match[2], unit, path) if match else value


def _rescale(number: float, written: str, wanted: str, path: str) -> float:
    quantity, scale = _SCALE_TO_SI[wanted]
    found = _SCALE_TO_SI.get(written.replace("µ", "u").lower())
    if found is None or found[0] != quantity:
        allowed = ", ".join(unit for unit, (kind, _) in _SCALE_TO_SI.items() if kind == quantity)
        raise ConfigError(f"{path}: found unit '{written}', allowed for a {quantity}: {allowed}")
    # One rounding step, so that "120 um" is the same number as 0.12.
    return float(f"{number * found[1] / scale:.15g}")
