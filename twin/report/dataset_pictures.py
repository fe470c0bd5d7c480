"""Pictures of a data card: samples, and histograms of the drawn values."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from reconstruction.evaluate.samples import npy
from twin.dataset.make import DRAWN, PackedDataSet
from twin.dataset.quantities import quantity_of
from twin.dataset.shards import PackedSample
from twin.report.canvas import (
    MEASURED,
    axes_at,
    drawing,
    no_ticks,
    plain_log,
    plain_spines,
    sequential,
)
from twin.results.rows import is_number

MOST_PICTURES = 24
_ACROSS, _CELL_IN, _ROOM_IN, _GAP_IN = 6, 1.5, 0.3, 0.05
_MOST_BINS, _PANEL_IN, _PANELS_ACROSS, _MOST_BARS = 30, 2.1, 4, 12
_LEAST_LOG_RANGE = 3.0  # ratio of the ends of a logarithmic axis: its labels would overlap below
_PICTURED = ("frames", "radiance", "image", "white")
_MAPS = ("depth_mm", "phase_column_rad", "phase_row_rad", "pressure_kpa")


def label_of(value: Any) -> str:
    """Return a drawn value as text; of a path the name of the file."""
    return Path(value).name if isinstance(value, str) and "/" in value else str(value)


def draw_samples(path: Path, samples: Sequence[PackedSample]) -> None:
    """Draw up to 24 samples, evenly spaced over all: first image above its map.

    The map is the first of depth, phase and pressure that the samples contain. Its scale is that of
    the single sample.

    Raises
    ------
    InputError : the file cannot be written
    """
    shown = [samples[i] for i in evenly_spaced(len(samples), MOST_PICTURES)]
    rows = -(-len(shown) // _ACROSS)
    cell_in = _CELL_IN * max(map(_height_over_width, shown))
    height_in = rows * (2 * cell_in + _ROOM_IN + _GAP_IN) + 0.1
    width_in = min(len(shown), _ACROSS) * (_CELL_IN + 0.1) + 0.1
    with drawing(path, width_in, height_in) as figure:
        for number, sample in enumerate(shown):
            row, col = divmod(number, _ACROSS)
            left_in = 0.1 + col * (_CELL_IN + 0.1)
            top_in = row * (2 * cell_in + _ROOM_IN + _GAP_IN) + _ROOM_IN
            above = axes_at(figure, left_in, top_in, _CELL_IN, cell_in)
            below = axes_at(figure, left_in, top_in + cell_in + _GAP_IN, _CELL_IN, cell_in)
            above.set_title(f"{sample.key} {sample.described['scene']}", fontsize=6.5, pad=2.0)
            _show_image(above, sample)
            _show_map(below, sample)


def pictured(samples: Sequence[PackedSample]) -> str:
    """Return the sentence that explains the picture of the samples."""
    sample = samples[0]
    image, shown = _file_of(sample, _PICTURED), _file_of(sample, _MAPS)
    image = image or _file_of(sample, ("frames",), ".000.png")
    above = f"Above: `{_stem(image)}`, the first image. " if image is not None else ""
    if shown is None:
        return f"{above}Each sample has its own scale."
    high = ", negative: points near the camera are bright" if _is_depth(shown) else ""
    below = f"`{_stem(shown)}`{high}. Each sample has its own scale."
    return f"{above}Below: {below}" if above else f"Shown: {below}"


def _stem(path: Path) -> str:
    return path.name.partition(".")[0]


def _is_depth(path: Path) -> bool:
    return path.stem.endswith("depth_mm")


def _height_over_width(sample: PackedSample) -> float:
    """Return the ratio of the sides of the images of a sample."""
    image = _image_of(sample)
    values = _map_of(sample) if image is None else image
    return 1.0 if values is None else values.shape[0] / values.shape[1]


def evenly_spaced(count: int, most: int) -> list[int]:
    """Return at most `most` of the numbers below `count`, evenly spaced, the first included."""
    taken = min(count, most)
    return [number * count // taken for number in range(taken)]


def _show_image(axes: Axes, sample: PackedSample) -> None:
    no_ticks(axes)
    image = _image_of(sample)
    if image is None:
        axes.set_axis_off()
        return
    if image.ndim == 3:
        axes.imshow(image)
    else:
        axes.imshow(image, cmap="gray", vmin=0, vmax=max(float(np.percentile(image, 99.5)), 1e-12))


def _image_of(sample: PackedSample) -> NDArray[Any] | None:
    """Return the first frame, colour image or white image of a sample; None if it has none."""
    first_frame = _file_of(sample, ("frames",), ".000.png")
    if first_frame is not None:
        from reconstruction.reading import read_pixels

        return read_pixels(first_frame)
    path = _file_of(sample, _PICTURED)
    if path is None:
        return None
    values: NDArray[Any] = npy(path.read_bytes())
    quantity = quantity_of(path.stem)
    return values[0] if quantity is not None and quantity.axes[0] == "frame" else values


def _file_of(sample: PackedSample, names: Sequence[str], ending: str = ".npy") -> Path | None:
    """Return the file of the first quantity that a sample has, by its first method that has it."""
    for name in names:
        for prefix in ("", *(f"{method}_" for method in sample.described.get("methods", ()))):
            if (path := sample.files.get(f"{prefix}{name}{ending}")) is not None:
                return path
    return None


def _show_map(axes: Axes, sample: PackedSample) -> None:
    no_ticks(axes)
    values = _map_of(sample)
    if values is None:
        axes.set_axis_off()
    else:
        axes.imshow(np.ma.masked_array(values, values == 0), cmap=sequential())


def _map_of(sample: PackedSample) -> NDArray[Any] | None:
    """Return the map that is drawn of a sample; None if it has none."""
    path = _file_of(sample, _MAPS)
    if path is None:
        return None
    values: NDArray[Any] = npy(path.read_bytes())
    # Depth increases away from the camera: drawn negative, so that high points are bright.
    return -values if _is_depth(path) else values


def drawn_columns(packed: PackedDataSet) -> dict[str, list[Any]]:
    """Return the drawn values of every axis and input over all samples that have it, and scenes."""
    names = dict.fromkeys(name for row in packed.rows for name in row if name.startswith(DRAWN))
    columns: dict[str, list[Any]] = {}
    if len(packed.recipe.scene) > 1:
        columns["scene"] = [row["scene"] for row in packed.rows]
    for name in names:
        values = [row[name] for row in packed.rows if row.get(name) is not None]
        columns[name.removeprefix(DRAWN)] = values
    return columns


def logarithmic(packed: PackedDataSet) -> frozenset[str]:
    """Return the titles of the axes that are drawn on a logarithmic scale."""
    recipe = packed.recipe
    axes = (axis for scene in recipe.scene for axis in recipe.axes_of(scene))
    return frozenset(axis.title for axis in axes if axis.scale == "log")


def draw_distributions(
    path: Path, columns: Mapping[str, Sequence[Any]], log: Collection[str] = ()
) -> None:
    """Draw a histogram of each drawn quantity, and the counts of names and other values.

    Parameters
    ----------
    columns : drawn values by quantity
    log : quantities whose histogram has a logarithmic axis

    Raises
    ------
    InputError : the file cannot be written
    """
    across = min(len(columns), _PANELS_ACROSS)
    rows = -(-len(columns) // _PANELS_ACROSS)
    step_across, step_down = _PANEL_IN + 0.6, 0.8 * _PANEL_IN + 1.0
    with drawing(path, across * step_across + 0.2, rows * step_down) as figure:
        for number, (name, values) in enumerate(columns.items()):
            row, col = divmod(number, _PANELS_ACROSS)
            place = (col * step_across + 0.5, row * step_down + 0.3)
            axes = axes_at(figure, *place, _PANEL_IN, 0.8 * _PANEL_IN)
            _show_distribution(axes, values, log=name in log)
            axes.set_title(name, fontsize=8.0)
            if col == 0:
                axes.set_ylabel("samples")
            plain_spines(axes)


def _show_distribution(axes: Axes, values: Sequence[Any], *, log: bool) -> None:
    """Draw a histogram of numbers; of names, or of few numbers that repeat, the counts."""
    levels = Counter(map(label_of, values))
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    if all(map(is_number, values)) and (len(levels) > _MOST_BARS or 2 * len(levels) > len(values)):
        numbers = np.array(values, np.float64)
        low, high = float(numbers.min()), float(numbers.max())
        bins = min(_MOST_BINS, 2 + int(np.sqrt(len(numbers))))
        if log and 0 < _LEAST_LOG_RANGE * low < high:
            axes.set_xscale("log")
            plain_log(axes.xaxis)
            edges = np.geomspace(low, high, bins + 1)
        else:
            edges = np.histogram_bin_edges(numbers, bins)
        axes.hist(numbers, bins=edges.tolist(), color=MEASURED)
        return
    shown = levels.most_common(_MOST_BARS)
    if all(map(is_number, values)):
        shown.sort(key=lambda level: float(level[0]))
    axes.bar(range(len(shown)), [count for _, count in shown], color=MEASURED)
    axes.set_xticks(range(len(shown)), [label[:12] for label, _ in shown], rotation=30, ha="right")
