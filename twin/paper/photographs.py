"""Rendered photographs of the specimen on the stage, without sheet, in soft light."""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from twin.config import Experiment
from twin.optics.direct import STAGE, solids
from twin.optics.picture import Picture, picture
from twin.optics.view import SceneSurface, SceneView, point

_WIDTH_PX, _HEIGHT_PX, _SAMPLES = 360, 270, 20
_FROM = (0.5, -0.52, 0.69)
# The large distance makes the perspective nearly parallel, as with a macro lens.
_DISTANCE, _ROOM = 7.0, 1.3


def photograph_of(experiment: Experiment) -> Picture:
    """Return a rendered picture of the bare specimen on its stage, (row, col, 3) uint8.

    Each combination of specimen and stage is rendered once per process.

    Raises
    ------
    InputError
        A part of the specimen has no material.
    MissingBackend
        No usable Dr.Jit backend.
    """
    return _render(_Subject(experiment.model_dump_json(include={"specimen", "stage"}), experiment))


@dataclass(frozen=True)
class _Subject:
    """Subject of a photograph, for the cache; two subjects are equal if specimen and stage are."""

    key: str
    experiment: Experiment = field(compare=False)


@lru_cache(maxsize=32)
def _render(subject: _Subject) -> Picture:
    things = [
        SceneSurface.of_mesh(solid.name, solid.mesh, bsdf=solid.bsdf, smooth=True)
        for solid in solids(subject.experiment)
    ]
    shown = np.concatenate([thing.vertices_mm for thing in things if thing.name != STAGE])
    low, high = shown.min(axis=0), shown.max(axis=0)
    middle = (low + high) / 2
    width_mm = _ROOM * float(np.hypot(*(high - low)[:2]))
    eye = middle + _DISTANCE * width_mm * np.array(_FROM)
    view = SceneView(point(eye), point(middle), width_mm, _WIDTH_PX, _HEIGHT_PX)
    return picture(things, view, _SAMPLES, gray=True)
