"""Words of a study's page: headings with units, and the settings of a design.

The unit of a figure is the suffix of its name. The unit of an axis is the suffix of its name, or
else of the path that it varies.
"""

from typing import Any

from twin.report.words import NONE, label_of, split_unit
from twin.study.table import Row, StudyTable


def headings_of(table: StudyTable) -> dict[str, tuple[str, str]]:
    """Return label and unit of every axis and figure of a study, by its name."""
    names = {name: label_of(name) for name in table.metrics}
    return names | axis_headings(table)


def axis_headings(table: StudyTable) -> dict[str, tuple[str, str]]:
    """Return label and unit of every axis of a study, by its title."""
    paths = {axis.title: axis.path or "" for axis in table.record.study.axis}
    found = {}
    for title in table.axes:
        stem, unit = split_unit(title)
        found[title] = stem.replace("_", " "), unit or split_unit(paths.get(title, ""))[1]
    return found


def titles_of(table: StudyTable) -> dict[str, str]:
    """Return the headings of all axes and figures, with the unit in brackets, by name."""
    both = headings_of(table).items()
    return {name: f"{label} ({unit})" if unit else label for name, (label, unit) in both}


def value_text(value: Any) -> str:
    """Return the value of a cell as text: numbers with four digits, a dash for None."""
    if value is None:
        return NONE
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def amount(value: Any, unit: str) -> str:
    """Return a value with its unit."""
    space = "" if unit in ("", "°") else " "
    return f"{value_text(value)}{space}{unit}"


def settings_text(table: StudyTable, row: Row, axes: tuple[str, ...] | None = None) -> str:
    """Return the settings of a row with units, for example "thickness 0.1 mm, mix C"."""
    headings = axis_headings(table)
    parts = []
    for axis in table.axes if axes is None else axes:
        label, unit = headings[axis]
        parts.append(f"{label} {amount(row[axis], unit)}")
    return ", ".join(parts)
