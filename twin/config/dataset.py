"""Recipe of a data set as data: scenes, distributions of their keys, content and splits.

Shipped recipes are in `scenes/datasets`; `docs/datasets.md` explains every key. The distributions
are those of a study: its axes, each drawn uniformly over its levels or its range, and its inputs.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from reconstruction.reading import is_regular
from twin.assets import scene_file
from twin.config.axis import Axis, with_files
from twin.config.base import Fraction, Model
from twin.config.bounds import Spread
from twin.config.inputs import Input, require_distinct_keys
from twin.config.loading import load_experiment, read_toml, resolve_uses, vary
from twin.config.methods import Method
from twin.config.models import Experiment
from twin.config.schema import validated
from twin.config.study import with_inputs, without_absent

Name = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_\-]*$", max_length=64)]


class RecipeScene(Model):
    """[[scene]]: one base experiment of a data set, with the axes that apply only to it."""

    name: Name
    base: str = Field(description="experiment file next to the recipe, or a shipped one")
    weight: Annotated[Spread, Field(gt=0)] = Field(
        default=1.0, description="share of the samples, relative to the other scenes"
    )
    set: dict[str, Any] = Field(default={}, description="tables that override those of `base`")
    axis: tuple[Axis, ...] = Field(
        default=(), description="[[scene.axis]]: drawn quantities of this scene"
    )


class SampleContent(Model):
    """[sample]: what every sample of a data set contains."""

    hold: Annotated[tuple[str, ...], Field(min_length=1)] = Field(
        description="names of quantities, see docs/datasets.md"
    )
    frames: Literal["npy", "png"] = Field(
        default="npy",
        description="frames as one array, or as one PNG file each (only format = 'webdataset')",
    )
    methods: tuple[Method, ...] = Field(
        default=(),
        exclude_if=lambda methods: not methods,
        description="methods that measure each object, with one press; names of arrays then begin "
        "with the method; default: the method of the scene",
    )


class SplitShares(Model):
    """[split]: shares of the objects, not of the samples, in each part of a data set."""

    train: Fraction = 0.8
    validation: Fraction = 0.1
    test: Fraction = 0.1

    @model_validator(mode="after")
    def _whole(self) -> "SplitShares":
        total = self.train + self.validation + self.test
        if abs(total - 1.0) > 1e-9:
            raise ValueError(f"train + validation + test: found {total:g}, allowed 1")
        return self

    def split_at(self, share: float) -> str:
        """Return the part that contains a number from 0 to below 1."""
        if share < self.train:
            return "train"
        return "validation" if share < self.train + self.validation else "test"


class Recipe(Model):
    """Complete description of a data set, without its number of samples."""

    schema_version: Literal[1] = 1
    name: Name
    description: str = ""
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    scene: Annotated[tuple[RecipeScene, ...], Field(min_length=1, max_length=64)]
    axis: tuple[Axis, ...] = Field(default=(), description="[[axis]]: drawn quantities of all")
    inputs_file: str = Field(
        default="", description="file of inputs, or a shipped one; [inputs] override it"
    )
    inputs: dict[str, Input] = Field(
        default={}, description="[inputs.NAME]: deviations from the nominal value that are drawn"
    )
    sample: SampleContent
    baseline: Literal["", "decoded", "spatial_unwrapping", "fourier"] = Field(
        default="",
        exclude_if=lambda name: not name,
        description="classical method that `twin score` compares predictions with; it needs its "
        "input in `hold`",
    )
    split: SplitShares = SplitShares()
    format: Literal["webdataset", "hdf5", "parquet"] = "webdataset"
    shard_mb: Annotated[float, Field(ge=0.01, le=4096)] = Field(
        default=256.0,
        description="size of a shard, 10^6 bytes; a shard has at least one sample. HDF5 and "
        "Parquet shards are built in memory",
    )

    @model_validator(mode="after")
    def _whole(self) -> "Recipe":
        names = [scene.name for scene in self.scene]
        if twice := _repeated(names):
            raise ValueError(f"scene: found the name {twice[0]} twice; rename one")
        for scene in self.scene:
            if twice := _repeated([axis.title for axis in self.axes_of(scene)]):
                raise ValueError(f"axis: found {twice[0]} twice in scene {scene.name}; rename one")
        if twice := _repeated(list(self.sample.hold)):
            raise ValueError(f"sample.hold: found {twice[0]} twice; remove one")
        if len(self.sample.methods) == 1 or _repeated(list(self.sample.methods)):
            raise ValueError(
                f"sample.methods: found {', '.join(self.sample.methods)}, allowed two or three "
                "different methods; for one method set modality in the scene"
            )
        if self.sample.frames == "png" and self.format != "webdataset":
            raise ValueError(
                f"sample.frames: found 'png', allowed 'npy' with format = '{self.format}'"
            )
        require_distinct_keys(self.inputs)
        return self

    def axes_of(self, scene: RecipeScene) -> tuple[Axis, ...]:
        """Return the axes that are drawn for a scene, in the order in which they are applied.

        The scene's own axes come first: the axes of all scenes may set keys of a specimen or
        material that one of them selects.
        """
        return (*scene.axis, *self.axis)


def _repeated(names: Sequence[str]) -> list[str]:
    return sorted({name for name in names if names.count(name) > 1})


def load_recipe(path: str | Path) -> tuple[Recipe, tuple[Experiment, ...]]:
    """Load a recipe and the base experiment of each of its scenes, in their order.

    Parameters
    ----------
    path : a TOML file, or the name of a shipped recipe ("datasets/tactile")

    Raises
    ------
    ConfigError : with one line per problem: key, found, allowed, remedy
    """
    file = scene_file(path)
    recipe = validated(Recipe, with_inputs(read_toml(file), str(path), file), f"{path}: ")
    scenes = tuple(_resolved(scene, file) for scene in recipe.scene)
    axes = tuple(with_files(axis, file) for axis in recipe.axis)
    resolved = recipe.model_copy(update={"scene": scenes, "axis": axes})
    return resolved, tuple(_base_of(scene, file) for scene in scenes)


def _resolved(scene: RecipeScene, file: Path) -> RecipeScene:
    """Return a scene with the content of all files that its tables name."""
    changes = without_absent(resolve_uses(scene.set, (file,)))
    axes = tuple(with_files(axis, file) for axis in scene.axis)
    return scene.model_copy(update={"set": changes, "axis": axes})


def _base_of(scene: RecipeScene, file: Path) -> Experiment:
    local = file.parent / scene.base
    base = load_experiment(local if is_regular(local) else scene.base)
    return vary(base, scene.set)
