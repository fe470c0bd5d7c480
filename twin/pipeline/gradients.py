"""Compute the bounds of an experiment's measurands, and their derivatives by design fields."""

from collections.abc import Sequence

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError
from twin.config import Experiment
from twin.optics.session import renderer_session
from twin.pipeline.bound import bounds_alone, predicted
from twin.pipeline.lit_frames import loaded, traced, viewed
from twin.pipeline.memory import Memory
from twin.pipeline.press import press
from twin.results.bound import information_shares
from twin.results.derivatives import (
    OF_THE_NUMBERS,
    Moved,
    differentiated,
    log_sigma_tangent,
)
from twin.results.figures import Metric

_SMALL_SHARE = 1e-4


def value_at(experiment: Experiment, path: str) -> float:
    """Return the number at a dotted path of an experiment, such as `camera.f_number`.

    Raises
    ------
    InputError : there is no number at this path
    """
    node: object = experiment
    for name in path.split("."):
        node = getattr(node, name, None)
    if not isinstance(node, (int, float)) or isinstance(node, bool):
        raise InputError(f"{path}: found {node!r}, allowed a number, to be differentiated by")
    return float(node)


def bound_gradient(
    experiment: Experiment, paths: Sequence[str], memory: Memory
) -> tuple[dict[str, Metric], dict[str, FloatArray]]:
    """Return the figures of `bounds_alone`, and the derivatives of each bound by fields.

    Parameters
    ----------
    paths : dotted paths of the fields, from those that `differentiated` returns

    Returns
    -------
    the figures by name; and the derivatives (path,) of each bound by name, um per unit of the field

    Raises
    ------
    InputError : a path is not one of `differentiated`, for example because it changes the press;
        the rig has layers; or for the reasons of `bounds_alone`
    MissingBackend : there is no usable Dr.Jit backend
    """
    allowed = differentiated(experiment)
    for path in paths:
        if path not in allowed:
            raise InputError(f"{path}: found no derivative by it; allowed are {', '.join(allowed)}")
    pressed, figures = bounds_alone(experiment, memory)
    face = press(experiment, memory)
    prediction, truth = predicted(experiment, face, memory)
    shares = information_shares(experiment, prediction, truth, pressed)
    tangents = [_log_sigma(experiment, path, memory) for path in paths]
    gradients: dict[str, FloatArray] = {}
    for name, share in shares.items():
        bound = figures[name]
        assert isinstance(bound, float)
        gradients[name] = np.array([bound * float(np.sum(share * tangent)) for tangent in tangents])
    return figures, gradients


@renderer_session()
def _log_sigma(experiment: Experiment, path: str, memory: Memory) -> FloatArray:
    """Return the derivative of ln(sigma) of each pixel's point by one field, (row, col)."""
    face = press(experiment, memory)
    geometry = loaded(experiment, face, memory)
    view = viewed(experiment, geometry, memory)
    rays = traced(experiment, geometry, view, memory)
    from twin.optics.gradients import trace_tangent
    from twin.pipeline.trace import dress, maps_of_patches

    value = value_at(experiment, path)
    step = _SMALL_SHARE * max(abs(value), 1e-2)

    def moved(by: float) -> Experiment:
        return with_number(experiment, path, value + by)

    maps = None
    if path not in OF_THE_NUMBERS:
        dress(experiment, geometry.value)
        scene = geometry.value.scene
        maps = trace_tangent(scene, view.value.rig, experiment, moved, step=step).maps
    along = Moved(moved, step, maps)
    prediction, truth = predicted(experiment, face, memory)
    traced_maps = maps_of_patches(rays.value, view.value)
    return log_sigma_tangent(experiment, traced_maps, truth, prediction, along)


def with_number(experiment: Experiment, path: str, value: float) -> Experiment:
    """Return the experiment with the number at a dotted path changed.

    The number is not validated, because a step of a numerical derivative may leave its range.
    """
    *tables, last = path.split(".")
    nodes = [experiment]
    for name in tables:
        nodes.append(getattr(nodes[-1], name))
    changed = nodes.pop().model_copy(update={last: value})
    for node, name in zip(reversed(nodes), reversed(tables), strict=True):
        changed = node.model_copy(update={name: changed})
    return changed
