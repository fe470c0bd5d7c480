"""Contact-FPP from the experiment to millimetres: press, render, expose, reconstruct, score."""

from dataclasses import dataclass

from reconstruction.capture import Capture
from reconstruction.decode import DecodeOptions
from reconstruction.errors import InputError
from reconstruction.pipeline import Reconstruction, ReconstructOptions, reconstruct
from twin.camera import expose
from twin.config.models import Decode, Experiment
from twin.mechanics import PressedElastomer, face_mesh, press_with
from twin.modalities.progress import Stopwatch, Watcher, nobody
from twin.modalities.score import Score, score
from twin.optics.light import pattern_set
from twin.optics.render import render
from twin.optics.rig import true_calibration
from twin.optics.stack import RadianceStack, Truth


@dataclass(frozen=True, eq=False)
class Recording:
    """What the virtual rig delivers, and the truth that a real rig does not have."""

    radiance: RadianceStack
    capture: Capture
    exposure_ms: float

    @property
    def truth(self) -> Truth:
        """Geometry behind every camera pixel."""
        return self.radiance.truth


@dataclass(frozen=True, eq=False)
class Measurement:
    """One virtual measurement, whole."""

    pressed: PressedElastomer
    recording: Recording
    reconstruction: Reconstruction
    score: Score
    seconds: dict[str, float]


def press_specimen(experiment: Experiment) -> PressedElastomer:
    """Press the experiment's specimen into its elastomer, with the model that it asks for."""
    return press_with(
        experiment.mechanics, experiment.specimen, experiment.elastomer, experiment.press
    )


def record(
    experiment: Experiment,
    pressed: PressedElastomer,
    clock: Stopwatch | None = None,
    trial: int = 0,
) -> Recording:
    """Render the sequence on the pressed face and expose the camera.

    Parameters
    ----------
    experiment : Experiment
    pressed : PressedElastomer
    clock : Stopwatch, optional
    trial : int
        Repetition with new temporal noise.

    Raises
    ------
    InputError
        The coat is not seen from outside (contact-face layout).
    MissingBackend
        No usable Dr.Jit backend.
    """
    if experiment.elastomer.layout == "contact_face":
        raise InputError(
            "elastomer.layout = 'contact_face': the coat is seen through the gel, which is not"
            " rendered yet; use twin press, or layout = 'opposite_face'"
        )
    clock = clock or Stopwatch()
    with clock.stage("render") as progress:
        radiance = render(experiment, face_mesh(pressed), progress)
    patterns = pattern_set(experiment.projector, experiment.patterns)
    with clock.stage("expose") as progress:
        white = patterns.index("white").start
        exposed = expose(experiment, radiance.frames, white, trial, progress)
    capture = Capture(
        stack=exposed.stack,
        patterns=patterns,
        sensor=exposed.sensor,
        calibration=true_calibration(experiment),
        bit_depth=experiment.camera.bit_depth,
    )
    return Recording(radiance, capture, exposed.exposure_ms)


def options_of(decode: Decode) -> ReconstructOptions:
    """Return the decoder's options as the experiment states them."""
    return ReconstructOptions(
        decode=DecodeOptions(
            filter_taps=decode.filter_taps, filter_sigma_px=decode.filter_sigma_px
        ),
        use=decode.use,
    )


def measure(experiment: Experiment, watch: Watcher = nobody) -> Measurement:
    """Run one virtual contact-FPP measurement.

    Raises
    ------
    InputError
        Something in the experiment cannot be pressed, rendered or fitted.
    MissingBackend
        No usable Dr.Jit backend.
    """
    clock = Stopwatch(watch)
    with clock.stage("press"):
        pressed = press_specimen(experiment)
    recording = record(experiment, pressed, clock)
    with clock.stage("reconstruct"):
        reconstruction = reconstruct(recording.capture, options_of(experiment.decode))
    with clock.stage("score"):
        scored = score(experiment, reconstruction, recording.truth)
    return Measurement(pressed, recording, reconstruction, scored, clock.seconds)
