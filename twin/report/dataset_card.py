"""Data card of a data set: README.md with its content, pictures of samples and distributions."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from reconstruction.evaluate.samples import SPLITS, npy
from reconstruction.writing import write_text
from twin.config.methods import TRAITS
from twin.dataset.make import DRAWN, PackedDataSet
from twin.dataset.quantities import quantity_of
from twin.dataset.shards import ENDINGS, PackedSample
from twin.output import versions
from twin.report.canvas import (
    MEASURED,
    axes_at,
    drawing,
    no_ticks,
    plain_spines,
    sequential,
)
from twin.results.rows import is_number

README, SAMPLES_PNG, DRAWN_PNG = "README.md", "samples.png", "distributions.png"
MOST_PICTURES = 24
_ACROSS, _CELL_IN, _ROOM_IN, _GAP_IN = 6, 1.5, 0.3, 0.05
_MOST_BINS, _PANEL_IN, _PANELS_ACROSS, _MOST_BARS = 30, 2.1, 4, 12
_LOG_RANGE = 20.0  # ratio of largest to smallest value above which bins are logarithmic
_PICTURED = ("frames", "radiance", "image", "white")
_MAPS = ("depth_mm", "phase_column_rad", "phase_row_rad", "pressure_kpa")


def write_card(folder: Path, packed: PackedDataSet) -> None:
    """Write README.md, samples.png and distributions.png of a data set into its folder.

    Raises
    ------
    InputError : a file cannot be written
    """
    draw_samples(folder / SAMPLES_PNG, packed.samples)
    columns = drawn_columns(packed)
    if columns:
        draw_distributions(folder / DRAWN_PNG, columns)
    write_text(folder / README, card_text(folder, packed))


# ---- text --------------------------------------------------------------------------------------


def card_text(folder: Path, packed: PackedDataSet) -> str:
    """Return the text of the card, Markdown with the header of Hugging Face's data sets."""
    recipe = packed.recipe
    return "\n".join(
        [
            *_header(packed),
            f"# {recipe.name}",
            "",
            *([recipe.description, ""] if recipe.description else []),
            f"{len(packed.samples)} simulated samples of {len(packed.draws)} drawn, "
            f"{_size_of(folder)}, format {recipe.format}. Made by fringe-twin; the recipe is "
            "`recipe.toml`, one row per drawn sample is in `index.parquet`.",
            "",
            f"![samples]({SAMPLES_PNG})",
            "",
            "## Splits",
            "",
            "By object: all samples of one form are in one split, for any pose, view or press.",
            "",
            *_splits(packed),
            "",
            "## Content of a sample",
            "",
            "No value is NaN; a quantity is 0 where it does not exist. Lengths in mm; world frame: "
            "z up towards the devices.",
            "",
            *_methods(packed),
            *_contents(packed),
            "",
            "## Distributions",
            "",
            *([f"![drawn values]({DRAWN_PNG})", ""] if (folder / DRAWN_PNG).is_file() else []),
            *_distributions(packed),
            "",
            "## Samples without a result",
            "",
            *_failures(packed),
            "",
            "## Versions",
            "",
            *(f"- {name} {version}" for name, version in sorted(versions().items())),
            "",
        ]
    )


def _header(packed: PackedDataSet) -> list[str]:
    """Return the YAML header with the files of each split that has samples."""
    there = {sample.split for sample in packed.samples}
    lines = ["---", "configs:", "- config_name: default", "  data_files:"]
    for split in SPLITS:
        if split in there:
            ending = ENDINGS[packed.recipe.format]
            lines += [f"  - split: {split}", f"    path: {split}-*.{ending}"]
    return [*lines, "---", ""]


def _size_of(folder: Path) -> str:
    size = sum(path.stat().st_size for path in folder.iterdir())
    return f"{size / 1e9:.3g} GB" if size >= 1e9 else f"{size / 1e6:.3g} MB"


def _splits(packed: PackedDataSet) -> list[str]:
    rows = []
    for split in SPLITS:
        inside = [sample for sample in packed.samples if sample.split == split]
        objects = {sample.described["object"] for sample in inside}
        share = getattr(packed.recipe.split, split)
        rows.append((split, f"{share:g}", str(len(objects)), str(len(inside))))
    return _table(("split", "share of the objects", "objects", "samples"), rows)


