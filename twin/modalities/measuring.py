"""Run one virtual measurement by whichever method the experiment names, into a folder."""

from pathlib import Path

from twin.config import Experiment
from twin.modalities.measurement import measure
from twin.modalities.photometric_stereo import measure_photometric
from twin.modalities.photometric_storage import write_photometric
from twin.modalities.progress import Watcher, nobody
from twin.modalities.storage import write_measurement


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
