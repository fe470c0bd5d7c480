"""Tables as data (columns with units and digits, rows of cells), for HTML, Markdown, text, JSON."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from typing import Any

from twin.report.words import shown

PAPER, TWIN = "paper", "twin"
"""Values of a column `source`: a row has values from the paper, or values of the twin."""

Cell = str | int | float | None
Row = Mapping[str, Cell]


@dataclass(frozen=True)
class Column:
    """One column of a table.

    Attributes
    ----------
    key : key of the column's cells in each row
    heading : text above the column; `unit` is appended in brackets
    digits : number of decimals of floats
    kind : CSS class of the cells in the page; empty: "number" (right-aligned) if any cell is a
        number
    """

    key: str
    heading: str
    digits: int = 3
    unit: str = ""
    kind: str = ""

    @property
    def title(self) -> str:
        """Heading, with the unit in brackets if there is one."""
        return f"{self.heading} ({self.unit})" if self.unit else self.heading


@dataclass(frozen=True)
class TableText:
    """One table cell as a page shows it.

    Attributes
    ----------
    kind : CSS class
    span : number of rows that the cell covers; 0 if a cell above covers it
    heads_row : True if the cell names its row
    """

    text: str
    kind: str = ""
    span: int = 1
    heads_row: bool = False


@dataclass(frozen=True)
class TableLine:
    """One table row as a page shows it; `kind` is its CSS class."""

    cells: list[TableText]
    kind: str


@dataclass(frozen=True)
class Table:
    """One table of a report.

    Attributes
    ----------
    name : key in tables.json, and identifier in a page
    title : heading of the table, a noun phrase
    paper_item : corresponding table or figure of the paper; empty if there is none
    columns : columns in their order
    rows : cells of each row by the column's key; None if there is no value
    notes : definitions and remarks below the table
    kinds : style of each row: "measured" (bold), "reference" (faint), "assumed" (shaded), "";
        empty tuple: rows with the source "paper" are "reference"
    group : key of the column in which equal neighbouring cells are merged; empty: none
    look : CSS class of the table
    """

    name: str
    title: str
    paper_item: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    group: str = ""
    look: str = "figures"

    def as_json(self) -> dict[str, Any]:
        """Return the content of the table without its style; keys as in tables.json."""
        look = ("kinds", "group", "look")
        names = {"paper_item": "beside"}
        return {
            names.get(key, key): value for key, value in asdict(self).items() if key not in look
        }

    def as_markdown(self) -> str:
        """Return heading, table and notes as Markdown."""
        lines = [f"### {self.title}", ""]
        if self.paper_item:
            lines += [f"Corresponds to {self.paper_item} of the paper.", ""]
        lines += [_line([c.title for c in self.columns]), _line(["---"] * len(self.columns))]
        lines += [_line(texts) for texts in self._texts()]
        return "\n".join([*lines, "", *(f"- {note}" for note in self.notes), ""])

    def as_text(self) -> str:
        """Return headings and rows as text for a terminal, with aligned columns."""
        lines = [[c.title for c in self.columns], *self._texts()]
        widths = [max(len(line[k]) for line in lines) for k in range(len(self.columns))]
        right = [self.kind_of(column) == "number" for column in self.columns]
        return "\n".join(
            "  ".join(
                text.rjust(width) if number else text.ljust(width)
                for text, width, number in zip(line, widths, right, strict=True)
            ).rstrip()
            for line in lines
        )

    def row(self, **cells: Cell) -> Row:
        """Return the first row with the given cells.

        Raises
        ------
        KeyError : the table has no such row
        """
        for row in self.rows:
            if all(row.get(key) == value for key, value in cells.items()):
                return row
        raise KeyError(f"{self.name}: no row with {cells}")

    def kind_of(self, column: Column) -> str:
        """Return the CSS class of a column's cells: `column.kind`, "number" or empty."""
        cells = (row.get(column.key) for row in self.rows)
        number = any(isinstance(cell, (int, float)) for cell in cells)
        return column.kind or ("number" if number else "")

    def heads(self) -> list[TableText]:
        """Return the headings as a page shows them; an empty list if no column has a heading."""
        if not any(column.title for column in self.columns):
            return []
        return [TableText(column.title, self.kind_of(column)) for column in self.columns]

    def bodies(self) -> Iterator[list[TableLine]]:
        """Yield the rows as a page shows them, one list per group of equal cells in `group`."""
        kinds = [self.kind_of(column) for column in self.columns]
        labels = kinds.index("number") if "number" in kinds else 1  # columns that name the row
        for _, numbered in groupby(enumerate(self.rows), lambda at: at[1].get(self.group)):
            together = list(numbered)
            yield [
                TableLine(
                    [
                        TableText(
                            shown(row.get(column.key), column.digits),
                            _kind(column, row.get(column.key), kinds[across]),
                            self._span(column, nth, len(together)),
                            across < labels,
                        )
                        for across, column in enumerate(self.columns)
                    ],
                    self._kind_of_row(place, row),
                )
                for nth, (place, row) in enumerate(together)
            ]

    def _span(self, column: Column, nth: int, count: int) -> int:
        if not self.group or column.key != self.group:
            return 1
        return 0 if nth else count

    def _kind_of_row(self, place: int, row: Row) -> str:
        if self.kinds:
            return self.kinds[place]
        return "reference" if row.get("source") == PAPER else ""

    def _texts(self) -> Iterator[list[str]]:
        for row in self.rows:
            yield [shown(row.get(column.key), column.digits) for column in self.columns]


def pairs(
    name: str, title: str, rows: Sequence[tuple[str, str, str]], look: str = "pairs"
) -> Table:
    """Return a table of (quantity, value, unit) without headings."""
    columns = (Column("what", ""), Column("value", "", kind="number"), Column("unit", ""))
    keys = [column.key for column in columns]
    cells = tuple(dict(zip(keys, row, strict=True)) for row in rows)
    return Table(name, title, "", columns, cells, look=look)


def parts(name: str, rows: Sequence[tuple[str, str]]) -> Table:
    """Return a table of (part, description) without headings."""
    columns = (Column("part", ""), Column("description", ""))
    cells = tuple({"part": part, "description": description} for part, description in rows)
    return Table(name, "", "", columns, cells, look="parts")


def _kind(column: Column, cell: Cell, kind: str) -> str:
    if column.key == "met":
        return "met" if cell == "yes" else "missed"
    return kind


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
