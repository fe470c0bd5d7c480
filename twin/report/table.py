"""Tables as data: columns with units and digits, rows of cells; as HTML, Markdown, text, JSON."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from typing import Any

from twin.report.words import shown

PAPER, TWIN = "paper", "twin"
"""Values of a column `source`: who measured the row."""

Cell = str | int | float | None
Row = Mapping[str, Cell]


@dataclass(frozen=True)
class Column:
    """One column.

    Attributes
    ----------
    key : of the cells
    heading : text; `unit` is appended in brackets
    digits : decimals of its floats
    kind : class of its cells in the page; "number" (right-aligned) where any of them is one
    """

    key: str
    heading: str
    digits: int = 3
    unit: str = ""
    kind: str = ""

    @property
    def title(self) -> str:
        """Heading with unit."""
        return f"{self.heading} ({self.unit})" if self.unit else self.heading


@dataclass(frozen=True)
class TableText:
    """One cell as a page shows it; `span`: rows that it covers, 0 if a cell above covers it."""

    text: str
    kind: str = ""
    span: int = 1
    heads_row: bool = False


@dataclass(frozen=True)
class TableLine:
    """One row as a page shows it."""

    cells: list[TableText]
    kind: str


@dataclass(frozen=True)
class Table:
    """One table.

    Attributes
    ----------
    name : key in tables.json, and its place in a page
    title : noun phrase
    paper_item : corresponding table or figure of the paper; empty if there is none
    columns : in order
    rows : cells by column key; None where there is no number
    notes : definitions and remarks below the table
    kinds : how each row is shown: "measured" (bold), "reference" (faint), "assumed" (shaded), ""
    group : column in which equal neighbouring cells are merged
    look : class of the table in the page's style sheet
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
        """Return heading, table and notes."""
        lines = [f"### {self.title}", ""]
        if self.paper_item:
            lines += [f"Corresponds to {self.paper_item} of the paper.", ""]
        lines += [_line([c.title for c in self.columns]), _line(["---"] * len(self.columns))]
        lines += [_line(texts) for texts in self._texts()]
        return "\n".join([*lines, "", *(f"- {note}" for note in self.notes), ""])

    def as_text(self) -> str:
        """Return headings and rows for a terminal, columns aligned."""
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
        KeyError : there is none
        """
        for row in self.rows:
            if all(row.get(key) == value for key, value in cells.items()):
                return row
        raise KeyError(f"{self.name}: no row with {cells}")

    def kind_of(self, column: Column) -> str:
        """Return the class of a column's cells."""
        cells = (row.get(column.key) for row in self.rows)
        number = any(isinstance(cell, (int, float)) for cell in cells)
        return column.kind or ("number" if number else "")

    def heads(self) -> list[TableText]:
        """Return the headings as a page shows them; none where no column has one."""
        if not any(column.title for column in self.columns):
            return []
        return [TableText(column.title, self.kind_of(column)) for column in self.columns]

    def bodies(self) -> Iterator[list[TableLine]]:
        """Return the rows as a page shows them, those of one group together."""
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
