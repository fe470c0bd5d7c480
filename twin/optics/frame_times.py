"""Time of every frame of a sequence: camera and projector run in step.

A frame takes as long as the slowest of its parts, unless [timing] states its rate:

    frame period = max(delay + exposure + readout, 1000 / camera.frame_rate_hz, 1000 / pattern rate)

The exposure of a global shutter overlaps with the readout of the frame before: its readout counts
as 0. A rolling shutter exposes the last row later than the first one, and both have to record the
same pattern. The pattern rate is `projector.pattern_rate_1bit_hz` for a frame that has only the
levels 0 and 255, and `projector.pattern_rate_8bit_hz` for any other frame.
"""

from typing import NamedTuple

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.errors import InputError
from twin.config.models import Experiment
from twin.optics.light import pattern_set

_BINARY_LEVELS = {0, 255}
_ROUNDING = 1.0 + 1e-9


class FrameTimes(NamedTuple):
    """Exposures of all frames in the first row of the image; time 0 is that of `timing.origin`.

    Attributes
    ----------
    start_s : (frame,) start of each exposure
    duration_s : (frame,) exposure time
    """

    start_s: FloatArray
    duration_s: FloatArray


def frame_times_s(experiment: Experiment) -> FrameTimes:
    """Return start and duration of the exposure of every frame, in the first row of the image.

    Row r of the image starts `r * row_delay_s(experiment)` later. Time 0 is the middle between the
    start of the first exposure and the end of the last one, in the middle row; with `timing.origin`
    "phase" of the phase frames only.

    Raises
    ------
    InputError : the exposure is automatic, or does not fit in the period that [timing] states
    """
    exposure_ms = _stated_exposure_ms(experiment)
    binary = binary_frames(experiment)
    periods_ms = np.where(
        binary,
        frame_period_ms(experiment, exposure_ms, binary=True),
        frame_period_ms(experiment, exposure_ms, binary=False),
    )
    for is_binary in np.unique(binary):
        _check_period(experiment, exposure_ms, binary=bool(is_binary))
    start_ms = np.concatenate([[0.0], np.cumsum(periods_ms)[:-1]])
    first_ms, last_ms = _ends_of_origin_ms(experiment, start_ms)
    middle_ms = (first_ms + last_ms + exposure_ms + _rolling_ms(experiment)) / 2.0
    return FrameTimes(1e-3 * (start_ms - middle_ms), np.full(len(start_ms), 1e-3 * exposure_ms))


def mean_times_s(experiment: Experiment) -> FloatArray:
    """Return the middle of the exposure of every frame (frame,), s, in the middle row."""
    times = frame_times_s(experiment)
    return np.asarray(times.start_s + times.duration_s / 2.0 + 5e-4 * _rolling_ms(experiment))


def _ends_of_origin_ms(experiment: Experiment, start_ms: FloatArray) -> tuple[float, float]:
    """Return the starts of the first and the last exposure between which time 0 is the middle."""
    if experiment.timing.origin == "sequence":
        return float(start_ms[0]), float(start_ms[-1])
    frames = pattern_set(experiment.projector, experiment.patterns).frames
    phase_ms = start_ms[[frame.kind == "phase" for frame in frames]]
    if not phase_ms.size:
        raise InputError(
            "timing.origin: found 'phase' and patterns.steps = 0, allowed 'sequence' without phase"
            " frames"
        )
    return float(phase_ms[0]), float(phase_ms[-1])


def sequence_ends_s(experiment: Experiment) -> tuple[float, float]:
    """Return the start of the first exposure and the end of the last one, in all rows.

    Raises
    ------
    InputError : as `frame_times_s`
    """
    times = frame_times_s(experiment)
    start_s = float(times.start_s[0])
    if experiment.timing.origin == "sequence":
        return start_s, -start_s  # symmetric without rounding errors
    rolling_s = 1e-3 * _rolling_ms(experiment)
    return start_s, float(times.start_s[-1] + times.duration_s[-1]) + rolling_s


def row_delay_s(experiment: Experiment) -> float:
    """Return the time from the exposure of one row of the (binned) image to that of the next."""
    return 1e-6 * experiment.timing.line_time_us * experiment.camera.binning


def binary_frames(experiment: Experiment) -> BoolImage:
    """Return True for the frames (frame,) that have only the levels 0 and 255."""
    frames = pattern_set(experiment.projector, experiment.patterns).frames
    shown = {experiment.patterns.low_level, experiment.patterns.high_level}
    return np.array([shown <= _BINARY_LEVELS and frame.kind != "phase" for frame in frames])


def frame_period_ms(experiment: Experiment, exposure_ms: float, *, binary: bool) -> float:
    """Return the time from one frame to the next, ms, at an exposure time.

    Parameters
    ----------
    binary : True for frames that have only the levels 0 and 255
    """
    stated_hz = _stated_rate_hz(experiment, binary)[1]
    if stated_hz is not None:
        return 1e3 / stated_hz
    rates_hz = (experiment.camera.frame_rate_hz, _largest_rate_hz(experiment, binary))
    exposed_ms = experiment.timing.trigger_delay_ms + exposure_ms + _rolling_ms(experiment)
    return max(exposed_ms, *(1e3 / rate if rate else 0.0 for rate in rates_hz))


def _rolling_ms(experiment: Experiment) -> float:
    rows = experiment.camera.height_px // experiment.camera.binning
    return 1e3 * row_delay_s(experiment) * (rows - 1)


def _stated_rate_hz(experiment: Experiment, binary: bool) -> tuple[str, float | None]:
    timing = experiment.timing
    if binary and timing.binary_rate_hz is not None:
        return "binary_rate_hz", timing.binary_rate_hz
    return "pattern_rate_hz", timing.pattern_rate_hz


def _largest_rate_hz(experiment: Experiment, binary: bool) -> float | None:
    projector = experiment.projector
    if binary and projector.pattern_rate_1bit_hz is not None:
        return projector.pattern_rate_1bit_hz
    return projector.pattern_rate_8bit_hz


def _stated_exposure_ms(experiment: Experiment) -> float:
    exposure_ms = experiment.camera.exposure_ms
    if exposure_ms == "auto":
        raise InputError(
            "camera.exposure_ms: found 'auto', allowed a number for frames at known times; use "
            "exposure_ms of result.json of the scene at rest"
        )
    return exposure_ms


def _check_period(experiment: Experiment, exposure_ms: float, *, binary: bool) -> None:
    key, stated_hz = _stated_rate_hz(experiment, binary)
    if stated_hz is None:
        return
    needed_ms = experiment.timing.trigger_delay_ms + exposure_ms + _rolling_ms(experiment)
    rates_hz = (experiment.camera.frame_rate_hz, _largest_rate_hz(experiment, binary))
    largest_hz = min(1e3 / needed_ms, *(rate if rate else np.inf for rate in rates_hz))
    if stated_hz > largest_hz * _ROUNDING:
        raise InputError(
            f"timing.{key}: found {stated_hz:g}, allowed up to {largest_hz:.6g}: delay, exposure "
            f"and readout take {needed_ms:.4g} ms, and camera and projector have their largest "
            "rates; lower it or camera.exposure_ms"
        )
