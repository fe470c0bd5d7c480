"""Names and units of configuration fields and metrics, from the suffix every number carries."""

from typing import Any

from twin.config.models import Coating

# Longest first: e_per_s ends in no other unit, but `_s` alone would swallow it.
_UNITS = {
    "_e_per_s": "e⁻/s",
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
    "poisson_ratio": "Poisson ratio",
    "flake_ior": "flake refractive index n",
    "flake_extinction": "k",
}


def split_unit(name: str) -> tuple[str, str]:
    """Split `standoff_mm` into ("standoff", "mm"); dimensionless names keep an empty unit."""
    for suffix, unit in _UNITS.items():
        if name.endswith(suffix) and name != suffix[1:]:
            return name.removesuffix(suffix), unit
    return name, ""


def number(value: float | None, form: str, none: str = NONE) -> str:
    """Write a figure in a format; a dash where it does not exist."""
    return none if value is None else f"{value:{form}}"


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


def phrase(values: dict[str, Any], *, leave_out: tuple[str, ...] = ()) -> str:
    """Write a flat table as one phrase: `thickness 2 mm, Shore A 10`."""
    parts = []
    for name, value in values.items():
        if value is not None and name not in leave_out and not isinstance(value, dict):
            stem, unit = split_unit(name)
            label = _NAMES.get(stem, stem.replace("_", " "))
            space = "" if unit in ("°", "") else " "
            parts.append(f"{label} {in_words(value)}{space}{unit}")
    return ", ".join(parts)


def coating_phrase(coating: Coating) -> str:
    """Write a coating as one phrase, its texture, if it has one, last."""
    told = phrase(coating.model_dump())
    if coating.texture is None:
        return told
    return f"{told}; texture: {phrase(coating.texture.model_dump())}"
