"""What a virtual rig delivers: radiance through the camera, as a capture, with the truth beside."""

from dataclasses import dataclass

from reconstruction.capture.folder import Capture
from twin.camera import expose
from twin.config.models import Experiment
from twin.modalities.progress import Stopwatch
from twin.optics.light import pattern_set
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


def expose_capture(
    experiment: Experiment, radiance: RadianceStack, clock: Stopwatch, trial: int
) -> Recording:
    """Expose the camera to a rendered stack; `trial` draws new temporal noise."""
    clock.count_frames("render", len(radiance.frames))
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
