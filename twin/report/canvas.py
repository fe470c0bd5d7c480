"""Style, colour maps, scales and files of all figures: PNG for pages, additionally PDF for print.

Figures use Matplotlib's object interface, without global state or window system. Equal data give
files with equal bytes, because no date and no version is written into the files.
"""

import io
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import Colormap
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter
from numpy.typing import NDArray

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.cells import box_of
from reconstruction.writing import write_bytes, write_film
from twin.files import naming_unwritable

_SCREEN_DPI, _PRINT_DPI, _FILM_DPI = 130, 200, 100

INK, FAINT, GRID = "#1d2733", "#6b7785", "#dfe4ea"
MEASURED, TRUE_FACE, NOMINAL, FIT = "#1f6fb2", "#2b8a57", "#8a5a00", "#c2410c"
MEASURED_FILL = "#a9c8e3"
GAP = "#e9ecf0"
"""Colour of pixels without a value; no colour map of this module contains this colour."""

# Limits of `symmetric_limit`: an error scale covers the noise, and outliers are beyond its ends.
_CORE_PERCENT, _CORES = 68.3, 4.0
_WIDENED, _LEAST_SPAN_MM = 0.5, 0.2

_ROUND_STEPS = (1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10)

_STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": FAINT,
    "axes.linewidth": 0.7,
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
    "axes.titlepad": 6.0,
    "axes.titley": 1.0,  # fixed: an automatic position lays out every tick label a second time
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "image.interpolation": "nearest",
    "text.parse_math": False,  # names are user input, in which "$" starts no formula
}


# Sizes of a two-column journal.
_PRINT: Any = _STYLE | {
    "font.size": 7.5,
    "axes.labelsize": 7.5,
    "axes.linewidth": 0.6,
    "axes.titlesize": 8.0,
    "axes.titlepad": 4.0,
    "grid.linewidth": 0.5,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "legend.fontsize": 6.5,
    "pdf.fonttype": 42,  # embed fonts, so that text remains text
}


@contextmanager
def drawing(path: Path, width_in: float, height_in: float) -> Iterator[Figure]:
    """Yield an empty figure; at the end of the context, write it atomically to `path` as PNG.

    Place the axes with `axes_at`: Matplotlib's layout engines double the run time of a report.

    Raises
    ------
    InputError : `path` cannot be written
    """
    with _styled(_STYLE, width_in, height_in) as figure:
        yield figure
        _write(figure, path, _SCREEN_DPI)


def draw_film(
    path: Path,
    size_in: tuple[float, float],
    draw: Callable[[Figure, int], None],
    count: int,
    frame_ms: float,
) -> None:
    """Write an animated PNG atomically; `draw` fills an empty figure for each frame number.

    Raises
    ------
    InputError : `path` cannot be written
    """
    frames = []
    with _styled(_STYLE | {"figure.dpi": _FILM_DPI}, *size_in) as figure:
        canvas: Any = figure.canvas  # its methods have no types
        for frame in range(count):
            figure.clear()
            draw(figure, frame)
            canvas.draw()
            frames.append(np.array(canvas.buffer_rgba())[..., :3])
    with naming_unwritable(path):
        write_film(path, np.array(frames), frame_ms)


@contextmanager
def printing(stem: Path, width_in: float, height_in: float) -> Iterator[Figure]:
    """Yield an empty figure; at the end of the context, write `stem`.png and `stem`.pdf.

    Each file is written atomically.

    Raises
    ------
    InputError : the files cannot be written
    """
    with _styled(_PRINT, width_in, height_in) as figure:
        yield figure
        for kind in ("png", "pdf"):
            _write(figure, stem.with_name(f"{stem.name}.{kind}"), _PRINT_DPI)


@contextmanager
def _styled(style: Any, width_in: float, height_in: float) -> Iterator[Figure]:
    with rc_context(style):
        figure = Figure(figsize=(width_in, height_in), facecolor="white")
        FigureCanvasAgg(figure)
        yield figure


