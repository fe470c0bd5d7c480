"""Where the panels of a figure go: a grid of equal cells with labels, lengths in inches."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reconstruction.errors import InputError
from twin.paper.panel_data import PANELS_FOLDER, PanelData, read_panel_data
from twin.paper.sheet import label_panel
from twin.report.canvas import axes_at

LETTERS = "abcdefghijklmnopqrstuvwxyz"


@dataclass(frozen=True)
class Grid:
    """Equal cells; the labels of rows stand left of them, those of columns above."""

    rows: int
    columns: int
    cell_width_in: float
    cell_height_in: float
    left_in: float = 0.45
    top_in: float = 0.25
    gap_in: float = 0.05
    row_gap_in: float = 0.05
    right_in: float = 0.05
    bottom_in: float = 0.05

    @property
    def size_in(self) -> tuple[float, float]:
        """Width and height of the figure."""
        across = self.columns * (self.cell_width_in + self.gap_in) - self.gap_in
        down = self.rows * (self.cell_height_in + self.row_gap_in) - self.row_gap_in
        return self.left_in + across + self.right_in, self.top_in + down + self.bottom_in

    def cell(self, figure: Figure, row: int, column: int, letter: bool = True) -> Axes:
        """Return the axes of one cell; letters run along the rows."""
        axes = axes_at(
            figure,
            self.left_in + column * (self.cell_width_in + self.gap_in),
            self.top_in + row * (self.cell_height_in + self.row_gap_in),
            self.cell_width_in,
            self.cell_height_in,
        )
        if letter:
            label_panel(axes, LETTERS[row * self.columns + column])
        return axes

    def label_rows(self, figure: Figure, labels: Sequence[str]) -> None:
        """Write a label beside each row, upright."""
        width_in, height_in = figure.get_size_inches()
        for row, label in enumerate(labels):
            middle_in = self.top_in + row * (self.cell_height_in + self.row_gap_in)
            middle_in += self.cell_height_in / 2
            figure.text(
                0.42 * self.left_in / width_in,
                1.0 - middle_in / height_in,
                label,
                rotation=90,
                ha="center",
                va="center",
                fontsize=7.5,
            )

    def label_columns(self, figure: Figure, labels: Sequence[str], span: int = 1) -> None:
        """Write a label above each group of `span` columns."""
        width_in, height_in = figure.get_size_inches()
        pitch_in = self.cell_width_in + self.gap_in
        for number, label in enumerate(labels):
            middle_in = self.left_in + (number * span + span / 2) * pitch_in - self.gap_in / 2
            place = middle_in / width_in, 1.0 - 0.5 * self.top_in / height_in
            figure.text(*place, label, ha="center", va="center", fontsize=8.0)


def panels_of(cases: Path, name: str, method: str) -> PanelData | None:
    """Return the panels of one case; None when it was not measured.

    Raises
    ------
    InputError
        The case is there without panels, or they are damaged.
    """
    folder = cases / name / method
    if not folder.is_dir():
        return None
    if not (folder / PANELS_FOLDER).is_dir():
        raise InputError(f"{folder}: found no {PANELS_FOLDER}; measure the case again")
    return read_panel_data(folder / PANELS_FOLDER)
