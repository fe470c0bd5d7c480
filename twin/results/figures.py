"""Figures of a measurement by name, with units in their names: a number, or that there is none.

`Metrics` is what result.json holds: numbers, and words beside them (warnings, the press model, why
a rod has no crest). `Figures` are its numbers. A figure that does not exist is None by type, so
that nothing can score it as 0: who needs the number asks for `known`.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from reconstruction.errors import InputError

Metric = float | str | Sequence[str] | None
Metrics = Mapping[str, Metric]


class Figures(Mapping[str, float | None]):
    """The numbers of `metrics`; None where a measurement has the figure but no value of it."""

    def __init__(self, metrics: Metrics) -> None:
        self._values = {
            name: value
            for name, value in metrics.items()
            if value is None or isinstance(value, (int, float))
        }

    def __getitem__(self, name: str) -> float | None:
        return self._values[name]

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

    def known(self, name: str) -> float:
        """Return a figure that must exist.

        Raises
        ------
        InputError : it does not, and why
        """
        value = self._values.get(name)
        if value is None:
            raise InputError(f"{name}: found none, {why_absent(self) or 'not measured'}")
        return value


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.6g}"


def warnings_of(metrics: Metrics) -> tuple[str, ...]:
    """Return the warnings of the press; none where nothing was pressed."""
    found = metrics.get("warnings")
    return tuple(found) if isinstance(found, (list, tuple)) else ()


def why_absent(figures: Mapping[str, Any]) -> str:
    """Say why a measurement has no error and no shares; empty where it has."""
    if 0 in (figures.get("lit_pixels"), figures.get("wanted_pixels")):
        return "no pixel that ought to give a point"
    return "no valid point" if figures.get("points") == 0 else ""
