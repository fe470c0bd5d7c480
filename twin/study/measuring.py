"""What a worker does for one case: measure it, sharing stages with the cases before it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from reconstruction.capture.folder import write_capture
from twin.config import Experiment
from twin.modalities import measure, measure_photometric
from twin.modalities.measurement import Measurement
from twin.modalities.photometric_stereo import PhotometricMeasurement
from twin.modalities.photometric_storage import photometric_figures, write_heights, write_seen
from twin.modalities.score import metrics
from twin.modalities.storage import (
    CAPTURE_FOLDER,
    press_metrics,
    recording_metrics,
    write_pressed,
    write_reconstructed,
)
from twin.study.reads import Path as FieldPath
from twin.study.stages import ContactStages, Staged

Figures = dict[str, Any]
StageReads = tuple[tuple[FieldPath, ...], ...]


@dataclass(frozen=True)
class Answer:
    """What a case gave.

    Attributes
    ----------
    figures : as in result.json of `twin measure`
    write : puts the arrays asked for into the case's folder
    """

    figures: Figures
    write: Callable[[Path], None] = lambda _: None


@dataclass
class CaseMeasurer:
    """Measures case after case; one per process, for it keeps the stages' latest results.

    Attributes
    ----------
    keep : arrays to write per case: "press", "capture", "points"
    """

    keep: tuple[str, ...] = ()
    stages: ContactStages = field(default_factory=ContactStages)

    def __call__(self, experiment: Experiment) -> Answer:
        """Measure one case.

        Raises
        ------
        InputError
            Something in the experiment cannot be pressed, rendered or fitted.
        MissingBackend
            No usable Dr.Jit backend.
        """
        if experiment.modality == "photometric_stereo":
            return self._of_colours(measure_photometric(experiment))
        if experiment.modality == "direct_fpp":
            return self._of_fringes(measure(experiment))
        return self._of_fringes(self.stages.measure(experiment))

    def reads(self) -> StageReads:
        """Fields that each stage looked at for the latest case, first stage first."""
        return tuple(paths for _, _, _, paths in self.stages.stages())

    def _of_fringes(self, done: Measurement | Staged) -> Answer:
        figures: Figures = {"warnings": []}
        if done.pressed is not None:
            figures = press_metrics(done.pressed)
        figures |= recording_metrics(done.recording) | metrics(done.score)
        return Answer(figures, lambda folder: self._write_fringes(folder, done))

    def _write_fringes(self, folder: Path, done: Measurement | Staged) -> None:
        if "press" in self.keep and done.pressed is not None:
            write_pressed(folder, done.pressed)
        if "capture" in self.keep:
            (folder / CAPTURE_FOLDER).mkdir()
            write_capture(folder / CAPTURE_FOLDER, done.recording.capture)
        if "points" in self.keep:
            write_reconstructed(folder, done.reconstruction)

    def _of_colours(self, done: PhotometricMeasurement) -> Answer:
        return Answer(photometric_figures(done), lambda folder: self._write_colours(folder, done))

    def _write_colours(self, folder: Path, done: PhotometricMeasurement) -> None:
        if "press" in self.keep:
            write_pressed(folder, done.pressed)
        if "capture" in self.keep:
            write_seen(folder, done)
        if "points" in self.keep:
            write_heights(folder, done)
