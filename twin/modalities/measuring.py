"""Run one virtual measurement by whichever method the experiment names, into a folder."""

from pathlib import Path

from twin.config import Experiment
from twin.mechanics import check_press
from twin.modalities.contact_fpp import check_layers
from twin.modalities.measurement import measure
from twin.modalities.photometric_stereo import check_sensor, measure_photometric
from twin.modalities.photometric_storage import write_photometric
from twin.modalities.progress import Watcher, nobody
from twin.modalities.storage import write_measurement
from twin.optics.checks import check_renderable


def measure_into(
    folder: Path, command: str, experiment: Experiment, watch: Watcher = nobody
) -> None:
    """Measure, and write everything of it into an empty folder; `command` is who asked.

    Raises
    ------
    InputError
        Something in the experiment cannot be pressed, rendered or fitted.
    MissingBackend
        No usable Dr.Jit backend.
    """
    if experiment.modality == "photometric_stereo":
        colours = measure_photometric(experiment, watch)
        watch("write", 0.0)
        write_photometric(folder, command, experiment, colours)
    else:
        fringes = measure(experiment, watch)
        watch("write", 0.0)
        write_measurement(folder, command, experiment, fringes)
    watch("write", 1.0)


def check_measurable(experiment: Experiment) -> None:
    """Refuse an experiment that cannot be measured, as far as that is plain without measuring.

    The checks are those of the measurement itself; what only the press or the image can tell, such
    as the depth that a force needs, is not among them.

    Raises
    ------
    InputError
        What cannot be pressed or rendered, and what to change.
    """
    if experiment.modality != "direct_fpp":
        check_press(
            experiment.mechanics, experiment.specimen, experiment.elastomer, experiment.press
        )
    if experiment.modality == "contact_fpp":
        check_layers(experiment)
    if experiment.modality == "photometric_stereo":
        check_sensor(experiment)
    check_renderable(experiment)
