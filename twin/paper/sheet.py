"""How the paper's figures look, and how they reach the disk: PNG for the page, PDF for print.

The same data give the same bytes: no date and no version is written into either file.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from twin.output import replacing
from twin.report.canvas import FAINT, GRID, INK

DPI = 200

_STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 7.5,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.labelsize": 7.5,
    "axes.edgecolor": FAINT,
    "axes.linewidth": 0.6,
    "axes.titlesize": 8.0,
    "axes.titlelocation": "left",
    "axes.titlepad": 4.0,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.5,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "legend.fontsize": 6.5,
    "legend.frameon": False,
    "image.interpolation": "nearest",
    "pdf.fonttype": 42,  # text stays text
}


@contextmanager
def sheet(stem: Path, width_in: float, height_in: float) -> Iterator[Figure]:
    """Yield a figure; at the end it is written as `stem`.png and .pdf, each whole or not at all.

    Raises
    ------
    InputError
        The files cannot be written.
    """
    with rc_context(_STYLE):
        figure = Figure(figsize=(width_in, height_in), facecolor="white")
        FigureCanvasAgg(figure)
        yield figure
        _write(figure, stem.with_name(f"{stem.name}.png"), "png", {"Software": None})
        undated = {"CreationDate": None, "Producer": None, "Creator": None}
        _write(figure, stem.with_name(f"{stem.name}.pdf"), "pdf", undated)


def label_panel(axes: Axes, letter: str) -> None:
    """Put a panel's letter into its upper left corner, as the paper does."""
    axes.text(
        0.02,
        0.97,
        f"({letter})",
        transform=axes.transAxes,
        va="top",
        fontsize=7.0,
        bbox={"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 1.2},
    )


def bare(axes: Axes) -> None:
    """Leave a picture without ticks."""
    axes.set(xticks=[], yticks=[])


def _write(figure: Figure, path: Path, kind: str, metadata: dict[str, None]) -> None:
    with replacing(path) as part:
        figure.savefig(part, format=kind, dpi=DPI, metadata=metadata)
