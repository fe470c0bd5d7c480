"""Compute the press of an experiment's specimen, and the coated face with its texture."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError
from twin.config import require_experiment
from twin.config.instant import experiment_at
from twin.config.models import Experiment
from twin.mechanics import (
    ContactTransfer,
    PressedElastomer,
    contact_transfer,
    material_points,
    press_with,
    ridge_height_mm,
    ridge_transfer,
    textured,
)
from twin.mechanics.choice import select_model, unit_press, with_modulus
from twin.mechanics.models import PressInput, model_of
from twin.mechanics.relaxation import force_waiting_time_s, waiting_time_s
from twin.pipeline.memory import Memory

Progress = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class PressedFace:
    """Pressed elastomer, with a hash of its coated face that identifies the face in caches.

    The hash is of the heights and the nodes of the face. Faces with equal values have the same
    hash, whether they were computed or read from a file.
    """

    pressed: PressedElastomer
    face_digest: str

    @classmethod
    def of(cls, pressed: PressedElastomer) -> "PressedFace":
        """Return the pressed elastomer with the hash of its coated face."""
        name = hashlib.blake2b(digest_size=16)
        for values in (pressed.face_x_mm, pressed.face_y_mm, pressed.face_z_mm):
            name.update(repr(values.shape).encode() + values.tobytes())
        return cls(pressed, name.hexdigest())


def press(experiment: Experiment, memory: Memory, progress: Progress | None = None) -> PressedFace:
    """Press the specimen of an experiment; reuse results of stages that are in the cache.

    The shape of a slab pressed to a depth is equal for all moduli and is cached as one stage.
    Otherwise the whole press is one stage. A further stage adds the texture of the coat.

    A moving specimen is pressed as it is at time 0 of its motion.

    Parameters
    ----------
    progress : function that is called with the finished share, 0 to 1, of a thin sheet's load
        steps; None: no calls

    Raises
    ------
    InputError : the press is invalid, or its solver does not converge
    """
    experiment = experiment_at(experiment, 0.0)
    smooth, token = _smooth(experiment, memory, progress)
    made_from = token, smooth.pressed.young_modulus_kpa, smooth.pressed.initial_force_n
    return memory.recall(
        "texture", experiment, made_from, lambda watched: _with_texture(watched, smooth)
    ).value


def press_specimen(experiment: Experiment, progress: Progress | None = None) -> PressedElastomer:
    """Press the experiment's specimen; return the pressed elastomer with the texture of its coat.

    Parameters
    ----------
    progress : function that is called with the finished share, 0 to 1, of a thin sheet's load
        steps; None: no calls

    Raises
    ------
    InputError : `experiment` is no experiment, the press is invalid, or its solver does not
        converge
    """
    require_experiment(experiment)
    return press(experiment, Memory(), progress).pressed


def waiting_time(experiment: Experiment, change_um: float) -> float:
    """Return the time after the press, s, from which the coat changes by less than `change_um`.

    0 if the elastomer does not relax, or if its travel is prescribed.

    Raises
    ------
    InputError : `change_um` is not positive, or the press is invalid
    """
    require_experiment(experiment)
    if not change_um > 0:
        raise InputError(f"wait-um: found {change_um:g}, allowed more than 0")
    case = _case(experiment)
    return waiting_time_s(select_model(case), case, change_um)


def force_waiting_time(experiment: Experiment, change_percent: float) -> float:
    """Return the time after the press, s, from which the force changes by less than a share of it.

    0 if the elastomer does not relax, or if its force is prescribed.

    Raises
    ------
    InputError : `change_percent` is not positive, or the press is invalid
    """
    require_experiment(experiment)
    if not change_percent > 0:
        raise InputError(f"wait-percent: found {change_percent:g}, allowed more than 0")
    case = _case(experiment)
    return force_waiting_time_s(select_model(case), case, change_percent)


def _case(experiment: Experiment) -> PressInput:
    return PressInput(
        experiment.mechanics, experiment.specimen, experiment.elastomer, experiment.press
    )


def press_smooth(experiment: Experiment, progress: Progress | None = None) -> PressedElastomer:
    """Press with the mechanical model that the experiment names, without the coat's texture."""
    return press_with(
        experiment.mechanics, experiment.specimen, experiment.elastomer, experiment.press, progress
    )


def with_texture(experiment: Experiment, smooth: PressedElastomer) -> PressedElastomer:
    """Return a pressed elastomer with the texture of the experiment's coat, if it has one.

    Parameters
    ----------
    smooth : pressed elastomer without texture
    """
    texture = experiment.coating.texture
    if texture is None:
        return smooth
    return textured(smooth, experiment.elastomer, experiment.press, texture, experiment.seed)


def material_mm(experiment: Experiment, pressed: PressedElastomer) -> FloatArray | None:
    """Return the material coordinates of the face's vertices, (vertex, 2) mm, for dots and flakes.

    None for a coat without printed dots and without discrete flakes.
    """
    if experiment.photometric.markers is None and experiment.coating.facets() is None:
        return None
    X_mm, Y_mm = material_points(pressed, experiment.elastomer, experiment.press)
    return np.stack((X_mm.ravel(), Y_mm.ravel()), axis=-1)


def _smooth(
    experiment: Experiment, memory: Memory, progress: Progress | None
) -> tuple[PressedFace, int]:
    """Return the pressed face without texture, and the token of the stage that computed it."""
    shape = memory.recall("shape", experiment, (), _unit_press)
    if shape.value is None:
        own = memory.recall(
            "press", experiment, (), lambda watched: PressedFace.of(press_smooth(watched, progress))
        )
        return own.value, own.token
    scaled = with_modulus(_case(experiment), shape.value.pressed)
    return PressedFace(scaled, shape.value.face_digest), shape.token


def _unit_press(experiment: Experiment) -> PressedFace | None:
    pressed = unit_press(
        experiment.mechanics, experiment.specimen, experiment.elastomer, experiment.press
    )
    return None if pressed is None else PressedFace.of(pressed)


def _with_texture(experiment: Experiment, smooth: PressedFace) -> PressedFace:
    pressed = with_texture(experiment, smooth.pressed)
    return smooth if pressed is smooth.pressed else PressedFace.of(pressed)


def transfer_of(experiment: Experiment, pressed: PressedElastomer) -> ContactTransfer:
    """Return the contact transfer: share of a relief's amplitude that the coat shows, by pitch.

    It is computed for the kind of model by which `pressed` was computed: sheet or layer.

    Raises
    ------
    PressError : the elastomer is a thin sheet, and the back pressure is 0
    """
    if not model_of(pressed.model).wraps:
        return contact_transfer(experiment.elastomer)
    ridge_mm = ridge_height_mm(experiment.specimen)
    return ridge_transfer(experiment.elastomer, experiment.press.back_pressure_kpa, ridge_mm)
