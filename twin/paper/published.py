"""The paper's numbers as data: scenes/paper/targets.toml."""

import tomllib
from functools import lru_cache
from typing import Any

from twin.assets import asset_path

CONTACT_FPP, GELSIGHT = "contact-FPP", "GelSight"
METHODS = (GELSIGHT, CONTACT_FPP)
NOMINAL_RADIUS_MM = 4.0


@lru_cache
def published() -> dict[str, Any]:
    """Return the whole file."""
    return tomllib.loads(asset_path("scenes", "paper/targets").read_text(encoding="utf-8"))


def rows_of(table: str) -> list[dict[str, Any]]:
    """Return the rows of one of the paper's tables."""
    rows: list[dict[str, Any]] = published()[table]
    return rows


def mean_of(table: str, method: str, key: str) -> float:
    """Return the mean over both balls of one of the paper's columns."""
    found = [float(row[key]) for row in rows_of(table) if row["method"] == method]
    return sum(found) / len(found)
