"""Contact-FPP: fringes on the coat of the pressed elastomer."""

from reconstruction.decoding.decode import DecodeOptions
from reconstruction.errors import InputError
from reconstruction.pipeline import ReconstructOptions
from twin.config.models import Decode, Experiment
from twin.mechanics import (
    ContactTransfer,
    PressedElastomer,
    contact_transfer,
    face_mesh,
    press_with,
    ridge_height_mm,
    ridge_transfer,
    textured,
)
from twin.modalities.progress import Stopwatch
from twin.modalities.recording import Recording, expose_capture
from twin.optics.render import render


def press_specimen(experiment: Experiment) -> PressedElastomer:
    """Press the experiment's specimen into its elastomer: the coated face as it is seen."""
    return with_texture(experiment, press_smooth(experiment))


def press_smooth(experiment: Experiment) -> PressedElastomer:
    """Press with the model that the experiment asks for; the coat's texture is left out."""
    return press_with(
        experiment.mechanics, experiment.specimen, experiment.elastomer, experiment.press
    )


def with_texture(experiment: Experiment, smooth: PressedElastomer) -> PressedElastomer:
    """Lay the experiment's texture, if its coat has one, on a smooth pressed face."""
    texture = experiment.coating.texture
    if texture is None:
        return smooth
    return textured(smooth, experiment.elastomer, experiment.press, texture, experiment.seed)


def transfer_of(experiment: Experiment, pressed: PressedElastomer) -> ContactTransfer:
    """Return what the coat shows of grooves of each pitch, by the kind of model that pressed.

    Raises
    ------
    PressError
        A thin sheet without back pressure.
    """
    if pressed.model != "sheet":
        return contact_transfer(experiment.elastomer)
    ridge_mm = ridge_height_mm(experiment.specimen)
    return ridge_transfer(experiment.elastomer, experiment.press.back_pressure_kpa, ridge_mm)


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
        The coat is seen through a gel (contact-face layout) that the experiment does not describe.
    MissingBackend
        No usable Dr.Jit backend.
    """
    check_layers(experiment)
    clock = clock or Stopwatch()
    with clock.stage("render") as progress:
        radiance = render(experiment, face_mesh(pressed), progress)
    return expose_capture(experiment, radiance, clock, trial)


def check_layers(experiment: Experiment) -> None:
    """Refuse a coat that is seen through a gel which the experiment does not describe.

    Raises
    ------
    InputError
    """
    if experiment.elastomer.layout == "contact_face" and not experiment.layers:
        raise InputError(
            "layers: found none, elastomer.layout = 'contact_face' is seen through its gel; add "
            f"[layers.gel] with bottom_mm = 0, thickness_mm = {experiment.elastomer.thickness_mm:g}"
            " and ior, or use twin press"
        )


def options_of(decode: Decode) -> ReconstructOptions:
    """Return the decoder's options as the experiment states them."""
    return ReconstructOptions(
        decode=DecodeOptions(
            filter_taps=decode.filter_taps, filter_sigma_px=decode.filter_sigma_px
        ),
        use=decode.use,
    )
