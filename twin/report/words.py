"""Format numbers, shares, names and units for reports; units are suffixes of the names."""

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
# A unit at the end of a name: `mm`, `mm2`, `per_mm`, `mm2_per_n`; `kg_m3`, `j_m2` and `mm_s` as in
# data sheets. The metre is a unit only in the denominator below a mass or an energy.
_SUFFIX = re.compile(
    rf"_(?:(?P<over>{_ONE})_per_(?P<under>{_ONE})|per_(?P<inverse>{_ONE})"
    rf"|(?P<amount>kg|j|mm|deg)_(?P<size>m[23]|s)|(?P<one>(?!m[23]?$){_ONE}))$"
)
_DERIVATIVE = re.compile(r"(?P<of>[a-z0-9_]+)_by_(?P<field>[a-z0-9_.]+\.[a-z0-9_]+)")

NONE = "–"
"""Text for a missing value."""

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
    """Split a name into stem and unit: `standoff_mm` into ("standoff", "mm").

    The unit is empty if the name has no suffix with a unit. `rim_compliance_mm2_per_n` has the unit
    mm²/N, `gain_dn_per_e` the unit DN/e⁻. A derivative, for example
    `crb_radius_um_by_projector.pose.polar_deg`, has the ratio of both units.
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
    """Return the text for one unit in a name, with its power: mm² for `mm2`."""
    stem = token.rstrip("23")
    return _UNITS[stem] + _POWERS[token[len(stem) :]]


def label_of(name: str) -> tuple[str, str]:
    """Return the label and the unit of a metric or setting."""
    stem, unit = split_unit(name)
    return _NAMES.get(stem, stem.replace("_", " ")), unit


def number(value: float | None, form: str, none: str = NONE) -> str:
    """Return a number in the format `form`, or `none` (by default a dash) if it does not exist."""
    return none if value is None else f"{value:{form}}"


def shown(value: str | float | None, digits: int) -> str:
    """Return the text of a table cell; floats have `digits` decimals, None is a dash."""
    if isinstance(value, str):
        return value  # which may be markup
    if isinstance(value, float):
        return f"{value:.{digits}f}"
    return NONE if value is None else str(value)


def signed(value: float, digits: int = 3) -> str:
    """Return a number with its sign and a typographic minus; a number rounded to 0 has a plus."""
    return f"{value:+z.{digits}f}".replace("-", "−")


def printed_sentence(text: str) -> str:
    """Return a sentence for the terminal (ASCII) as text for a page.

    The text starts with a capital letter and has the signs µm and ± instead of um and +-.
    """
    for plain, sign in (("um", "µm"), ("+-", "±")):
        text = re.sub(rf"(?<= ){re.escape(plain)}(?= |$|[.,;:)])", sign, text)
    return text[:1].upper() + text[1:]


_ASCII = (
    ("µ", "u"), ("°", " deg"), ("²", "2"), ("³", "3"), ("–", "-"), ("−", "-"), ("±", "+-"),
    ("\N{NO-BREAK SPACE}", " "),
)  # fmt: skip


def in_ascii(text: str) -> str:
    """Return a text of a page for the terminal: um instead of µm, +- instead of ±."""
    for sign, plain in _ASCII:
        text = text.replace(sign, plain)
    return text


def percent(share: float | None) -> str:
    """Return a share (0 to 1) in percent; a dash for None.

    Shares near 0 and 1 have more digits, so that they are not rounded to 0 % or 100 %.
    """
    if share is None:
        return NONE
    if 0 < share < 1e-4:
        return "< 0.01 %"
    if 1 - 1e-4 < share < 1:
        return "> 99.99 %"
    digits = 2 if 0 < share < 0.01 or 0.99 < share < 1 else 0
    return f"{100 * share:.{digits}f} %"


def in_words(value: Any) -> str:
    """Return a value as text: numbers with up to six digits, lists without brackets, yes or no."""
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
    """Return the values of a flat table as one phrase: `thickness 2 mm, Shore A 10`.

    Parameters
    ----------
    model : model of the table; its field titles replace the names; None: names are used
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
    """Return kind, values and tables (texture, glints) of a coating as one phrase."""
    numbers = coating.model_dump()
    kind = f"{numbers.pop('kind')}: " if "kind" in numbers else ""
    tables = [
        f"{name}: {phrase(table)}" for name, table in numbers.items() if isinstance(table, dict)
    ]
    return "; ".join([kind + phrase(numbers, type(coating)), *tables])
