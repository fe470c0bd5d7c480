"""Direct FPP: fringes on the bare specimen, as conventional fringe projection sees it."""

from twin.config.models import Experiment
from twin.modalities.progress import Stopwatch
from twin.modalities.recording import Recording, expose_capture
from twin.optics.direct import render_direct


def record_direct(
    experiment: Experiment, clock: Stopwatch | None = None, trial: int = 0
) -> Recording:
    """Render the sequence on the specimen standing on its stage, and expose the camera.

    Raises
    ------
    InputError
        A part of the specimen has no material.
    MissingBackend
        No usable Dr.Jit backend.
    """
    clock = clock or Stopwatch()
    with clock.stage("render") as progress:
        radiance = render_direct(experiment, progress)
    return expose_capture(experiment, radiance, clock, trial)
