"""The pictures of one measurement that the paper's figures are made of.

| file in panels/ | content |
|---|---|
| object.png | the specimen alone in soft light |
| fringe.png | what the camera saw: one fringe image, or the colours of photometric stereo |
| relief.png, .pdf | measured surface, shaded; holes where there is no point |
| section.png, .pdf | of a single rod: cross-section with the width that is read from it |
| error.png, .pdf | measured minus true height |
| residuals.png, .pdf | of balls: residuals of the sphere fits |
| panels.npz, panels.json | the data behind them |
"""

import shutil
from collections.abc import Callable
from pathlib import Path

from matplotlib.axes import Axes

from twin.modalities.storage import CAPTURE_FOLDER
from twin.paper.panel_data import PanelData, write_panel_data
from twin.paper.panel_plots import (
    residual_limit_um,
    show_error,
    show_histogram,
    show_photograph,
    show_picture,
    show_residuals,
    show_section,
)
from twin.paper.panel_relief import show_relief, stage_for
from twin.paper.panel_sources import panel_data_of
from twin.paper.sheet import sheet
from twin.report.canvas import add_colorbar, axes_at
from twin.report.html import make_folder

PANELS_FOLDER = "panels"

_WIDTH_IN, _BAR_IN, _EDGE_IN = 3.0, 0.95, 0.02
_LARGE = ("*.ply", "*.stl", "*.nc", "*.exr", "height_map.*")
_LARGE_FOLDERS = (CAPTURE_FOLDER, "frames_exr", "frames_png")


def draw_panels(folder: Path) -> None:
    """Draw the panels of a complete result folder into its `panels` folder.

    Raises
    ------
    InputError
        The folder is no finished measurement, or the panels cannot be written.
    MissingBackend
        No usable Dr.Jit backend.
    """
    data, out = panel_data_of(folder), folder / PANELS_FOLDER
    make_folder(out)
    write_panel_data(out, data)
    _picture(out / "object", data.photograph.shape, lambda axes: show_photograph(axes, data))
    _picture(out / "fringe", data.picture.shape, lambda axes: show_picture(axes, data))
    _with_bar(out / "relief", 0.75, lambda axes: show_relief(axes, data, stage_for(data), bar=True))
    rows, cols = data.valid.shape
    limit_um = data.numbers.good_within_um
    _with_bar(out / "error", rows / cols, lambda axes: show_error(axes, data, limit_um))
    if len(data.section):
        _section(out / "section", data)
    if data.numbers.balls:
        _residuals(out / "residuals", data)


def prune(folder: Path) -> None:
    """Remove the large arrays of a result folder; figures, experiment and panels stay.

    What is left is no input for `twin report` any more.
    """
    for name in _LARGE_FOLDERS:
        shutil.rmtree(folder / name, ignore_errors=True)
    for pattern in _LARGE:
        for path in folder.glob(pattern):
            path.unlink()


def _picture(stem: Path, shape: tuple[int, ...], show: Callable[[Axes], None]) -> None:
    height_in = _WIDTH_IN * shape[0] / shape[1]
    with sheet(stem, _WIDTH_IN, height_in, pdf=False) as figure:
        show(axes_at(figure, 0.0, 0.0, _WIDTH_IN, height_in))


def _with_bar(stem: Path, aspect: float, show: Callable[[Axes], None]) -> None:
    inside_in = _WIDTH_IN - 2 * _EDGE_IN
    with sheet(stem, _WIDTH_IN, inside_in * aspect + _BAR_IN) as figure:
        show(axes_at(figure, _EDGE_IN, _EDGE_IN, inside_in, inside_in * aspect))


def _section(stem: Path, data: PanelData) -> None:
    with sheet(stem, 3.4, 1.7) as figure:
        show_section(axes_at(figure, 0.55, 0.25, 2.75, 1.0), data)


def _residuals(stem: Path, data: PanelData) -> None:
    limit_um, balls = residual_limit_um(data), data.numbers.balls
    with sheet(stem, 4.2, 0.1 + 1.85 * len(balls)) as figure:
        for line, ball in enumerate(balls):
            top_in = 0.2 + 1.85 * line
            residuals = axes_at(figure, 0.45, top_in, 1.25, 1.25)
            shown = show_residuals(residuals, data, ball.number, limit_um)
            add_colorbar(residuals, shown, "residual (µm)", extend="both")
            show_histogram(axes_at(figure, 2.8, top_in, 1.25, 1.25), data, ball.number, limit_um)
