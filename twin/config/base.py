"""Base of all configuration models: the frozen model class, common ranges, and errors."""

import typing
from functools import cache
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, model_validator

from reconstruction.errors import InputError


class ConfigError(InputError):
    """Error of an invalid configuration file or value; the message has one line per problem."""


class AssetCycleError(ConfigError):
    """Error of data files that `use` each other in a cycle."""


SET_HERE = "set in the experiment; range: "
"""Start of the source of a plain value that replaces a quantity; the range's source follows."""

Fraction = Annotated[float, Field(ge=0, le=1)]
Angle = Annotated[float, Field(ge=-180, le=180)]


class Model(BaseModel):
    """Base of all configuration models, which are immutable.

    Unknown keys, NaN, infinity, and true or false for a number are rejected.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _no_flag_as_number(cls, values: Any) -> Any:
        """Reject true and false in numeric fields, where Python would read them as 1 and 0."""
        if not isinstance(values, dict):
            return values
        flagged = [key for key, value in values.items() if _holds_flag(value)]
        marked = {key: _flags_marked(values[key]) for key in flagged if not _takes_flags(cls, key)}
        return values | marked if marked else values


class _Flag:
    """Replacement of true or false in a field that takes no flag, which then rejects it."""

    def __init__(self, value: bool) -> None:
        self._value = value

    def __repr__(self) -> str:
        return str(self._value).lower()


def _holds_flag(value: Any) -> bool:
    if isinstance(value, (list, tuple)):
        return any(isinstance(item, bool) for item in value)
    return isinstance(value, bool)


def _flags_marked(value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return [_flags_marked(item) for item in value]
    return _Flag(value) if isinstance(value, bool) else value


@cache
def _takes_flags(model: type[BaseModel], key: str) -> bool:
    field = model.model_fields.get(key)
    return field is None or _allows_flag(field.annotation)


def _allows_flag(annotation: Any) -> bool:
    if typing.get_origin(annotation) is typing.Literal:
        return any(isinstance(item, bool) for item in typing.get_args(annotation))
    return annotation in (bool, Any) or any(map(_allows_flag, typing.get_args(annotation)))
