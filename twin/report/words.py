"""How reports write numbers, shares, names and units; units are suffixes of the names."""

import re
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from twin.config.coatings import Coating

_UNITS = {
    "percent": "%",
    "kpa": "kPa",
    "deg": "°",
    "rad": "rad",
    "mm": "mm",
    "um": "µm",
    "nm": "nm",
    "px": "px",
    "kg": "kg",
    "ms": "ms",
    "mw": "mW",
    "dn": "DN",
    "m": "m",
    "s": "s",
    "j": "J",
    "n": "N",
    "e": "e⁻",
}
_POWERS = {"": "", "2": "²", "3": "³"}
_ONE = f"(?:{'|'.join(_UNITS)})[23]?"
# A unit at the end of a name: `mm`, `mm2`, `per_mm`, `mm2_per_n`; `kg_m3` and `j_m2` as data sheets
# write them. A metre by itself is no unit of ours: `m` only below a mass or an energy.
_SUFFIX = re.compile(
    rf"_(?:(?P<over>{_ONE})_per_(?P<under>{_ONE})|per_(?P<inverse>{_ONE})"
    rf"|(?P<amount>kg|j)_(?P<size>m[23])|(?P<one>(?!m[23]?$){_ONE}))$"
)
_DERIVATIVE = re.compile(r"(?P<of>[a-z0-9_]+)_by_(?P<field>[a-z0-9_.]+\.[a-z0-9_]+)")

NONE = "–"
"""Written for a missing value: a figure without points, a row without such a cell."""

_NAMES = {
    "shore_a": "Shore A",
    "young_modulus": "Young's modulus",
    "poisson_ratio": "Poisson ratio",
    "error_over_sigma": "normalised error (spread of error / predicted sigma)",
    "z_rmse": "z error, RMS",
    "z_bias": "z error, mean",
    "z_p95": "z error, 95th percentile of its size",
}


def split_unit(name: str) -> tuple[str, str]:
    """Split `standoff_mm` into ("standoff", "mm"); dimensionless names keep an empty unit.

    Ratios and powers are written as such: `rim_compliance_mm2_per_n` has mm²/N, `gain_dn_per_e`
    DN/e⁻. A derivative, `crb_radius_um_by_projector.pose.polar_deg`, has the ratio of both units.
    """
    derivative = _DERIVATIVE.fullmatch(name)
    if derivative:
        of, unit = split_unit(derivative["of"])
        by, under = split_unit(derivative["field"].rpartition(".")[2])
        return f"{of}_by_{by}", f"{unit or '1'}/{under}" if under else unit
    match = _SUFFIX.search(name)
    if match is None:
        return name, ""
    over = match["over"] or match["amount"] or match["one"]
    under = match["under"] or match["inverse"] or match["size"]
    unit = _written(over) if over else "1"
    return name[: match.start()], f"{unit}/{_written(under)}" if under else unit


def _written(token: str) -> str:
    """Write one unit of a name, with its power: `mm2` as mm²."""
    stem = token.rstrip("23")
    return _UNITS[stem] + _POWERS[token[len(stem) :]]


def label_of(name: str) -> tuple[str, str]:
    """Return the label and the unit of a metric or setting."""
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
    """Write a number with its sign and a typographic minus; a rounded 0 has no minus."""
    return f"{value:+z.{digits}f}".replace("-", "−")


def printed_sentence(text: str) -> str:
    """Write a sentence of the terminal, in ASCII, as a page prints it: capital, µm and ± signs."""
    for plain, sign in (("um", "µm"), ("+-", "±")):
        text = re.sub(rf"(?<= ){re.escape(plain)}(?= |$|[.,;:)])", sign, text)
    return text[:1].upper() + text[1:]


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


def phrase(values: Mapping[str, Any], model: type[BaseModel] | None = None) -> str:
    """Write a flat table as one phrase: `thickness 2 mm, Shore A 10`.

    Parameters
    ----------
    model : of the table; a field's title is written in the place of its name
    """
    titles = {} if model is None else {n: field.title for n, field in model.model_fields.items()}
    parts = []
    for name, value in values.items():
        if value is not None and not isinstance(value, dict):
            label, unit = label_of(name)
            space = "" if unit in ("°", "") else " "
            parts.append(f"{titles.get(name) or label} {in_words(value)}{space}{unit}")
    return ", ".join(parts)


def coating_phrase(coating: Coating) -> str:
    """Write a coating as one phrase, its texture, if it has one, last."""
    numbers = coating.model_dump()
    kind = f"{numbers.pop('kind')}: " if "kind" in numbers else ""
    written = kind + phrase(numbers, type(coating))
    if coating.texture is None:
        return written
    return f"{written}; texture: {phrase(coating.texture.model_dump())}"
