"""Data card of a data set: README.md with its content, pictures of samples and distributions."""

from collections.abc import Sequence
from pathlib import Path

from reconstruction.arrays import PhotometricReason, Reason
from reconstruction.evaluate.samples import SPLITS
from reconstruction.writing import write_text
from twin.config.axis import Axis
from twin.config.inputs import Input
from twin.config.methods import TRAITS
from twin.dataset.make import PackedDataSet
from twin.dataset.shards import ENDINGS
from twin.output import versions
from twin.report.dataset_pictures import (
    draw_distributions,
    draw_samples,
    drawn_columns,
    label_of,
    logarithmic,
    pictured,
)

README, SAMPLES_PNG, DRAWN_PNG = "README.md", "samples.png", "distributions.png"


def write_card(folder: Path, packed: PackedDataSet) -> None:
    """Write README.md, samples.png and distributions.png of a data set into its folder.

    Raises
    ------
    InputError : a file cannot be written
    """
    draw_samples(folder / SAMPLES_PNG, packed.samples)
    columns = drawn_columns(packed)
    if columns:
        draw_distributions(folder / DRAWN_PNG, columns, logarithmic(packed))
    write_text(folder / README, card_text(folder, packed))


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
            pictured(packed.samples),
            "",
            "## How to read it",
            "",
            *_reading(packed),
            "",
            "## Splits",
            "",
            "By object: all samples of one form are in one split, for any pose, view or press. If "
            "objects are few, the shares of the samples differ from those of the recipe.",
            "",
            *_splits(packed),
            "",
            "## Content of a sample",
            "",
            "No value is NaN; a quantity is 0 where it does not exist. Lengths in mm; world frame: "
            "z up towards the devices; camera frame: x right, y down, z forward. Unit 1: a number "
            "without unit. Masked pixels have no decoded result.",
            "",
            *_methods(packed),
            *_contents(packed),
            *_reasons(packed),
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


def _reasons(packed: PackedDataSet) -> list[str]:
    """Return a line with the codes of masked pixels for each kind of method; no line if unused."""
    if "decoded_reason" not in packed.recipe.sample.hold:
        return []
    methods = packed.recipe.sample.methods or [base.modality for base in packed.bases]
    fringes = {TRAITS[method].fringes for method in methods}
    kinds = {True: ("fringes", Reason), False: ("photometric stereo", PhotometricReason)}
    lines = []
    for kind in sorted(fringes, reverse=True):
        name, reasons = kinds[kind]
        codes = ", ".join(f"{reason.value} {reason.name}" for reason in reasons)
        lines += ["", f"Codes of `decoded_reason`, {name}: {codes}."]
    return lines


def _reading(packed: PackedDataSet) -> list[str]:
    """Return how one array is read, in the format of the data set, and how scores are computed."""
    kind, sample = packed.recipe.format, packed.samples[0]
    shard = next(str(row["shard"]) for row in packed.rows if row["key"] == sample.key)
    names = [name for name in sorted(sample.files) if name.endswith(".npy")]
    names.sort(key=lambda name: ("decoded" in name, "depth" not in name))
    name = next(iter(names), "")
    stem = name.removesuffix(".npy")
    lines = {
        "webdataset": [
            "import webdataset",
            f'for sample in webdataset.WebDataset("{shard}", shardshuffle=False).decode():',
            f'    array = sample["{name}"]',
        ],
        "hdf5": ["import h5py", f'array = h5py.File("{shard}")["{sample.key}/{stem}"][()]'],
        "parquet": [
            "import datasets",
            f'loaded = datasets.load_dataset(".", split="{sample.split}").with_format("numpy")',
            f'array = loaded[0]["{stem}"]',
        ],
    }
    shown = ["```python", *lines[kind], "```", ""] if name else []
    baseline = packed.recipe.baseline
    also = f", and those of the classical method `{baseline}`" if baseline else ""
    score = "`twin score PREDICTIONS DATASET` compares files `KEY.QUANTITY.npy` with the truth"
    return [*shown, f"{score}{also}."]


def _distributions(packed: PackedDataSet) -> list[str]:
    """Return a table of the scenes, axes and inputs of the recipe."""
    recipe = packed.recipe
    total = sum(scene.weight for scene in recipe.scene)
    rows = []
    for scene in recipe.scene:
        share = f"`{scene.base}`, {scene.weight / total:.0%} of the samples"
        rows.append((scene.name, "scene", share))
        for axis in recipe.axes_of(scene):
            rows.append((scene.name, axis.title, distribution_of_axis(axis)))
    for name, given in recipe.inputs.items():
        rows.append(("all", f"{name}: `{given.key}`", distribution_of_input(given)))
    return _table(("scene", "quantity", "distribution"), rows)


def distribution_of_axis(axis: Axis) -> str:
    """Return the distribution of an axis in words."""
    if axis.is_continuous:
        whole = "whole numbers, " if axis.integer else ""
        scale = "log-uniform" if axis.scale == "log" else "uniform"
        return f"{whole}{scale} from {_number(axis.low)} to {_number(axis.high)}"
    labels = [label_of(level.label) for level in axis.levels()]
    more = f" and {len(labels) - 6} more" if len(labels) > 6 else ""
    return f"{', '.join(labels[:6])}{more}, equally probable"


def distribution_of_input(given: Input) -> str:
    """Return the distribution of an input in words."""
    if given.distribution == "choice":
        values = ", ".join(map(_number, given.values))
        weights = ", ".join(map(_number, given.weights))
        return f"{values}, " + (f"with weights {weights}" if weights else "equally probable")
    spread = given.spread or 0.0
    size = f"{100 * spread:g} % of the nominal value" if given.relative else _number(spread)
    measure = {"normal": "standard deviation", "student_t": "scale"}
    words = f"{given.distribution.replace('_', ' ')} about the nominal value of the scene, "
    words += f"{measure.get(given.distribution, 'half width')} {size}"
    if given.degrees_of_freedom is not None:
        words += f", {given.degrees_of_freedom:g} degrees of freedom"
    limits = [("at least", given.at_least), ("at most", given.at_most)]
    cut = [f"{name} {_number(value)}" for name, value in limits if value is not None]
    return f"{words}, cut off: {', '.join(cut)}" if cut else words


def _number(value: float | None) -> str:
    """Return a number as text; whole numbers with all digits."""
    assert value is not None  # of a range, which has both ends
    return str(int(value)) if float(value).is_integer() else f"{value:g}"


def _failures(packed: PackedDataSet) -> list[str]:
    rows = [(str(count), reason) for reason, count in packed.failures.items()]
    return _table(("samples", "reason"), rows) if rows else ["All drawn samples have a result."]


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    def line(cells: Sequence[str]) -> str:
        return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"

    return [line(headings), line(["---"] * len(headings)), *map(line, rows)]
