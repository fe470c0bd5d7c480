"""One virtual measurement, whole, by whichever method the experiment names."""

from dataclasses import dataclass

from reconstruction.errors import InputError
from reconstruction.pipeline import Reconstruction, reconstruct
from twin.config.models import Experiment
from twin.mechanics import PressedElastomer
from twin.modalities.contact_fpp import options_of, press_specimen, record
from twin.modalities.direct_fpp import record_direct
from twin.modalities.progress import Stopwatch, Watcher, nobody
from twin.modalities.recording import Recording
from twin.modalities.score import Score, score


@dataclass(frozen=True, eq=False)
class Measurement:
    """One virtual measurement, whole; nothing is pressed where the bare specimen is seen."""

    pressed: PressedElastomer | None
    recording: Recording
    reconstruction: Reconstruction
    score: Score
    seconds: dict[str, float]


def take(
    experiment: Experiment, clock: Stopwatch, trial: int = 0
) -> tuple[PressedElastomer | None, Recording]:
    """Press where the method presses, then record.

    Raises
    ------
    InputError
        Something in the experiment cannot be pressed or rendered.
    MissingBackend
        No usable Dr.Jit backend.
    """
    if experiment.modality == "photometric_stereo":
        raise InputError(
            "modality = 'photometric_stereo' takes one colour image and no fringe stack; use"
            " twin measure, or measure_photometric in Python"
        )
    if experiment.modality == "direct_fpp":
        return None, record_direct(experiment, clock, trial)
    with clock.stage("press"):
        pressed = press_specimen(experiment)
    return pressed, record(experiment, pressed, clock, trial)


def measure(experiment: Experiment, watch: Watcher = nobody) -> Measurement:
    """Run one virtual measurement.

    Raises
    ------
    InputError
        Something in the experiment cannot be pressed, rendered or fitted.
    MissingBackend
        No usable Dr.Jit backend.
    """
    clock = Stopwatch(watch)
    pressed, recording = take(experiment, clock)
    with clock.stage("reconstruct"):
        reconstruction = reconstruct(recording.capture, options_of(experiment.decode))
    with clock.stage("score"):
        scored = score(experiment, reconstruction, recording.truth)
    return Measurement(pressed, recording, reconstruction, scored, clock.seconds)
