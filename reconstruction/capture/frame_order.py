"""Check from the recorded images whether the frames have the order of the pattern set.

Five checks use a sample of the lit pixels. If one fails, its message names the mistake that
explains the images:

- Whole sequence: another order (exchanged axes, shifted by one, reversed ...) must not give points
  for far more of the lit pixels.
- Each set of N phase frames: the frames must follow A + B cos(phi + 2 pi n / N) with equal
  exposure, and an exchange of two frames must not fit better (`check_phase_sets`).
- First step: the phase must agree with the half-periods of an edge-safe Gray code
  (`check_first_step`).
- Gray words: those of neighbouring pixels must differ by at most one (`check_words`).
- Borders: where a plain Gray word ends, the phase must be 0 and increase with the word
  (`check_borders`).

Two mistakes are not detected. With codes of several periods, phase frames may start late, or be
reversed along both axes. With fewer than five steps, a phase frame may belong to another set.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from reconstruction.arrays import BoolImage, Stack
from reconstruction.capture.set_order import (
    check_borders,
    check_first_step,
    check_phase_sets,
    check_words,
    exchanged,
)
from reconstruction.decoding.decode import DecodeOptions, decode
from reconstruction.errors import CaptureError
from reconstruction.patterns import AXES, Axis, PatternFrame, PatternSet
from reconstruction.rig.calibration import Calibration
from reconstruction.rig.sensor import SensorNoise
from reconstruction.triangulation import triangulate

SAMPLE_PX = 72
"""Number of sampled pixels along the shorter side of the image."""
# If less than the share ENOUGH of the lit pixels gives points, other orders are tried. An order is
# reported only if its share is larger by MUCH_MORE, so that a difficult capture passes.
ENOUGH, MUCH_MORE = 0.8, 0.25
# A pixel is lit if its frames differ by more than LIT_SIGMAS standard deviations of its noise. The
# stated noise may be too small; therefore they must also differ by LIT_SHARE of the difference at
# well-lit pixels, a percentile of all pixels.
LIT_SIGMAS = 8.0
LIT_SHARE, LIT_PERCENTILE = 0.1, 98.0
LEAST_LIT = 50

Order = tuple[str, list[int]]


@dataclass(frozen=True, eq=False)
class Sample:
    """Frames of a capture, sampled on a coarse grid of pixels.

    stack : (frame, row, col), DN
    calibration : calibration with the camera's image size of the sample; None: not calibrated
    is_lit : (row, col) bool
    stride : distance of the sampled pixels, px
    """

    stack: Stack
    patterns: PatternSet
    sensor: SensorNoise
    calibration: Calibration | None
    is_lit: BoolImage
    stride: int


def check_order(
    stack: Stack,
    patterns: PatternSet,
    sensor: SensorNoise,
    calibration: Calibration | None = None,
) -> None:
    """Raise CaptureError if the frames are not in the order of the pattern set.

    Parameters
    ----------
    stack : (frame, row, col), DN of one exposure
    patterns : the expected patterns
    sensor : camera noise, by which lit pixels are selected
    calibration : with it exchanged axes are detected even if both are similar; None: not calibrated

    Raises
    ------
    CaptureError : another order or unequal exposures explain the frames; the message names the
        mistake
    """
    sample = sample_of(stack, patterns, sensor, calibration)
    if np.count_nonzero(sample.is_lit) < LEAST_LIT:
        return
    _check_sequence(sample)
    pixels = sample.stack[:, sample.is_lit].astype(np.float64)
    check_phase_sets(pixels, patterns)
    check_first_step(pixels, patterns)
    check_words(stack, patterns, sensor)
    check_borders(stack, patterns, sensor)


def sample_of(
    stack: Stack,
    patterns: PatternSet,
    sensor: SensorNoise,
    calibration: Calibration | None,
) -> Sample:
    """Return the frames of a capture on a coarse grid of pixels; arguments as of `check_order`."""
    stride = max(1, min(stack.shape[1:]) // SAMPLE_PX)
    sample = np.ascontiguousarray(stack[:, ::stride, ::stride])
    largest = sample.max(axis=0).astype(np.float64)
    span = largest - sample.min(axis=0)
    least_dn = LIT_SHARE * float(np.percentile(span, LIT_PERCENTILE))
    is_lit = (span > LIT_SIGMAS * np.sqrt(sensor.variance_dn2(largest))) & (span > least_dn)
    is_lit &= largest < sensor.clipped_from_dn
    thinned = None if calibration is None else _thinned(calibration, stride, sample.shape[1:])
    return Sample(sample, patterns, sensor, thinned, is_lit, stride)


def _thinned(calibration: Calibration, stride: int, shape: tuple[int, ...]) -> Calibration:
    """Return the calibration of a camera of which only every `stride`-th pixel is used.

    `shape` is the number of rows and columns of the sample.
    """
    camera = calibration.camera
    numbers = ("fx_px", "fy_px", "cx_px", "cy_px")
    scaled = {name: getattr(camera, name) / stride for name in numbers}
    coarse = replace(camera, width_px=shape[1], height_px=shape[0], **scaled)
    return replace(calibration, camera=coarse)


def _check_sequence(sample: Sample) -> None:
    if not sample.patterns.kind.numbers_pixels:
        return
    stated = _share_of_points(sample, None)
    if stated >= ENOUGH:
        return
    needed = stated + MUCH_MORE
    for orders in (_mistakes(sample.patterns), _exchanged_gray(sample.patterns)):
        shares = [(_share_of_points(sample, take), text) for text, take in orders]
        best, text = max(shares, default=(0.0, ""), key=lambda item: item[0])
        if best >= needed:
            raise CaptureError(
                f"the frames do not fit the pattern set: {text}; that order turns {best:.0%} of "
                f"the lit pixels into points, the stated one {stated:.0%}"
            )


def _share_of_points(sample: Sample, take: list[int] | None) -> float:
    stack = sample.stack if take is None else np.ascontiguousarray(sample.stack[take])
    decoded = decode(
        stack, sample.patterns, sample.sensor, DecodeOptions(filter_taps=0, frame_gains=False)
    )
    valid = decoded.valid
    if sample.calibration is not None and sample.patterns.axes == AXES:
        valid = triangulate(decoded, sample.calibration, "both").valid
    return float(np.mean(valid[sample.is_lit]))


def _mistakes(patterns: PatternSet) -> Iterator[Order]:
    """Yield likely wrong orders: a message, and the recorded index of each expected frame."""
    frames, count = patterns.frames, len(patterns.frames)
    kinds = ("phase", "gray", "inverse", "white", "black")
    is_both, has_uniform, has_phase = patterns.axes == AXES, patterns.uniform, patterns.steps > 0

    def sorted_by(key: Callable[[PatternFrame], tuple[object, ...]]) -> list[int]:
        recorded = sorted(frames, key=key)
        return [recorded.index(frame) for frame in frames]

    by_rows = sorted_by(lambda f: (kinds.index(f.kind), f.axis != "row", f.index))
    uniform_first = sorted_by(lambda f: (f.axis is not None,))
    gray_first = sorted_by(lambda f: (f.kind not in ("gray", "phase"), f.kind != "gray"))
    by_axis = sorted_by(lambda f: (f.axis != "column",))
    orders = [
        (has_uniform, "white and black look exchanged", exchanged(count, count - 2, count - 1)),
        (is_both, "rows and columns look exchanged", by_rows),
        (has_uniform, "white and black look recorded first", uniform_first),
        (True, "Gray frames look recorded before phase frames", gray_first),
        (is_both, "frames look recorded axis by axis (phase, Gray, phase, Gray)", by_axis),
        (True, "the frames look recorded backwards", list(range(count))[::-1]),
    ]
    for n in (1, 2):
        late, early = ([(i + shift) % count for i in range(count)] for shift in (n, -n))
        orders += [
            (True, f"shifted by {n}: {n} frame(s) too many at the start", late),
            (True, f"shifted by {n}: the first {n} frame(s) look missing", early),
        ]
    yield from ((message, take) for applies, message, take in orders if applies)
    yield from _reversed_gray(patterns)
    if has_phase:
        yield from _mistaken_phases(patterns)


def _reversed_gray(patterns: PatternSet) -> Iterator[Order]:
    """Yield the order in which the bits are listed coarse first but recorded fine first."""
    for axes in (AXES, AXES[:1], AXES[1:]) if patterns.axes == AXES else (patterns.axes,):
        take = list(range(len(patterns.frames)))
        for kind in ("gray", "inverse"):
            for axis in axes:
                of = [i for i, f in enumerate(patterns.frames) if (f.kind, f.axis) == (kind, axis)]
                for place, frame in zip(of, of[::-1], strict=True):
                    take[place] = frame
        text = f"the Gray frames along {' and '.join(axes)} look recorded in the opposite order"
        yield f"{text} (key bits: coarse or fine first)", take


def _mistaken_phases(patterns: PatternSet) -> Iterator[Order]:
    count, is_both = len(patterns.frames), patterns.axes == AXES
    if is_both:
        column, row = (list(range(count))[patterns.index("phase", axis)] for axis in AXES)
        take = [*row, *column, *range(row[-1] + 1, count)]
        yield "the phase frames of columns and rows look exchanged", take
    for axes in (AXES, AXES[:1], AXES[1:]) if is_both else (patterns.axes,):
        text = f"the phase frames along {' and '.join(axes)} look recorded backwards"
        yield text, _phase_backwards(patterns, axes)


def _phase_backwards(patterns: PatternSet, axes: tuple[Axis, ...]) -> list[int]:
    take = list(range(len(patterns.frames)))
    for axis in axes:
        for span in patterns.step_sets(axis):
            take[span] = take[span][::-1]
    return take


def _exchanged_gray(patterns: PatternSet) -> Iterator[Order]:
    frames = patterns.frames
    gray = [i for i, frame in enumerate(frames) if frame.kind == "gray"]
    for i, j in combinations(gray, 2):
        text = f"frames {i} ({frames[i].name}) and {j} ({frames[j].name}) look exchanged"
        yield text, exchanged(len(frames), i, j)
