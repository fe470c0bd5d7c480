"""What one method saw of one specimen: as much as tables and figures need, whatever the method."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.mask import Reason
from twin.config import Experiment
from twin.mechanics import PressedElastomer
from twin.optics.stack import Truth
from twin.pipeline.colours import PhotometricMeasurement
from twin.pipeline.fringes import Measurement
from twin.pipeline.memory import Memory
from twin.pipeline.methods import measure
from twin.pipeline.photometric_score import in_world
from twin.pipeline.photometric_storage import photometric_figures
from twin.pipeline.progress import Watcher, nobody
from twin.pipeline.score import SphereScore
from twin.pipeline.storage import fringe_figures
from twin.report.camera_view import fringe_frame


@dataclass(frozen=True, eq=False)
class Seen:
    """One measurement by any method.

    Attributes
    ----------
    figures : as in the result.json of `twin measure`
    picture : (row, col) or (row, col, 3) uint8
        One fringe image, or the colours of photometric stereo.
    points_mm : (row, col, xyz) float, world
    reason : (row, col) uint8, codes of `reconstruction.mask.Reason`
    pressed : None where the bare specimen is seen
    """

    experiment: Experiment
    figures: dict[str, Any]
    picture: NDArray[np.uint8]
    points_mm: NDArray[np.floating[Any]]
    reason: NDArray[np.uint8]
    truth: Truth
    balls: Sequence[SphereScore]
    pressed: PressedElastomer | None

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Pixels with a point, (row, col)."""
        return np.asarray(self.reason == Reason.VALID)


def see(experiment: Experiment, watch: Watcher = nobody, memory: Memory | None = None) -> Seen:
    """Measure by the method that the experiment names.

    Raises
    ------
    InputError
        Something in the experiment cannot be pressed, rendered or fitted.
    MissingBackend
        No usable Dr.Jit backend.
    """
    done = measure(experiment, watch, memory)
    if isinstance(done, Measurement):
        return seen_in_fringes(experiment, done)
    return seen_in_colour(experiment, done)


def seen_in_fringes(experiment: Experiment, done: Measurement) -> Seen:
    """Take over a finished measurement with fringes."""
    points, capture = done.reconstruction.point_map, done.recording.capture
    frame = capture.stack[capture.patterns.frames.index(fringe_frame(capture))]
    share = frame / np.float32(capture.sensor.saturation_dn)
    return Seen(
        experiment=experiment,
        figures=fringe_figures(done),
        picture=np.rint(255.0 * np.clip(share, 0.0, 1.0)).astype(np.uint8),
        points_mm=points.points_world_mm,
        reason=np.asarray(points.mask_reason, np.uint8),
        truth=done.recording.truth,
        balls=done.score.spheres,
        pressed=done.pressed,
    )


def seen_in_colour(experiment: Experiment, done: PhotometricMeasurement) -> Seen:
    """Take over a finished measurement by photometric stereo, by the experiment's own decoder."""
    found = in_world(done.heights)
    reason = np.where(found.valid, Reason.VALID, Reason.LOW_MODULATION)
    return Seen(
        experiment=experiment,
        figures=photometric_figures(done),
        picture=np.asarray(done.image, np.uint8),
        points_mm=found.points_mm,
        reason=reason.astype(np.uint8),
        truth=done.truth,
        balls=done.score.spheres,
        pressed=done.pressed,
    )