def _methods(packed: PackedDataSet) -> list[str]:
    """Return the sentence on the methods of a sample; nothing if there is one."""
    methods = packed.recipe.sample.methods
    if not methods:
        return []
    titles = ", ".join(f"{TRAITS[method].title} (`{method}_...`)" for method in methods)
    return [f"Each sample has several methods on one press: {titles}.", ""]


def _contents(packed: PackedDataSet) -> list[str]:
    rows = []
    for name, entry in packed.schema["files"].items():
        axes = ", ".join(entry.get("axes", ()))
        kind = entry.get("dtype", "text" if "type" in entry else "PNG")
        rows.append((f"`{name}`", kind, axes, entry.get("unit", ""), entry["meaning"]))
    return _table(("file", "type", "axes", "unit", "meaning"), rows)


def _distributions(packed: PackedDataSet) -> list[str]:
    """Return a table of the scenes, axes and inputs of the recipe."""
    recipe = packed.recipe
    total = sum(scene.weight for scene in recipe.scene)
    rows = []
    for scene in recipe.scene:
        share = f"`{scene.base}`, {scene.weight / total:.0%} of the samples"
        rows.append((scene.name, "scene", share))
        for axis in recipe.axes_of(scene):
            rows.append((scene.name, axis.title, _in_words(axis)))
    for name, given in recipe.inputs.items():
        spread = "" if given.spread is None else f", spread {given.spread:g}"
        kind = f"{given.distribution} about the nominal value{spread}"
        rows.append(("all", f"{name}: `{given.key}`", kind))
    return _table(("scene", "quantity", "distribution"), rows)


def _in_words(axis: Any) -> str:
    if axis.is_continuous:
        whole = ", whole numbers" if axis.integer else ""
        scale = "log-uniform" if axis.scale == "log" else "uniform"
        return f"{scale} from {axis.low:g} to {axis.high:g}{whole}"
    labels = [_label(level.label) for level in axis.levels()]
    more = f" and {len(labels) - 6} more" if len(labels) > 6 else ""
    return f"{', '.join(labels[:6])}{more}, equally probable"


def _label(value: Any) -> str:
    return Path(value).name if isinstance(value, str) and "/" in value else str(value)


def _failures(packed: PackedDataSet) -> list[str]:
    rows = [(str(count), reason) for reason, count in packed.failures.items()]
    return _table(("samples", "reason"), rows) if rows else ["All drawn samples have a result."]


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    def line(cells: Sequence[str]) -> str:
        return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"

    return [line(headings), line(["---"] * len(headings)), *map(line, rows)]


# ---- pictures ----------------------------------------------------------------------------------


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
    return -values if path.stem.endswith("depth_mm") else values


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


def draw_distributions(path: Path, columns: Mapping[str, Sequence[Any]]) -> None:
    """Draw a histogram of each drawn quantity, and the counts of names and other values.

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
            _show_distribution(axes, values)
            axes.set_title(name, fontsize=8.0)
            if col == 0:
                axes.set_ylabel("samples")
            plain_spines(axes)


def _show_distribution(axes: Axes, values: Sequence[Any]) -> None:
    """Draw a histogram of numbers; of names, or of few numbers that repeat, the counts."""
    levels = Counter(map(_label, values))
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    if all(map(is_number, values)) and (len(levels) > _MOST_BARS or 2 * len(levels) > len(values)):
        numbers = np.array(values, np.float64)
        low, high = float(numbers.min()), float(numbers.max())
        bins = min(_MOST_BINS, 2 + int(np.sqrt(len(numbers))))
        if low > 0 and high > _LOG_RANGE * low:
            axes.set_xscale("log")
            edges = np.geomspace(low, high, bins + 1)
        else:
            edges = np.histogram_bin_edges(numbers, bins)
        axes.hist(numbers, bins=edges.tolist(), color=MEASURED)
        return
    shown = levels.most_common(_MOST_BARS)
    axes.bar(range(len(shown)), [count for _, count in shown], color=MEASURED)
    axes.set_xticks(range(len(shown)), [label[:12] for label, _ in shown], rotation=30, ha="right")
