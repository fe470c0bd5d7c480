"""Axes of a study: what is varied, and over which values.

An axis moves one field, by its dotted path, or several fields at once between named choices. Its
levels are a list of values, a range with a count, or the choices; samplers draw from a range
without a count, or pick among the levels.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from twin.config.base import Model


@dataclass(frozen=True)
class Level:
    """One place on an axis: how it is called in tables, and the values it sets by dotted path."""

    label: Any
    changes: Mapping[str, Any]


class Axis(Model):
    """One axis of a study."""

    path: Annotated[str, Field(pattern=r"^[A-Za-z0-9_\-]+(\.[A-Za-z0-9_\-]+)*$")] | None = Field(
        default=None, description="dotted path of the field that is varied"
    )
    name: Annotated[str, Field(min_length=1, max_length=64)] | None = Field(
        default=None, description="heading in tables and plots; absent: the path"
    )
    values: Annotated[tuple[Any, ...], Field(min_length=1)] | None = None
    low: float | None = None
    high: float | None = None
    count: Annotated[int, Field(ge=2, le=100_000)] | None = Field(
        default=None, description="levels between low and high, both included"
    )
    scale: Literal["linear", "log"] = "linear"
    integer: bool = Field(default=False, description="round to whole numbers")
    choices: dict[str, dict[str, Any]] | None = Field(
        default=None, description="named sets of tables, laid over the experiment; may `use` files"
    )
    source: str | None = Field(
        default=None,
        description="why values may lie outside the range that a data file states",
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
        if (self.values is not None) + ranged + (self.choices is not None) != 1:
            raise ValueError("takes one of values, low and high, or choices")
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
            raise ValueError("name: missing; choices have no path that could stand for it")
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
        """Heading in tables and plots."""
        return self.name or str(self.path)

    @property
    def is_continuous(self) -> bool:
        """Any value of a range may be drawn."""
        return self.low is not None and self.count is None

    def levels(self) -> tuple[Level, ...]:
        """Return the axis' levels; of a range without count there are none."""
        if self.choices is not None:
            return tuple(Level(label, changes) for label, changes in self.choices.items())
        if self.values is not None:
            return tuple(self._level(value) for value in self.values)
        if self.count is None:
            return ()
        rounded = dict.fromkeys(self._at(u) for u in np.linspace(0.0, 1.0, self.count))
        return tuple(self._level(value) for value in rounded)

    def level_at(self, share: float) -> Level:
        """Return the level at a share (0 to 1) of the axis, as samplers draw it."""
        if self.is_continuous:
            return self._level(self._at(share))
        levels = self.levels()
        return levels[min(int(share * len(levels)), len(levels) - 1)]

    def level_of(self, value: float) -> Level:
        """Return the level of a value within a range without count."""
        return self._level(round(value) if self.integer else value)

    def _at(self, share: float) -> float | int:
        assert self.low is not None  # the validator's
        assert self.high is not None
        if self.scale == "log":
            value = self.low * (self.high / self.low) ** float(share)
        else:
            value = self.low + (self.high - self.low) * float(share)
        # Ten digits name a level well enough, and read better than the last bit's dirt.
        return round(value) if self.integer else float(f"{value:.10g}")

    def _level(self, value: Any) -> Level:
        laid = value if self.source is None else {"value": value, "source": self.source}
        return Level(value, {str(self.path): laid})
