"""Exceptions for bad input, and checks of one argument that report its name and allowed range."""

import math
from numbers import Integral, Real
from pathlib import PurePath


class InputError(ValueError):
    """Input that cannot be used as given; base class of all exceptions for bad input."""


class CaptureError(InputError):
    """A stored capture or calibration that is missing, damaged or inconsistent."""


class FitError(InputError):
    """Data that do not determine the requested fit, such as too few points for a sphere."""


def one_line(error: BaseException) -> str:
    """Return the message of a library's exception as one line."""
    return " ".join(str(error).split())


def counted(count: int, noun: str, plural: str = "") -> str:
    """Return a number with its noun, singular for 1: "1 case", "2 cases"."""
    return f"{count} {noun if count == 1 else plural or f'{noun}s'}"


def few(names: list[str]) -> str:
    """Return a text with the first three names and the number of all others, or "none"."""
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(names[:3]) + more or "none"


def require_instance(name: str, value: object, kinds: type | tuple[type, ...], remedy: str) -> None:
    """Raise InputError unless `value` is an instance of `kinds`; the message ends with `remedy`."""
    if not isinstance(value, kinds):
        written = repr(value) if isinstance(value, (str, int, float, PurePath)) else ""
        written = f"{written[:60]}, " if written else ""
        raise InputError(f"{name} is {written}of type {type(value).__name__}; {remedy}")


def require_integer(name: str, value: object, low: int, high: int) -> None:
    """Raise InputError unless `value` is an integer in [low, high]."""
    # bool is an Integral to Python, but `steps = true` is a mistake.
    is_integer = isinstance(value, Integral) and not isinstance(value, bool)
    if not (is_integer and low <= int(value) <= high):  # type: ignore[call-overload]
        raise InputError(f"{name} is {value!r}; give a whole number from {low} to {high}")


def require_number(
    name: str, value: object, low: float, high: float = math.inf, *, open_low: bool = False
) -> None:
    """Raise InputError unless `value` is finite and in [low, high]; `open_low`: in (low, high]."""
    is_number = isinstance(value, Real) and not isinstance(value, bool)
    number = float(value) if is_number else math.nan  # type: ignore[arg-type]
    above = number > low if open_low else number >= low
    if not (above and number <= high and math.isfinite(number)):
        above_text = "above" if open_low else "of at least"
        upper = "" if math.isinf(high) else f" and at most {high:g}"
        raise InputError(f"{name} is {value!r}; give a number {above_text} {low:g}{upper}")
