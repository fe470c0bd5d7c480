"""What optical inputs do to radius and width: the whole chain on one press, without noise."""

from functools import partial
from typing import Any

from reconstruction.pipeline import reconstruct
from twin.config import Experiment, vary
from twin.mechanics import PressedElastomer
from twin.paper.face_model import Contribution, contributions
from twin.paper.repeats import evaluate
from twin.paper.scatter import Scatter
from twin.pipeline.fringes import options_of, record
from twin.pipeline.press import press_specimen
from twin.pipeline.progress import Stopwatch


def optical_contributions(
    experiment: Experiment, scatter: Scatter, output: str
) -> list[Contribution]:
    """Return what the optical inputs add to an output's uncertainty, largest first.

    Raises
    ------
    InputError, MissingBackend
        As `chain_figures`.
    """
    inputs = scatter.counting_for(experiment, optics=True)
    chain = partial(chain_figures, press_specimen(experiment))
    return contributions(experiment, inputs, output, chain)


def chain_figures(pressed: PressedElastomer, experiment: Experiment) -> dict[str, Any]:
    """Return the figures of a pressed face, seen by a camera without noise in the true rig.

    Raises
    ------
    InputError
        Something in the experiment cannot be rendered or fitted.
    MissingBackend
        No usable Dr.Jit backend.
    """
    silent = vary(experiment, {"camera.noise": False})
    recording = record(silent, pressed, Stopwatch(), 0)
    measured = reconstruct(recording.capture, options_of(silent.decode))
    return evaluate(silent, measured, recording)
