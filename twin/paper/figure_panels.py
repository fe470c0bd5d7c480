"""Arrange the panels of a figure in a grid, and draw sections, residual maps and histograms."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reconstruction.errors import InputError
from twin.paper.panels import PANELS_FOLDER, PanelData, read_panel_data
from twin.report.canvas import (
    FAINT,
    FIT,
    INK,
    MEASURED,
    MEASURED_FILL,
    TRUE_FACE,
    axes_at,
    diverging,
    label_panel,
    legend_above,
    no_ticks,
    plain_spines,
    symmetric_limit,
)

LETTERS = "abcdefghijklmnopqrstuvwxyz"


@dataclass(frozen=True)
class Grid:
    """Grid of equal panels in a figure, with labels left of the rows and above the columns.

    All lengths are in inches.
    """

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
        """Width and height of the figure, inches."""
        across = self.columns * (self.cell_width_in + self.gap_in) - self.gap_in
        down = self.rows * (self.cell_height_in + self.row_gap_in) - self.row_gap_in
        return self.left_in + across + self.right_in, self.top_in + down + self.bottom_in

    def cell(self, figure: Figure, row: int, column: int, letter: bool = True) -> Axes:
        """Return new axes at one cell of the grid.

        If `letter` is True, the panel has a letter; letters increase along the rows.
        """
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
        """Write a vertical label to the left of each row."""
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
    """Return the panel data of the case NAME/METHOD; None if the case was not measured.

    Raises
    ------
    InputError
        The folder of the case has no panels, or they are damaged.
    """
    folder = cases / name / method
    if not folder.is_dir():
        return None
    if not (folder / PANELS_FOLDER).is_dir():
        raise InputError(f"{folder}: found no {PANELS_FOLDER}; measure the case again")
    return read_panel_data(folder / PANELS_FOLDER)


_MOST_CELLS, _POINTS_PER_CELL, _BINS = 90, 3, 61


def show_section(axes: Axes, data: PanelData, legend: bool = True) -> None:
    """Draw the measured and the true cross-section of a rod, and an arrow at its measured width."""
    axes.plot(*data.section.T, ".", color=MEASURED_FILL, ms=3.5, label="measured")
    axes.plot(*data.true_section.T, color=TRUE_FACE, lw=0.9, label="true coat")
    width = data.numbers.width
    if width is not None:
        level = float(np.interp(width.left_mm, *data.section.T))
        ends = (width.left_mm, width.right_mm)
        axes.annotate(
            "", (ends[1], level), (ends[0], level), arrowprops={"arrowstyle": "<->", "color": FIT}
        )
        axes.text(
            sum(ends) / 2,
            level,
            f"{width.width_mm:.2f} mm",
            color=FIT,
            ha="center",
            va="bottom",
            fontsize=7.0,
        )
    axes.set(xlabel="across the rod (mm)", ylabel="z (mm)")
    if legend:
        legend_above(axes, 2)
    plain_spines(axes)


def zoom_to_scored(axes: Axes, data: PanelData) -> None:
    """Set the axes' limits to the scored pixels plus a margin, in the picture's aspect ratio."""
    rows, cols = data.wanted.shape
    pixels = np.argwhere(data.wanted)
    if not len(pixels):
        return
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    share = min(1.0, 1.15 * float(((high - low + 1) / (rows, cols)).max()))
    row, col = (low + high) / 2
    axes.set_xlim(col - share * cols / 2, col + share * cols / 2)
    axes.set_ylim(row + share * rows / 2, row - share * rows / 2)


def residual_limit_um(*shown: PanelData) -> float:
    """Return the limit, um, of a scale from -limit to limit for the radial residuals of `shown`.

    The limit is the 99.5th percentile of the absolute residuals, for the measurement where it is
    largest.
    """
    return max(symmetric_limit(1e3 * data.ball_points[:, 3], 99.5) for data in shown)


def show_residuals(axes: Axes, data: PanelData, number: int, limit_um: float) -> Any:
    """Draw the map of radial residuals of one ball's fit over world x and y; return the image.

    A colour bar can be added to the returned image.
    """
    x, y, residual = data.ball(number).astype(np.float64).T
    cells = int(np.clip(np.sqrt(x.size / _POINTS_PER_CELL), 4, _MOST_CELLS))
    edges = [np.linspace(v.min(), v.max(), cells + 1) for v in (y, x)]
    total, *_ = np.histogram2d(y, x, edges, weights=1e3 * residual)
    count, *_ = np.histogram2d(y, x, edges)
    mean = np.ma.masked_array(total / np.maximum(count, 1), count == 0)
    (bottom, *_, top), (left, *_, right) = edges
    axes.set(aspect="equal", xlabel="x (mm)", ylabel="y (mm)")
    plain_spines(axes)
    axes.grid(visible=False)
    return axes.imshow(
        mean,
        origin="lower",
        extent=(left, right, bottom, top),
        cmap=diverging().with_extremes(bad="white"),
        vmin=-limit_um,
        vmax=limit_um,
    )


def show_histogram(axes: Axes, data: PanelData, number: int, limit_um: float) -> None:
    """Draw the histogram of the radial residuals of one ball, in percent of its points."""
    residual_um = 1e3 * data.ball(number)[:, 2].astype(np.float64)
    edges = np.linspace(-limit_um, limit_um, _BINS + 1)
    weights = np.full(residual_um.size, 100.0 / max(residual_um.size, 1))
    axes.hist(
        np.clip(residual_um, -limit_um, limit_um), edges.tolist(), weights=weights,
        color=MEASURED_FILL, edgecolor=MEASURED, linewidth=0.3,
    )  # fmt: skip
    ball = next(ball for ball in data.numbers.balls if ball.number == number)
    title = f"r {ball.radius_mm:.3f} mm, RMSE {1e3 * ball.rmse_mm:.1f} µm"
    axes.set_title(title, fontsize=6.0, loc="center")
    axes.axvline(0.0, color=FAINT, lw=0.6)
    axes.set(xlabel="radial residual (µm)", ylabel="points (%)", xlim=(-limit_um, limit_um))
    plain_spines(axes)


def no_measurement(axes: Axes, words: str = "not measured") -> None:
    """Write the text `words` into the empty panel of a case without measurement."""
    no_ticks(axes)
    axes.text(0.5, 0.5, words, color=INK, ha="center", transform=axes.transAxes)
