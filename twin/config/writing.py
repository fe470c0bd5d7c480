"""Write a resolved experiment as TOML that loads back to the same experiment."""

from typing import Any

import tomli_w

from twin.config.models import Experiment


def to_toml(experiment: Experiment) -> str:
    """Return the resolved experiment as TOML text (values that are None are left out)."""
    return tomli_w.dumps(_without_none(experiment.model_dump(mode="json")))


def _without_none(node: Any) -> Any:
    if isinstance(node, dict):
        return {key: _without_none(value) for key, value in node.items() if value is not None}
    return node
