"""Figures of a measurement by name; the name of a figure with a unit ends with the unit.

`Metrics` is the content of `result.json`: numbers, and texts such as warnings, the press model, or
the reason why a rod has no crest. `Figures` contains only the numbers. A figure without a value is
None, so that no score can use it as 0. A caller that needs the number calls `known`.
"""

from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from typing import Any, TypeVar, overload

from reconstruction.errors import InputError

Metric = float | str | Sequence[str] | None
Metrics = Mapping[str, Metric]
Default = TypeVar("Default")
COMPENSATED = "compensated_"
"""Prefix of the figures of the object behind the coat, which are computed from the coat."""


class FigureError(InputError, KeyError):
    """Error: a measurement has no figure of a given name; the message lists the existing names."""

    __str__ = Exception.__str__  # KeyError would quote the message


class Figures(Mapping[str, float | None]):
    """The numbers among `metrics`, by name; None for a figure that has no value."""

    def __init__(self, metrics: Metrics) -> None:
        self._values = {
            name: value
            for name, value in metrics.items()
            if value is None or isinstance(value, (int, float))
        }

    def __getitem__(self, name: str) -> float | None:
        """Return the value of a figure, which may be None.

        Raises
        ------
        FigureError : the measurement has no figure of this name; it is also a KeyError
        """
        try:
            return self._values[name]
        except KeyError:
            raise FigureError(self._no_such(name)) from None

    def __contains__(self, name: object) -> bool:
        return name in self._values

    @overload
    def get(self, name: str, /) -> float | None: ...
    @overload
    def get(self, name: str, /, default: Default) -> float | Default | None: ...
    def get(self, name: str, /, default: Any = None) -> Any:
        """Return the value of a figure; `default` if there is no figure of this name."""
        return self._values.get(name, default)

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        width = max(map(len, self._values), default=0)
        return "\n".join(f"{name:<{width}}  {_short(value)}" for name, value in self.items())

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td>{name}</td><td>{_short(value)}</td></tr>" for name, value in self.items()
        )
        return f"<table>{rows}</table>"

    def _no_such(self, name: str) -> str:
        hint = ""
        if str(name).startswith(COMPENSATED) and not self._has_compensated():
            hint = "; twin.with_compensation(measurement) adds those of the object behind the coat"
        close = get_close_matches(str(name), self._values, n=1)
        meant = f", did you mean {close[0]}" if close else ""
        return f"{name}: no such figure{meant}{hint}; there are {', '.join(self._values)}"

    def _has_compensated(self) -> bool:
        return any(name.startswith(COMPENSATED) for name in self._values)

    def known(self, name: str) -> float:
        """Return the value of a figure, which must not be None.

        Raises
        ------
        InputError : the figure has no value; the message gives the reason
        """
        value = self._values.get(name)
        if value is None:
            raise InputError(f"{name}: found none, {why_absent(self) or 'not measured'}")
        return value


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.6g}"


def warnings_of(metrics: Metrics) -> tuple[str, ...]:
    """Return the warnings of press and measurement; empty if there are none."""
    warnings = metrics.get("warnings")
    return tuple(warnings) if isinstance(warnings, (list, tuple)) else ()


def why_absent(figures: Mapping[str, Any]) -> str:
    """Return why a measurement has no error figures; empty if it has points to be compared."""
    if 0 in (figures.get("lit_pixels"), figures.get("wanted_pixels")):
        return "no pixel that ought to give a point"
    return "no valid point" if figures.get("points") == 0 else ""
