"""Press the experiment's specimen: from the shape of the slab to the coated face as it is seen."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

from twin.config import require_experiment
from twin.config.models import Experiment
from twin.mechanics import (
    ContactTransfer,
    PressedElastomer,
    contact_transfer,
    press_with,
    ridge_height_mm,
    ridge_transfer,
    textured,
)
from twin.mechanics.choice import unit_press, with_modulus
from twin.mechanics.models import model_of
from twin.pipeline.memory import Memory

Progress = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class PressedFace:
    """A press, and a digest of the heights and the nodes of its coated face.

    Faces with equal values have the same digest, whether they were computed or read from a file.
    """

    pressed: PressedElastomer
    face_digest: str

    @classmethod
    def of(cls, pressed: PressedElastomer) -> "PressedFace":
        """Compute the digest of the coated face from its heights and their nodes."""
        name = hashlib.blake2b(digest_size=16)
        for values in (pressed.face_x_mm, pressed.face_y_mm, pressed.face_z_mm):
            name.update(repr(values.shape).encode() + values.tobytes())
        return cls(pressed, name.hexdigest())


def press(experiment: Experiment, memory: Memory, progress: Progress | None = None) -> PressedFace:
    """Press by stages: the slab's shape for all moduli, or the whole press; then its texture.

    Parameters
    ----------
    progress : called with the finished share of a thin sheet's load steps

    Raises
    ------
    InputError : the press is invalid, or its solver does not converge
    """
    smooth, token = _smooth(experiment, memory, progress)
    made_from = token, smooth.pressed.young_modulus_kpa
    return memory.recall(
        "texture", experiment, made_from, lambda watched: _with_texture(watched, smooth)
    ).value


def press_specimen(experiment: Experiment, progress: Progress | None = None) -> PressedElastomer:
    """Press the experiment's specimen into its elastomer: the coated face as it is seen.

    Raises
    ------
    InputError : no experiment, or as `press`
    """
    require_experiment(experiment)
    return press(experiment, Memory(), progress).pressed


def press_smooth(experiment: Experiment, progress: Progress | None = None) -> PressedElastomer:
    """Press with the model that the experiment requests; the coat's texture is left out."""
    return press_with(
        experiment.mechanics, experiment.specimen, experiment.elastomer, experiment.press, progress
    )


def with_texture(experiment: Experiment, smooth: PressedElastomer) -> PressedElastomer:
    """Lay the experiment's texture, if its coat has one, on a smooth pressed face."""
    texture = experiment.coating.texture
    if texture is None:
        return smooth
    return textured(smooth, experiment.elastomer, experiment.press, texture, experiment.seed)


def _smooth(
    experiment: Experiment, memory: Memory, progress: Progress | None
) -> tuple[PressedFace, int]:
    """Return the press without texture, and the token of its inputs."""
    shape = memory.recall("shape", experiment, (), _unit_press)
    if shape.value is None:
        own = memory.recall(
            "press", experiment, (), lambda watched: PressedFace.of(press_smooth(watched, progress))
        )
        return own.value, own.token
    scaled = with_modulus(shape.value.pressed, experiment.elastomer)
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
    """Return the coat's transfer of grooves of each pitch, by the kind of model that pressed.

    Raises
    ------
    PressError : a thin sheet without back pressure
    """
    if not model_of(pressed.model).wraps:
        return contact_transfer(experiment.elastomer)
    ridge_mm = ridge_height_mm(experiment.specimen)
    return ridge_transfer(experiment.elastomer, experiment.press.back_pressure_kpa, ridge_mm)
