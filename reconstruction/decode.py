"""From a stack of camera frames to projector coordinates, with sigma and reason for every pixel.

Frames: camera pixels (row, col), row 0 at the top; projector coordinates in px, integer = centre of
a projector pixel. Formulas: see `patterns`; N-step least squares after Surrel, Appl. Opt. 36, 271
(1997); edge-safe order after Zhang et al., Opt. Lasers Eng. 50, 574 (2012).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from reconstruction._jit import run_over_rows
from reconstruction._order_kernels import Code
from reconstruction._phase_kernels import Phases, Smoothing, phase_rows
from reconstruction._sum_kernels import Layout, Limits, Sums, sum_rows
from reconstruction.arrays import BoolImage, FloatImage, OrderImage, ReasonImage, Stack
from reconstruction.checks import require_integer, require_number
from reconstruction.errors import InputError
from reconstruction.mask import Reason
from reconstruction.patterns import AXES, PatternSet
from reconstruction.sensor import SensorNoise
from reconstruction.smoothing import gaussian_weights, noise_gain

__all__ = ["AxisDecode", "DecodeOptions", "Decoded", "Reason", "decode"]

STACK_TYPES = ("uint8", "uint16", "float32")


@dataclass(frozen=True)
class DecodeOptions:
    """How to filter and what to mask.

    Parameters
    ----------
    filter_taps : width of the Gaussian on the complex phasor, px; 0 switches it off. An even
        width is averaged over both anchors (one tap more), so that nothing shifts by half a pixel
    filter_sigma_px : its standard deviation; the paper states only 8 x 8, 1.55 is OpenCV's rule
        for 8 taps
    min_support : share of the filter weight that must lie on pixels with a phase; below 1 a
        one-sided neighbourhood biases the phase by its slope
    min_modulation_dn : mask a smaller fringe contrast; None: only the next limit
    max_phase_sigma_rad : mask a larger predicted phase sigma of the single pixel
    dark_sigmas : white must exceed black by this many sigmas of their difference
    gray_sigmas : a Gray level closer to its threshold than this many sigmas is doubtful
    """

    filter_taps: int = 8
    filter_sigma_px: float = 1.55
    min_support: float = 1.0
    min_modulation_dn: float | None = None
    max_phase_sigma_rad: float = 0.1
    dark_sigmas: float = 3.0
    gray_sigmas: float = 4.0

    def __post_init__(self) -> None:
        require_integer("filter_taps", self.filter_taps, 0, 63)
        require_number("filter_sigma_px", self.filter_sigma_px, 0.0, open_low=True)
        require_number("min_support", self.min_support, 0.0, 1.0, open_low=True)
        if self.min_modulation_dn is not None:
            require_number("min_modulation_dn", self.min_modulation_dn, 0.0)
        require_number("max_phase_sigma_rad", self.max_phase_sigma_rad, 0.0, open_low=True)
        require_number("dark_sigmas", self.dark_sigmas, 0.0)
        require_number("gray_sigmas", self.gray_sigmas, 0.0)


@dataclass(frozen=True, eq=False)
class AxisDecode:
    """What the frames along one projector axis say, every field (row, col).

    coordinate_px, order and sigma_px are 0 unless the pixel is valid. phase_rad in [0, 2 pi) is
    also given for masked pixels that have a phase. mean_dn and modulation_dn are always given;
    modulation_dn is that of the filtered phasor where there is a phase.
    """

    coordinate_px: FloatImage
    phase_rad: FloatImage
    order: OrderImage
    mean_dn: FloatImage
    modulation_dn: FloatImage
    sigma_px: FloatImage


@dataclass(frozen=True, eq=False)
class Decoded:
    """Both projector coordinates of every camera pixel, and why a pixel has none."""

    column: AxisDecode
    row: AxisDecode
    mask_reason: ReasonImage

    @property
    def valid(self) -> BoolImage:
        """Where both coordinates are known, (row, col) bool."""
        return np.equal(self.mask_reason, Reason.VALID)


class _Setup(NamedTuple):
    layout: Layout
    code: Code
    limits: Limits
    smoothing: Smoothing


def decode(
    stack: Stack,
    patterns: PatternSet,
    sensor: SensorNoise,
    options: DecodeOptions | None = None,
) -> Decoded:
    """Decode a stack of frames.

    Parameters
    ----------
    stack : (frame, row, col) uint8, uint16 or float32, DN, in the order of `patterns.frames`
    patterns : what was projected
    sensor : noise model; gives the masks and the predicted sigma
    options : filter and masks; None: the defaults of `DecodeOptions`

    Raises
    ------
    InputError : wrong number of axes, frames or type of the stack
    """
    _check_stack(stack, patterns)
    setup = _set_up(patterns, sensor, options or DecodeOptions())
    sums = _sum_stack(np.ascontiguousarray(stack), setup, patterns.steps)
    phases = _find_phases(sums, setup)
    column, row = (_axis_result(axis, sums, phases) for axis in range(2))
    return Decoded(column, row, sums.reason)


def _check_stack(stack: Stack, patterns: PatternSet) -> None:
    if stack.dtype.name not in STACK_TYPES:
        raise InputError(f"stack is {stack.dtype}; allowed are {', '.join(STACK_TYPES)}")
    if stack.ndim != 3 or stack.shape[0] != len(patterns.frames) or stack.size == 0:
        raise InputError(
            f"stack has shape {stack.shape}; "
            f"this pattern set needs ({len(patterns.frames)} frames, rows, cols)"
        )


def _set_up(patterns: PatternSet, sensor: SensorNoise, options: DecodeOptions) -> _Setup:
    weights = gaussian_weights(options.filter_taps, options.filter_sigma_px)
    return _Setup(
        _layout(patterns),
        _code(patterns),
        Limits(
            gain_dn_per_e=float(sensor.gain_dn_per_e),
            read_noise_e=float(sensor.read_noise_e),
            black_level_dn=float(sensor.black_level_dn),
            saturation_dn=float(sensor.saturation_dn),
            dark_sigmas=float(options.dark_sigmas),
            gray_sigmas=float(options.gray_sigmas),
            min_modulation_dn=float(options.min_modulation_dn or 0.0),
            max_phase_sigma_rad=float(options.max_phase_sigma_rad),
        ),
        Smoothing(weights, noise_gain(weights), float(options.min_support)),
    )


def _layout(patterns: PatternSet) -> Layout:
    column, row = AXES
    return Layout(
        phase_first=(patterns.index("phase", column).start, patterns.index("phase", row).start),
        gray_first=(patterns.index("gray", column).start, patterns.index("gray", row).start),
        gray_bits=(patterns.word_bits(column), patterns.word_bits(row)),
        white=patterns.index("white").start,
        black=patterns.index("black").start,
    )


def _code(patterns: PatternSet) -> Code:
    column, row = AXES
    return Code(
        period_px=float(patterns.period_px),
        steps=int(patterns.steps),
        complementary=patterns.complementary,
        words=(patterns.words(column), patterns.words(row)),
        bits=(patterns.word_bits(column), patterns.word_bits(row)),
        length_px=(patterns.width_px, patterns.height_px),
    )


def _sum_stack(stack: Stack, setup: _Setup, steps: int) -> Sums:
    rows, cols = stack.shape[1:]
    mean, real, imag, modulation = (np.zeros((2, rows, cols), np.float32) for _ in range(4))
    word, weak = (np.zeros((2, rows, cols), np.uint16) for _ in range(2))
    reason, usable = np.zeros((rows, cols), np.uint8), np.zeros((rows, cols), np.float32)
    sums = Sums(mean, real, imag, modulation, word, weak, reason, usable)
    turns = 2.0 * np.pi * np.arange(steps) / steps
    cosines, sines = np.cos(turns).astype(np.float32), np.sin(turns).astype(np.float32)
    run_over_rows(sum_rows, rows, stack, setup.layout, setup.limits, cosines, sines, sums)
    return sums


def _find_phases(sums: Sums, setup: _Setup) -> Phases:
    shape = sums.mean_dn.shape
    coordinate, phase, sigma = (np.zeros(shape, np.float32) for _ in range(3))
    phases = Phases(coordinate, phase, np.zeros(shape, np.int16), sigma)
    run_over_rows(phase_rows, shape[1], setup.code, setup.smoothing, setup.limits, sums, phases)
    return phases


def _axis_result(axis: int, sums: Sums, phases: Phases) -> AxisDecode:
    return AxisDecode(
        coordinate_px=phases.coordinate_px[axis],
        phase_rad=phases.phase_rad[axis],
        order=phases.order[axis],
        mean_dn=sums.mean_dn[axis],
        modulation_dn=sums.modulation_dn[axis],
        sigma_px=phases.sigma_px[axis],
    )
