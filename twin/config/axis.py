"""Axis of a study or of a data set: a field or several fields that vary, and their levels.

An axis varies one field, given by its dotted path, or several fields together between named
choices. The levels of an axis are a list of values, a range with a count, the choices, or the files
of a folder. Samplers draw values from a range without a count, or select levels.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from reconstruction.reading import is_regular
from twin.config.base import ConfigError, Model
from twin.config.bounds import Figure
from twin.config.loading import resolve_uses


@dataclass(frozen=True)
class Level:
    """One level of an axis: its label in tables, and the values that it sets, by dotted path."""

    label: Any
    changes: Mapping[str, Any]


class Axis(Model):
    """One axis of a study: a field, or several fields together, and the levels or the range."""

    path: Annotated[str, Field(pattern=r"^[A-Za-z0-9_\-]+(\.[A-Za-z0-9_\-]+)*$")] | None = Field(
        default=None, description="dotted path of the field that is varied"
    )
    name: Annotated[str, Field(min_length=1, max_length=64)] | None = Field(
        default=None, description="heading in tables and plots; absent: the path"
    )
    values: Annotated[tuple[Any, ...], Field(min_length=1)] | None = None
    low: Figure | None = None
    high: Figure | None = None
    count: Annotated[int, Field(ge=2, le=100_000)] | None = Field(
        default=None, description="levels between low and high, both included"
    )
    scale: Literal["linear", "log"] = "linear"
    integer: bool = Field(default=False, description="round to whole numbers")
    choices: dict[str, dict[str, Any]] | None = Field(
        default=None,
        description="named sets of tables that override those of the experiment; may `use` files",
    )
    files: str | None = Field(
        default=None,
        exclude_if=lambda pattern: pattern is None,
        description="files of a folder as values, in the order of their names: './parts/*.stl', "
        "relative to the file that states it",
    )
    source: str | None = Field(
        default=None,
        description="reason for values outside the range that a data file states",
    )

    @field_validator("values")
    @classmethod
    def _plain_values(cls, values: tuple[Any, ...] | None) -> tuple[Any, ...] | None:
        if any(isinstance(value, dict) for value in values or ()):
            raise ValueError("allowed numbers, texts and lists of numbers; use choices for tables")
        return values

    @model_validator(mode="after")
    def _one_kind_of_levels(self) -> "Axis":
        ranged = self.low is not None or self.high is not None or self.count is not None
        others = (self.values, self.choices, self.files)
        if ranged + sum(levels is not None for levels in others) != 1:
            raise ValueError("takes one of values, low and high, choices, or files")
        if self.choices is not None:
            return self._checked_choices()
        if self.path is None:
            raise ValueError("path: missing; name the field that is varied")
        if self.values is not None and len(set(map(repr, self.values))) < len(self.values):
            raise ValueError("values: found one of them twice; remove it")
        return self._checked_range() if ranged else self

    def _checked_choices(self) -> "Axis":
        if self.path is not None or not self.choices:
            raise ValueError("choices need at least one entry, and no path: each names its fields")
        if self.name is None:
            raise ValueError("name: missing; choices have no path to be used instead")
        return self

    def _checked_range(self) -> "Axis":
        if self.low is None or self.high is None:
            raise ValueError("a range needs low and high")
        if not self.low < self.high:
            raise ValueError(f"low: found {self.low:g}, allowed below high, {self.high:g}")
        if self.scale == "log" and self.low <= 0:
            raise ValueError(f"low: found {self.low:g}, allowed above 0 with scale = 'log'")
        return self

    @property
    def title(self) -> str:
        """Heading of the axis in tables and plots: the name, or else the path."""
        return self.name or str(self.path)

    @property
    def is_continuous(self) -> bool:
        """Whether the axis is a range without count, of which any value may be drawn."""
        return self.low is not None and self.count is None

    @property
    def is_numeric(self) -> bool:
        """Whether the axis has two or more levels, all of them numbers."""
        labels = [level.label for level in self.levels()]
        return len(labels) > 1 and all(type(label) in (int, float) for label in labels)

    def levels(self) -> tuple[Level, ...]:
        """Return the levels of the axis; empty for a range without count."""
        if self.choices is not None:
            return tuple(Level(label, changes) for label, changes in self.choices.items())
        if self.values is not None:
            return tuple(self._level(value) for value in self.values)
        if self.count is None:
            return ()
        rounded = dict.fromkeys(self._at(u) for u in np.linspace(0.0, 1.0, self.count))
        return tuple(self._level(value) for value in rounded)

    def level_at(self, share: float) -> Level:
        """Return the level at a share (0 to 1) of the axis, which a sampler has drawn."""
        if self.is_continuous:
            return self._level(self._at(share))
        levels = self.levels()
        return levels[min(int(share * len(levels)), len(levels) - 1)]

    def level_of(self, value: float) -> Level:
        """Return the level with a given value, for an axis that is a range without count."""
        return self._level(round(value) if self.integer else value)

    def _at(self, share: float) -> float | int:
        assert self.low is not None  # the validator's
        assert self.high is not None
        if self.scale == "log":
            value = self.low * (self.high / self.low) ** float(share)
        else:
            value = self.low + (self.high - self.low) * float(share)
        # Rounded to ten digits, so that levels do not differ by rounding errors.
        return round(value) if self.integer else float(f"{value:.10g}")

    def _level(self, value: Any) -> Level:
        laid = value if self.source is None else {"value": value, "source": self.source}
        return Level(value, {str(self.path): laid})


def with_files(axis: Axis, file: Path) -> Axis:
    """Return the axis with the values of the files that its choices `use`, and the listed files.

    Parameters
    ----------
    file : file that states the axis, to which names of files are relative

    Raises
    ------
    ConfigError : no file has a name of the pattern `files`, or a used file is invalid
    """
    if axis.files is not None:
        return axis.model_copy(update={"values": _listed(axis.files, file), "files": None})
    if axis.choices is None:
        return axis
    read = {label: resolve_uses(tree, (file,)) for label, tree in axis.choices.items()}
    return axis.model_copy(update={"choices": read})


def _listed(pattern: str, file: Path) -> tuple[str, ...]:
    """Return the names of the files of a pattern such as "./parts/*.stl", sorted."""
    relative = PurePath(pattern)
    folder = file.parent / relative.parent
    names = sorted(str(path) for path in folder.glob(relative.name) if is_regular(path))
    if not names:
        raise ConfigError(
            f"{file}: files = '{pattern}': found no such file in {folder}; give a pattern such as "
            "'./parts/*.stl'"
        )
    return tuple(names)
