"""Numbers with their source and valid range, as data files write them.

    thickness_mm = { value = 2.0, range = [1.0, 5.0], source = "assumed: ..." }

The value goes into the experiment, source and range into its provenance, keyed by dotted path.
"""

from typing import Any

from twin.config.errors import ConfigError
from twin.config.models import Provenance

_KEYS = {"value", "source", "range"}


def is_quantity(node: Any) -> bool:
    """Tell whether a table is one number with its source."""
    return isinstance(node, dict) and "value" in node and node.keys() <= _KEYS


def split_quantities(
    tree: dict[str, Any], prefix: str = ""
) -> tuple[dict[str, Any], dict[str, Provenance]]:
    """Separate plain values from their provenance.

    Raises
    ------
    ConfigError
        A quantity without a source.
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
        raise ConfigError(f"{path}: a quantity needs a source; write 'assumed: why' if it is one")
    return Provenance.model_validate({k: v for k, v in node.items() if k != "value"})


def check_ranges(values: dict[str, Any], provenance: dict[str, Provenance]) -> list[str]:
    """List every value outside the range that its data file states, one line each."""
    problems = []
    for path, origin in provenance.items():
        value = _lookup(values, path)
        if origin.range is None or not isinstance(value, (int, float)):
            continue
        low, high = origin.range
        if not low <= value <= high:
            problems.append(
                f"{path}: found {value:g}, allowed {low:g} to {high:g} ({origin.source});"
                " give another value, or a quantity with its own range and source"
            )
    return problems


def _lookup(values: dict[str, Any], path: str) -> Any:
    node: Any = values
    for key in path.split("."):
        node = node.get(key) if isinstance(node, dict) else None
    return node
