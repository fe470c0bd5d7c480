"""Duration of a pattern sequence, and a warning about patterns that a projector cannot show.

A frame takes as long as the slowest of its three parts, because camera and projector run in step:

    frame period = max(exposure_ms, 1000 / camera.frame_rate_hz, 1000 / pattern rate)

The exposure of a global shutter overlaps with the readout of the frame before. The pattern rate is
`projector.pattern_rate_1bit_hz` for a frame that has only the levels 0 and 255, and
`projector.pattern_rate_8bit_hz` for any other frame. A DLP projector shows a level by the time for
which its mirrors are on: only an exposure of the whole pattern period records it.
"""

import math

from twin.config.models import Experiment
from twin.optics.light import pattern_set

_BINARY_LEVELS = {0, 255}


def frame_count(experiment: Experiment) -> int:
    """Return the number of frames of the experiment's sequence."""
    return len(pattern_set(experiment.projector, experiment.patterns).frames)


def sequence_ms(experiment: Experiment, exposure_ms: float) -> float:
    """Return the duration of all frames at an exposure time, ms."""
    binary, levelled = _counts(experiment)
    return binary * _period_ms(experiment, exposure_ms, binary=True) + levelled * _period_ms(
        experiment, exposure_ms, binary=False
    )


def _counts(experiment: Experiment) -> tuple[int, int]:
    """Return the numbers of frames with the levels 0 and 255 only, and of all other frames."""
    frames = pattern_set(experiment.projector, experiment.patterns).frames
    shown = {experiment.patterns.low_level, experiment.patterns.high_level}
    binary = sum(frame.kind != "phase" for frame in frames) if shown <= _BINARY_LEVELS else 0
    return binary, len(frames) - binary


def _period_ms(experiment: Experiment, exposure_ms: float, binary: bool) -> float:
    rates_hz = (experiment.camera.frame_rate_hz, _pattern_rate_hz(experiment, binary))
    return max(exposure_ms, *(1e3 / rate if rate else 0.0 for rate in rates_hz))


def _pattern_rate_hz(experiment: Experiment, binary: bool) -> float | None:
    projector = experiment.projector
    if binary and projector.pattern_rate_1bit_hz is not None:
        return projector.pattern_rate_1bit_hz
    return projector.pattern_rate_8bit_hz


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
