"""Duration of a pattern sequence, and a warning about patterns that a projector cannot show.

The period of a frame is that of `twin.optics.frame_times`. A DLP projector shows a level by the
time for which its mirrors are on: only an exposure of the whole pattern period records it.
"""

import math

import numpy as np

from twin.config.models import Experiment
from twin.optics.frame_times import binary_frames, frame_period_ms


def frame_count(experiment: Experiment) -> int:
    """Return the number of frames of the experiment's sequence."""
    return len(binary_frames(experiment))


def sequence_ms(experiment: Experiment, exposure_ms: float) -> float:
    """Return the duration of all frames at an exposure time, ms."""
    binary, levelled = _counts(experiment)
    return binary * frame_period_ms(
        experiment, exposure_ms, binary=True
    ) + levelled * frame_period_ms(experiment, exposure_ms, binary=False)


def _counts(experiment: Experiment) -> tuple[int, int]:
    """Return the numbers of frames with the levels 0 and 255 only, and of all other frames."""
    binary = binary_frames(experiment)
    return int(np.count_nonzero(binary)), int(np.count_nonzero(~binary))


def sequence_warnings(experiment: Experiment, exposure_ms: float) -> list[str]:
    """Return a warning if the exposure is shorter than a pattern of 256 levels."""
    rate_hz, (_, levelled) = experiment.projector.pattern_rate_8bit_hz, _counts(experiment)
    if not levelled or rate_hz is None or exposure_ms >= (1.0 - 1e-9) * 1e3 / rate_hz:
        return []
    remedy = (
        "dim the projector (flux_mw) or raise camera.f_number"
        if experiment.camera.exposure_ms == "auto"
        else f"set camera.exposure_ms to at least {math.ceil(1e5 / rate_hz) / 100.0:g}"
    )
    return [
        f"exposure of {exposure_ms:.3g} ms, shorter than the {1e3 / rate_hz:.3g} ms in which the "
        "projector shows an 8-bit pattern (projector.pattern_rate_8bit_hz): a real camera records "
        f"a part of its levels; {remedy}"
    ]