def _write(figure: Figure, path: Path, dpi: int) -> None:
    kind = path.suffix[1:]
    undated: Any = {"Software": None}
    if kind == "pdf":
        undated = {"CreationDate": None, "Producer": None, "Creator": None}
    # The default level, 6, doubles the time and reduces the size by 10 % only.
    packed: Any = {"pil_kwargs": {"compress_level": 3}} if kind == "png" else {}
    memory = io.BytesIO()
    figure.savefig(memory, format=kind, dpi=dpi, metadata=undated, **packed)
    with naming_unwritable(path):
        write_bytes(path, memory.getbuffer())


def sequential() -> Colormap:
    """Return the colour map of amounts; pixels without a value are gray."""
    return colormaps["viridis"].with_extremes(bad=GAP)


def diverging() -> Colormap:
    """Return the colour map of signed errors, white at 0; its scale must be symmetric about 0."""
    return colormaps["RdBu_r"].with_extremes(bad=GAP)


def cyclic() -> Colormap:
    """Return the cyclic colour map of phases, with equal colours for 0 and 2 pi."""
    return colormaps["twilight"].with_extremes(bad=GAP)


def round_up(value: float) -> float:
    """Return the next larger round number (or `value` if it is round); 1 for `value` <= 0.

    Similar results then have the same scale.
    """
    if not value > 0:
        return 1.0
    decade = 10.0 ** math.floor(math.log10(value))
    # 1e-9: a value that is already round must not be increased because of its rounding error.
    step = next(step for step in _ROUND_STEPS if step * decade >= value * (1 - 1e-9))
    return float(f"{step * decade:.6g}")


def height_scale(z_mm: NDArray[Any]) -> tuple[float, float]:
    """Return the rounded ends (mm) of a scale of heights: 0 and the peak.

    The lower end is negative if the lowest height is below 0 by more than 5 % of the peak.
    """
    low, high = float(z_mm.min()), float(z_mm.max())
    # A free sheet is below 0 by some per cent of the peak next to the contact: the scale need not
    # include these heights.
    sinks = low < -0.05 * max(high, 0.0) and low < 0
    top = 0.0 if sinks and high <= 0 else round_up(high)
    return (-round_up(-low) if sinks else 0.0, top)


def contour_levels(low: float, high: float) -> list[float]:
    """Return equally spaced round levels strictly between `low` and `high`."""
    step = round_up(max(high - low, 1e-9) / 8)
    first, last = math.floor(low / step) + 1, math.ceil(high / step) - 1
    return [float(f"{n * step:.6g}") for n in range(first, last + 1)]


def symmetric_limit(values: NDArray[Any], percent: float = 99.0) -> float:
    """Return the limit of a scale from -limit to limit for signed values; 1 without values.

    The limit is the magnitude that `percent` of the values do not exceed, rounded up. It is at most
    four times the 68th percentile of the magnitude, so that outliers do not determine the scale.
    For normal noise, this percentile is the standard deviation.
    """
    if not values.size:
        return 1.0
    most, core = np.percentile(np.abs(values), (percent, _CORE_PERCENT))
    return round_up(float(min(most, _CORES * core) if core > 0 else most))


def near_truth(points_mm: FloatArray, true_mm: FloatArray) -> BoolArray:
    """Return True for points (n, xyz) in the enlarged bounding box of the true points.

    The box is enlarged on each side by half its span. Points outside this box are decoding errors;
    if they were drawn, the true surface would be too small to see.
    """
    low, high = box_of(true_mm)
    margin = _WIDENED * np.maximum(high - low, _LEAST_SPAN_MM)
    inside = np.ones(len(points_mm), bool)
    for axis_mm, least, largest in zip(points_mm.T, low - margin, high + margin, strict=True):
        inside &= (axis_mm >= least) & (axis_mm <= largest)
    return inside


