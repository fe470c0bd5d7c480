"""Draw the experiments of a data set.

Each draw depends only on the seed of the recipe, the name of the drawn quantity and the number of
the sample. The number of samples, their order and other quantities do not change it. The scene of a
sample is drawn first, then its axes, then the deviations of its inputs.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.config import ConfigError, Experiment, vary
from twin.config.axis import Axis, Level
from twin.config.dataset import Recipe, RecipeScene
from twin.config.digest import keyed_sequence, with_file_contents
from twin.config.study import without_absent
from twin.dataset.methods import parts_of
from twin.study.cases import Case, case_of
from twin.study.measuring import Conditions
from twin.study.trials import draw, drawn_values

_POSE_AND_MATERIAL = {"x_mm", "y_mm", "z_mm", "yaw_deg", "tilt_deg", "material"}


@dataclass(frozen=True, eq=False)
class SampleDraw:
    """One drawn sample.

    Attributes
    ----------
    number : number of the sample, from 0
    scene : name of its scene
    settings : drawn values, by the title of each axis and the key of each input
    case : the measurement; None if the drawn values make no valid experiment
    reason : why there is no case; else empty
    object_digest : 16 hex digits of the specimen without pose and material; empty without case
    split : "train", "validation" or "test"; empty without case
    """

    number: int
    scene: str
    settings: Mapping[str, Any]
    case: Case | None
    reason: str = ""
    object_digest: str = ""
    split: str = ""

    @property
    def key(self) -> str:
        """Name of the sample in shards and predictions."""
        return key_of(self.number)


def key_of(number: int) -> str:
    """Return the name of a sample: its number in eight digits."""
    return f"{number:08d}"


def share_of(seed: int, quantity: str, number: int) -> float:
    """Return a number from 0 to below 1, drawn uniformly for one quantity of one sample."""
    return float(np.random.default_rng(keyed_sequence(seed, quantity, number)).random())


def draw_sample(recipe: Recipe, bases: Sequence[Experiment], number: int) -> SampleDraw:
    """Draw one sample of a recipe; it has no case, but a reason, if its experiment is not valid.

    Parameters
    ----------
    bases : base experiment of each scene of the recipe
    number : number of the sample, from 0
    """
    place = scene_of(recipe, number)
    scene, base = recipe.scene[place], bases[place]
    levels = levels_of(recipe, scene, number)
    settings = {title: level.label for title, level in levels.items()}
    changes: dict[str, Any] = {}
    for level in levels.values():
        changes |= without_absent(dict(level.changes))
    try:
        experiment = vary(base, changes)
        if recipe.inputs:
            settings |= drawn_values(experiment, recipe.inputs, recipe.seed, number + 1)
            experiment = draw(experiment, recipe.inputs, recipe.seed, number + 1)
        parts_of(recipe.sample, experiment)  # valid by every method
    except ConfigError as error:
        return SampleDraw(number, scene.name, settings, None, " ".join(str(error).split()))
    # The number of the trial selects the camera's noise: two samples have independent noise.
    case = _with_content(case_of(settings, experiment, Conditions(trial=number + 1)), recipe)
    name = object_digest(experiment)
    split = recipe.split.split_at(int(name, 16) / 16.0 ** len(name))
    return SampleDraw(number, scene.name, settings, case, "", name, split)


def _with_content(case: Case, recipe: Recipe) -> Case:
    """Return a case whose name in the store depends on the quantities of the sample, too."""
    named = f"{case.digest} {recipe.sample.model_dump_json()}"
    return replace(case, digest=hashlib.blake2b(named.encode(), digest_size=8).hexdigest())


def scene_of(recipe: Recipe, number: int) -> int:
    """Return the place of the scene of a sample, drawn with the weights of the scenes."""
    ends = np.cumsum([scene.weight for scene in recipe.scene])
    share = share_of(recipe.seed, "scene", number)
    return min(int(np.searchsorted(ends, share * ends[-1], side="right")), len(ends) - 1)


def levels_of(recipe: Recipe, scene: RecipeScene, number: int) -> dict[str, Level]:
    """Return the drawn level of each axis of a scene, by the title of the axis."""
    return {
        axis.title: _drawn_level(axis, share_of(recipe.seed, f"axis {axis.title}", number))
        for axis in recipe.axes_of(scene)
    }


def _drawn_level(axis: Axis, share: float) -> Level:
    """Return the level at a share (0 to below 1) of an axis; all whole numbers of a range count.

    Rounded values, as in a study, would be half as frequent at both ends of the range.
    """
    if not (axis.is_continuous and axis.integer):
        return axis.level_at(share)
    assert axis.low is not None  # the validator's
    assert axis.high is not None
    low, end = float(np.ceil(axis.low)), float(np.floor(axis.high)) + 1.0
    value = low * (end / low) ** share if axis.scale == "log" else low + (end - low) * share
    return axis.level_of(min(float(np.floor(value)), end - 1.0))


def object_digest(experiment: Experiment) -> str:
    """Return 16 hex digits computed from the form of the specimen, without pose and material.

    Samples with the same form, whatever their view, pose or press, have the same digest, and are in
    the same split. A file is included by its content.
    """
    form = experiment.specimen.model_dump(mode="json", exclude=_POSE_AND_MATERIAL)
    text = json.dumps(with_file_contents(form), sort_keys=True, separators=(",", ":"))
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()
