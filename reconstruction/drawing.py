"""Draw results for notebooks: maps over world x and y, sections, distributions.

In `reconstruction` only this module imports Matplotlib; other modules import it on first use.
"""

import base64
import html
import io
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from numpy.typing import NDArray

from reconstruction.cells import CellMeans, SquareCells

_MOST_CELLS = 400
_GAP = "#d9d9d9"
_DPI = 100
# Gap between neighbouring panels, as a share of a panel's width and height.
_ROOM_ACROSS, _ROOM_DOWN = 0.06, 0.08


class Drawing(Figure):
    """A Matplotlib figure that a notebook displays as PNG; `savefig` writes it to a file."""

    def __init__(self, panels: int, rows: int = 1) -> None:
        size = 4.4 * panels, 3.4 * rows
        layout = ConstrainedLayoutEngine(wspace=_ROOM_ACROSS, hspace=_ROOM_DOWN)
        super().__init__(figsize=size, facecolor="white", layout=layout)

    def png(self) -> bytes:
        """Return the figure as the bytes of a PNG file."""
        drawn = io.BytesIO()
        self.savefig(drawn, format="png", dpi=_DPI, metadata={"Software": None})
        return drawn.getvalue()

    def _repr_png_(self) -> bytes:
        return self.png()


def gridded(points_mm: NDArray[Any], values: NDArray[Any]) -> CellMeans:
    """Return the means of values (point,) in square cells, at most 400 along x and along y.

    Parameters
    ----------
    points_mm : (point, xyz), world frame; the cells are about two mean point distances wide
    """
    span_mm = float(np.ptp(points_mm[:, :2], axis=0).max())
    # With cells as wide as two mean distances of neighbours almost every cell has a point.
    apart_mm = 2.0 * np.sqrt(np.prod(np.ptp(points_mm[:, :2], axis=0)) / len(points_mm))
    pitch_mm = max(span_mm / _MOST_CELLS, float(apart_mm), 1e-6)
    return SquareCells.of(points_mm, pitch_mm).means(values)


def draw_cells(
    axes: Axes, cells: CellMeans, title: str, label: str, *, signed: bool = False
) -> None:
    """Draw cell means over world x and y with a colour bar; cells without a point are grey.

    Parameters
    ----------
    label : label of the colour bar, with the unit
    signed : whether the colour scale is symmetric about 0, up to the 99th percentile of |mean|
    """
    values = cells.mean[cells.valid]
    if signed:
        high = float(np.percentile(np.abs(values), 99.0)) or 1.0
        low = -high
    else:
        low, high = float(values.min()), float(values.max())
    axes.set_facecolor(_GAP)
    shown = axes.imshow(
        np.ma.masked_array(cells.mean, ~cells.valid),
        extent=cells.extent_mm,
        cmap="RdBu_r" if signed else "viridis",
        vmin=low,
        vmax=high,
    )
    axes.set(title=title, xlabel="x (mm)", ylabel="y (mm)")
    figure = axes.get_figure()
    assert figure is not None
    figure.colorbar(shown, ax=axes, label=label, extend="both" if signed else "neither")


def draw_image(axes: Axes, image: NDArray[Any], title: str, label: str, most: float) -> None:
    """Draw a camera image (row, col), row 0 at the top; 0 is black, `most` is white."""
    shown = axes.imshow(image, cmap="gray", vmin=0, vmax=most)
    axes.set(title=title, xlabel="column (px)", ylabel="row (px)")
    figure = axes.get_figure()
    assert figure is not None
    figure.colorbar(shown, ax=axes, label=label)


def draw_distribution(
    axes: Axes, values: NDArray[Any], label: str, interval: tuple[float, float] | None
) -> None:
    """Draw the histogram of the samples (n,) of a quantity, and an interval as a shaded band.

    Parameters
    ----------
    label : name of the quantity, with the unit
    interval : lower and upper end of the band; None: no band
    """
    axes.hist(values, bins="auto" if np.ptp(values) > 0 else 1, color="#4c72b0")
    if interval is not None:
        axes.axvspan(*interval, color="#4c72b0", alpha=0.15)
    axes.set(xlabel=label, ylabel="samples")


def draw_section(axes: Axes, curves: Mapping[str, CellMeans]) -> None:
    """Draw sections z(x), mm, of height maps by name, each in its row of cells nearest y = 0."""
    for number, (name, cells) in enumerate(curves.items()):
        row = int(np.abs(cells.y_mm).argmin())
        z_mm = np.ma.masked_array(cells.mean[row], ~cells.valid[row])
        axes.plot(cells.x_mm, z_mm, label=name, linewidth=1.6 - 0.6 * number)
    axes.set(title="section at y = 0", xlabel="x (mm)", ylabel="z (mm)")
    axes.grid(visible=True, alpha=0.4)
    axes.legend()


def as_html(title: str, rows: Mapping[str, str], drawing: Drawing) -> str:
    """Return HTML for a notebook: the title, a table of names and values, and the figure."""
    lines = "".join(
        f'<tr><td style="text-align:left">{html.escape(name)}</td>'
        f'<td style="text-align:right">{html.escape(value)}</td></tr>'
        for name, value in rows.items()
    )
    picture = base64.b64encode(drawing.png()).decode("ascii")
    return (
        f"<p><b>{html.escape(title)}</b></p><table>{lines}</table>"
        f'<img alt="{html.escape(title)}" src="data:image/png;base64,{picture}">'
    )