def axes_at(
    figure: Figure, left_in: float, top_in: float, width_in: float, height_in: float
) -> Axes:
    """Add axes to a figure and return them.

    `left_in` and `top_in` are the distances, inches, of the axes' upper left corner from the left
    and the upper edge of the figure.
    """
    across_in, down_in = figure.get_size_inches()
    return figure.add_axes(
        (
            left_in / across_in,
            1.0 - (top_in + height_in) / down_in,
            width_in / across_in,
            height_in / down_in,
        )
    )


def add_colorbar(
    axes: Axes,
    shown: Any,
    label: str,
    extend: Literal["neither", "both", "max"] = "neither",
    side: Literal["right", "below"] = "right",
) -> None:
    """Draw the colour bar of a map next to the map.

    Parameters
    ----------
    shown : the map drawn on `axes`
    label : quantity and unit
    extend : ends of the scale with an arrow, for values beyond the end
    side : side of the map on which the colour bar is drawn
    """
    figure = axes.get_figure(root=True)
    assert figure is not None
    right = side == "right"
    width_in = axes.get_position().width * figure.get_size_inches()[0]
    place = (
        (1.0 + 0.1 / width_in, 0.0, 0.14 / width_in, 1.0) if right else (0.08, -0.22, 0.84, 0.05)
    )
    bar = figure.colorbar(
        shown,
        cax=axes.inset_axes(place),
        extend=extend,
        orientation="vertical" if right else "horizontal",
    )
    bar.set_label(label)


def legend_above(axes: Axes, entries: int) -> None:
    """Put the legend directly above the axes, in one line of `entries` entries.

    No curve can be hidden by a legend at this position.
    """
    axes.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=entries,
        borderaxespad=0.2,
        columnspacing=1.2,
        handlelength=1.6,
    )


def chart(axes: Axes, title: str, xlabel: str, ylabel: str, **limits: Any) -> None:
    """Set title, axis labels and limits of a plot of curves, and draw a light grid behind them."""
    axes.set(title=title, xlabel=xlabel, ylabel=ylabel, **limits)
    plain_spines(axes)


def draw_map(
    axes: Axes,
    values: NDArray[Any],
    extent_mm: tuple[float, float, float, float],
    title: str,
    label: str,
    *,
    cmap: Colormap | None = None,
    ends: tuple[float | None, float | None] = (None, None),
    extend: Literal["neither", "both", "max"] = "neither",
) -> None:
    """Draw a map over world x and y with its colour bar.

    Parameters
    ----------
    values : (row along y, col along x), row 0 at the smallest y
    extent_mm : left, right, bottom, top
    label : label of the colour bar, with the unit
    cmap : colour map; None: the colour map of amounts
    ends : values at the ends of the colour map; None: smallest or largest value
    extend : ends of the colour bar with an arrow, for values beyond the end
    """
    low, high = ends
    colours = cmap or sequential()
    shown = axes.imshow(values, origin="lower", extent=extent_mm, cmap=colours, vmin=low, vmax=high)
    axes.set(title=title, xlabel="x (mm)", ylabel="y (mm)")
    add_colorbar(axes, shown, label, extend)


def no_ticks(axes: Axes) -> None:
    """Remove the ticks and tick labels of a picture."""
    axes.set(xticks=[], yticks=[])


def label_panel(axes: Axes, letter: str) -> None:
    """Draw the letter of a panel in the upper left corner of the panel, as in journals."""
    axes.text(
        0.02,
        0.97,
        f"({letter})",
        transform=axes.transAxes,
        va="top",
        fontsize=7.0,
        bbox={"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 1.2},
    )


def plain_log(axis: Axis) -> None:
    """Label the decades of a logarithmic axis with plain text instead of Matplotlib's formulas."""
    axis.set_major_formatter(LogFormatter())
    axis.set_minor_formatter(LogFormatter(labelOnlyBase=False))


def plain_spines(axes: Axes) -> None:
    """Remove the upper and the right border of a plot, and draw a light grid behind the curves."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(visible=True)
