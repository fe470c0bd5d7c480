"""Draw figures of measured objects: metal and clear objects, rods, GelSight, sphere fits."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from reconstruction.arrays import Reason
from twin.paper.figure_panels import (
    LETTERS,
    Grid,
    no_measurement,
    panels_of,
    residual_limit_um,
    show_histogram,
    show_residuals,
    show_section,
    zoom_to_scored,
)
from twin.paper.panels import PanelData
from twin.paper.plan import RODS as ROD_NAMES
from twin.paper.relief_views import ReliefView, show_relief, show_scale, stage_for
from twin.report.bare import REASON_WORDS
from twin.report.canvas import FAINT, add_colorbar, axes_at, label_panel, no_ticks, printing
from twin.report.pixel_panels import REASON_COLOURS, show_codes, show_picture, show_z_error
from twin.report.words import number

_ROWS = {"direct_fpp": "Conventional DFP\n(direct)", "contact_fpp": "Proposed\n(contact-FPP)"}
HARD_OBJECTS = {"nut": "nut", "brick": "clear brick", "ball": "metal ball"}
COMPARED_OBJECTS = {"t_bolt": "T-bolt", "bear": "transparent bear", "two_balls": "two balls"}
RODS = {name: name[-1].upper() for name in ROD_NAMES}


def draw_direct_and_contact(cases: Path, stem: Path) -> None:
    """Draw fringe image and 3-D view of nut, brick and ball, both bare and under the coat."""
    grid = Grid(2, 6, 1.1, 0.83, row_gap_in=0.55, bottom_in=0.55)
    with printing(stem, *grid.size_in) as figure:
        grid.label_rows(figure, list(_ROWS.values()))
        grid.label_columns(figure, list(HARD_OBJECTS.values()), span=2)
        for row, method in enumerate(_ROWS):
            for number, name in enumerate(HARD_OBJECTS):
                data = panels_of(cases, name, method)
                _pair(figure, grid, (row, 2 * number), data)


def draw_missing(cases: Path, stem: Path) -> None:
    """Draw reasons for missing points of direct fringe projection, and z errors of both methods."""
    grid = Grid(3, 3, 1.75, 1.32, row_gap_in=0.12, bottom_in=1.3)
    with printing(stem, *grid.size_in) as figure:
        grid.label_rows(figure, ["direct: reason", "direct: z error", "contact: z error"])
        grid.label_columns(figure, list(HARD_OBJECTS.values()))
        for column, name in enumerate(HARD_OBJECTS):
            direct, contact = (panels_of(cases, name, method) for method in _ROWS)
            last = column == 1
            _cell(grid.cell(figure, 0, column), direct, _reasons_near)
            _cell(grid.cell(figure, 1, column), direct, _error_near)
            _cell(grid.cell(figure, 2, column), contact, _error_with_bar if last else _error_alone)
        _legend_of_reasons(figure)


def draw_rods(cases: Path, stem: Path) -> None:
    """Draw picture, fringe image, 3-D view and cross-section of each rod, on one height scale."""
    section_in, gap_in = 2.5, 0.5
    grid = Grid(3, 3, 1.2, 0.9, row_gap_in=gap_in, right_in=section_in + 0.6, bottom_in=0.55)
    left_in = grid.size_in[0] - section_in - 0.1
    wide = Grid(3, 1, section_in, grid.cell_height_in, left_in=left_in, row_gap_in=gap_in)
    shown = {name: panels_of(cases, name, "contact_fpp") for name in RODS}
    measured = [data for data in shown.values() if data is not None]
    with printing(stem, *grid.size_in) as figure:
        grid.label_rows(figure, [f"rod {letter}" for letter in RODS.values()])
        grid.label_columns(figure, ["object", "fringe image", "3-D"])
        for row, data in enumerate(shown.values()):
            cells = [grid.cell(figure, row, column, letter=False) for column in range(3)]
            cells.append(wide.cell(figure, row, 0, letter=False))
            for column, axes in enumerate(cells):
                label_panel(axes, LETTERS[row * len(cells) + column])
            _rod(cells, data, measured, last=row == grid.rows - 1)


def _rod(cells: list[Axes], data: PanelData | None, measured: list[PanelData], last: bool) -> None:
    if data is None:
        for axes in cells:
            no_measurement(axes)
        return
    photograph, fringes, relief, section = cells
    show_picture(photograph, data.photograph)
    show_picture(fringes, data.picture)
    show_relief(relief, data, stage_for(*measured), bar=last)
    if not len(data.section):
        no_measurement(section, "no point on the section")
        return
    show_section(section, data, legend=data is measured[0])
    heights = np.concatenate([panels.section[:, 1] for panels in measured])
    room = 0.08 * np.ptp(heights)
    section.set_ylim(heights.min() - room, heights.max() + room)
    if data.numbers.width is not None:
        section.set_title(f"ref. {data.numbers.width.nominal_mm:.2f} mm")


def draw_grid(cases: Path, stem: Path) -> None:
    """Draw photograph, GelSight image, fringe image and both measured surfaces of three objects."""
    grid = Grid(5, 3, 1.5, 1.12, bottom_in=0.65)
    with printing(stem, *grid.size_in) as figure:
        grid.label_rows(
            figure, ["object", "GelSight 2-D", "fringe image", "GelSight 3-D", "contact-FPP 3-D"]
        )
        grid.label_columns(figure, list(COMPARED_OBJECTS.values()))
        for column, name in enumerate(COMPARED_OBJECTS):
            gelsight = panels_of(cases, name, "photometric_stereo")
            contact = panels_of(cases, name, "contact_fpp")
            cells = [grid.cell(figure, row, column) for row in range(grid.rows)]
            _cell(cells[0], contact, _photograph)
            _cell(cells[1], gelsight, _picture)
            _cell(cells[2], contact, _picture)
            _compared_reliefs((cells[3], cells[4]), gelsight, contact)


def _pair(figure: Figure, grid: Grid, at: tuple[int, int], data: PanelData | None) -> None:
    row, column = at
    left, right = (grid.cell(figure, row, column + k) for k in range(2))
    if data is None:
        no_measurement(left)
        no_measurement(right)
        return
    show_picture(left, data.picture)
    stage = stage_for(data)
    show_relief(right, data, stage)
    show_scale(right, stage)
    shares = data.numbers.completeness, data.numbers.good_share
    words = "{} points, {} right".format(*(number(share, ".0%") for share in shares))
    left.text(
        0.5, -0.05, words, transform=left.transAxes, ha="center", va="top", color=FAINT, fontsize=6
    )


def _compared_reliefs(
    axes: tuple[Axes, Axes], gelsight: PanelData | None, contact: PanelData | None
) -> None:
    """Draw both measured surfaces with one height scale, one enlargement of z and one size."""
    measured = [panels for panels in (gelsight, contact) if panels is not None]
    for place, data in zip(axes, (gelsight, contact), strict=True):
        if data is None:
            no_measurement(place)
        else:
            show_relief(place, data, stage_for(*measured))
    if measured:
        show_scale(axes[1], stage_for(*measured))


def _cell(axes: Axes, data: PanelData | None, show: Callable[[Axes, PanelData], None]) -> None:
    if data is None:
        no_measurement(axes)
    else:
        show(axes, data)


def _photograph(axes: Axes, data: PanelData) -> None:
    show_picture(axes, data.photograph)


def _picture(axes: Axes, data: PanelData) -> None:
    show_picture(axes, data.picture)


def _reasons_near(axes: Axes, data: PanelData) -> None:
    show_codes(axes, np.ma.masked_array(data.reason, ~data.wanted))
    no_ticks(axes)
    zoom_to_scored(axes, data)


def _error_near(axes: Axes, data: PanelData) -> None:
    _error_alone(axes, data)
    zoom_to_scored(axes, data)


def _error_alone(axes: Axes, data: PanelData) -> None:
    show_z_error(axes, data.error_um, data.numbers.good_within_um, bar=False)


def _error_with_bar(axes: Axes, data: PanelData) -> None:
    show_z_error(axes, data.error_um, data.numbers.good_within_um)


def _legend_of_reasons(figure: Figure) -> None:
    known = [reason for reason in Reason if reason in REASON_WORDS]
    handles = [Patch(color=REASON_COLOURS[r], label=REASON_WORDS[r]) for r in known]
    figure.legend(handles=handles, loc="lower center", ncols=3, handlelength=1.0)


_SPECIMEN = "two_balls"
_METHODS = {"photometric_stereo": "GelSight", "contact_fpp": "contact-FPP (proposed)"}
_WIDTH_IN, _HEIGHT_IN = 7.16, 5.8
_HALF_IN = _WIDTH_IN / 2
_SURFACE_TOP_IN, _MAP_TOP_IN, _HISTOGRAM_TOP_IN = 0.25, 2.6, 4.3
_BALLS = 2


def draw_sphere_fit(cases: Path, stem: Path) -> None:
    """Draw surfaces and fit residuals of the two joined balls by GelSight and by contact-FPP.

    Both methods have one height scale and one scale of the residuals.
    """
    by_method = {method: panels_of(cases, _SPECIMEN, method) for method in _METHODS}
    measured = [panels for panels in by_method.values() if panels is not None]
    with printing(stem, _WIDTH_IN, _HEIGHT_IN) as figure:
        for column, (method, name) in enumerate(_METHODS.items()):
            left_in = column * _HALF_IN
            figure.text(
                (left_in + _HALF_IN / 2) / _WIDTH_IN,
                1 - 0.13 / _HEIGHT_IN,
                name,
                ha="center",
                va="center",
                fontsize=8.5,
            )
            data = by_method[method]
            axes = axes_at(figure, left_in + 0.5, _SURFACE_TOP_IN, 2.2, 1.45)
            label_panel(axes, LETTERS[column])
            if data is None:
                no_measurement(axes)
                continue
            _surface(axes, data, stage_for(*measured))
            _residuals(figure, column, data, residual_limit_um(*measured))


def _surface(axes: Axes, data: PanelData, stage: ReliefView) -> None:
    show_relief(axes, data, stage)
    show_scale(axes, stage)


def _residuals(figure: Figure, column: int, data: PanelData, limit_um: float) -> None:
    """Draw a map of the radial residuals for each ball, and their histogram below the map."""
    for place, ball in enumerate(data.numbers.balls[:_BALLS]):
        left_in = column * _HALF_IN + 0.42 + 1.3 * place
        residuals = axes_at(figure, left_in, _MAP_TOP_IN, 1.05, 1.05)
        shown = show_residuals(residuals, data, ball.number, limit_um)
        residuals.set_title(f"sphere {ball.number}", color=FAINT)
        histogram = axes_at(figure, left_in, _HISTOGRAM_TOP_IN, 1.05, 1.0)
        show_histogram(histogram, data, ball.number, limit_um)
        if place:
            add_colorbar(residuals, shown, "residual (µm)", extend="both")
            residuals.set_ylabel("")
            histogram.set_ylabel("")
        else:
            label_panel(residuals, LETTERS[2 + column])
            label_panel(histogram, LETTERS[4 + column])
