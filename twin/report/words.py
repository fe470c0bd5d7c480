"""How reports write numbers, shares, names and units; units are suffixes of the names."""

from collections.abc import Mapping
from typing import Any

from twin.config.models import Coating

# Longest first: e_per_s ends in no other unit, but `_s` alone would swallow it.
_UNITS = {
    "_e_per_s": "e⁻/s",
    "_j_m2": "J/m²",
    "_kg_m3": "kg/m³",
    "_percent": "%",
    "_per_mm": "1/mm",
    "_kpa": "kPa",
    "_deg": "°",
    "_rad": "rad",
    "_mm": "mm",
    "_um": "µm",
    "_nm": "nm",
    "_px": "px",
    "_ms": "ms",
    "_mw": "mW",
    "_dn": "DN",
    "_n": "N",
    "_e": "e⁻",
}

NONE = "–"
"""Written for what does not exist: a figure of no point, a row that has no such cell."""

_NAMES = {
    "shore_a": "Shore A",
    "young_modulus": "Young's modulus",
    "poisson_ratio": "Poisson ratio",
    "flake_ior": "flake refractive index n",
    "flake_extinction": "k",
    "error_over_sigma": "normalised error (spread of error / predicted sigma)",
    "z_rmse": "z error, RMS",
    "z_bias": "z error, mean",
    "z_p95": "z error, 95th percentile of its size",
}


def split_unit(name: str) -> tuple[str, str]:
    """Split `standoff_mm` into ("standoff", "mm"); dimensionless names keep an empty unit."""
    for suffix, unit in _UNITS.items():
        if name.endswith(suffix) and name != suffix[1:]:
            return name.removesuffix(suffix), unit
    return name, ""


def label_of(name: str) -> tuple[str, str]:
    """Return what a metric or setting is called, and its unit."""
    stem, unit = split_unit(name)
    return _NAMES.get(stem, stem.replace("_", " ")), unit


def number(value: float | None, form: str, none: str = NONE) -> str:
    """Write a figure in a format; a dash where it does not exist."""
    return none if value is None else f"{value:{form}}"


def shown(value: str | float | None, digits: int) -> str:
    """Write a cell of a table; a dash where there is no number."""
    if isinstance(value, str):
        return value  # which may be markup
    if isinstance(value, float):
        return f"{value:.{digits}f}"
    return NONE if value is None else str(value)


def signed(value: float, digits: int = 3) -> str:
    """Write a number with its sign, with the minus of print."""
    return f"{value:+.{digits}f}".replace("-", "−")


def percent(share: float | None) -> str:
    """Write a share; next to none and next to all are not rounded away."""
    if share is None:
        return NONE
    if 0 < share < 1e-4:
        return "< 0.01 %"
    if 1 - 1e-4 < share < 1:
        return "> 99.99 %"
    digits = 2 if 0 < share < 0.01 or 0.99 < share < 1 else 0
    return f"{100 * share:.{digits}f} %"


def in_words(value: Any) -> str:
    """Write a value as people read it: short numbers, lists without brackets."""
    if value is None:
        return NONE
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, (list, tuple)):
        return ", ".join(in_words(entry) for entry in value) or "none"
    return str(value).replace("_", " ")


def phrase(values: Mapping[str, Any]) -> str:
    """Write a flat table as one phrase: `thickness 2 mm, Shore A 10`."""
    parts = []
    for name, value in values.items():
        if value is not None and not isinstance(value, dict):
            label, unit = label_of(name)
            space = "" if unit in ("°", "") else " "
            parts.append(f"{label} {in_words(value)}{space}{unit}")
    return ", ".join(parts)


def coating_phrase(coating: Coating) -> str:
    """Write a coating as one phrase, its texture, if it has one, last."""
    told = phrase(coating.model_dump())
    if coating.texture is None:
        return told
    return f"{told}; texture: {phrase(coating.texture.model_dump())}"
