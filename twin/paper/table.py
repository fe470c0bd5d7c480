"""Tables as data: rows of named cells, the paper's beside the twin's, as JSON and Markdown."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

PAPER, TWIN = "paper", "twin"
Cell = str | int | float | None


@dataclass(frozen=True)
class Column:
    """One column: key of the rows, heading with unit, digits of its numbers."""

    key: str
    heading: str
    digits: int = 3


@dataclass(frozen=True)
class Table:
    """One table.

    Attributes
    ----------
    name : key in tables.json
    title : what it shows
    of_paper : which of the paper's tables or figures it stands beside; empty: ours alone
    columns : in order
    rows : cells by column key; None where there is no number
    notes : what a reader has to know
    """

    name: str
    title: str
    of_paper: str
    columns: tuple[Column, ...]
    rows: tuple[dict[str, Cell], ...]
    notes: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """Return the table for tables.json."""
        return asdict(self)

    def as_markdown(self) -> str:
        """Return heading, table and notes."""
        lines = [f"### {self.title}", ""]
        if self.of_paper:
            lines += [f"Beside {self.of_paper}.", ""]
        lines += [_line([c.heading for c in self.columns]), _line(["---"] * len(self.columns))]
        lines += [
            _line([shown(row.get(c.key), c.digits) for c in self.columns]) for row in self.rows
        ]
        return "\n".join([*lines, "", *(f"- {note}" for note in self.notes), ""])

    def row(self, **wanted: Cell) -> dict[str, Cell]:
        """Return the first row with the given cells.

        Raises
        ------
        KeyError
            There is none.
        """
        for row in self.rows:
            if all(row.get(key) == value for key, value in wanted.items()):
                return row
        raise KeyError(f"{self.name}: no row with {wanted}")


def shown(value: Cell, digits: int) -> str:
    """Return a cell as text; a dash where there is no number."""
    if value is None:
        return "–"
    return f"{value:.{digits}f}" if isinstance(value, float) else str(value)


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
