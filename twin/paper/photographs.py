"""The specimen alone on the stage in soft light, as one would photograph it."""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from twin.config import Experiment
from twin.optics.direct import STAGE, solids
from twin.optics.picture import Picture, picture
from twin.optics.view import SceneSurface, SceneView, point

_WIDTH_PX, _HEIGHT_PX, _SAMPLES = 360, 270, 20
_FROM = (0.5, -0.52, 0.69)
# Eyes so far away see nearly in parallel, as a macro lens does.
_DISTANCE, _ROOM = 7.0, 1.3


def photograph_of(experiment: Experiment) -> Picture:
    """Return the picture, (row, col, 3) uint8; the same specimen is rendered once per process.

    Raises
    ------
    InputError
        A part of the specimen has no material.
    MissingBackend
        No usable Dr.Jit backend.
    """
    return _render(_Sitter(experiment.model_dump_json(include={"specimen", "stage"}), experiment))


@dataclass(frozen=True)
class _Sitter:
    """What is photographed, told apart by specimen and stage alone."""

    key: str
    experiment: Experiment = field(compare=False)


@lru_cache(maxsize=32)
def _render(sitter: _Sitter) -> Picture:
    things = [
        SceneSurface.of_mesh(solid.name, solid.mesh, bsdf=solid.bsdf, smooth=True)
        for solid in solids(sitter.experiment)
    ]
    shown = np.concatenate([thing.vertices_mm for thing in things if thing.name != STAGE])
    low, high = shown.min(axis=0), shown.max(axis=0)
    middle = (low + high) / 2
    width_mm = _ROOM * float(np.hypot(*(high - low)[:2]))
    eye = middle + _DISTANCE * width_mm * np.array(_FROM)
    view = SceneView(point(eye), point(middle), width_mm, _WIDTH_PX, _HEIGHT_PX)
    return picture(things, view, _SAMPLES, gray=True)
