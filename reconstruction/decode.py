"""From a stack of camera frames to projector coordinates, with sigma and reason for every pixel.

Frames: camera pixels (row, col), row 0 at the top; projector coordinates in px, integer = centre of
a projector pixel. Formulas: see `patterns`; N-step least squares after Surrel, Appl. Opt. 36, 271
(1997); codes and edge-safe rules: see `PatternSet`, `_order_kernels`, `_chain_kernels`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from reconstruction._band import Maps
from reconstruction._decode_kernels import decode_rows
from reconstruction._jit import run_over_rows
from reconstruction.arrays import FloatImage, Stack
from reconstruction.checks import require_integer, require_number
from reconstruction.compact import Half, Orders, Turns
from reconstruction.decode_plan import make_plan, units_of
from reconstruction.decoded import AxisDecode, Decoded
from reconstruction.errors import InputError
from reconstruction.mask import Reason
from reconstruction.patterns import PatternSet
from reconstruction.sensor import SensorNoise

__all__ = ["AxisDecode", "DecodeOptions", "Decoded", "Reason", "decode"]

STACK_TYPES = ("uint8", "uint16", "float32")
# Large enough that the rows beside a band, summed twice for the filter, cost a few per cent.
BAND_ROWS = 96


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
    max_condition : frames of a pixel that are clipped or lost are left out of its fit; mask a
        larger condition number of what remains (1: all frames are there)
    max_order_error : mask a larger probability of a wrong fringe order; 1: only certain errors
    """

    filter_taps: int = 8
    filter_sigma_px: float = 1.55
    min_support: float = 1.0
    min_modulation_dn: float | None = None
    max_phase_sigma_rad: float = 0.1
    dark_sigmas: float = 3.0
    gray_sigmas: float = 4.0
    max_condition: float = 100.0
    max_order_error: float = 0.01

    def __post_init__(self) -> None:
        require_integer("filter_taps", self.filter_taps, 0, 63)
        require_number("filter_sigma_px", self.filter_sigma_px, 0.0, open_low=True)
        require_number("min_support", self.min_support, 0.0, 1.0, open_low=True)
        if self.min_modulation_dn is not None:
            require_number("min_modulation_dn", self.min_modulation_dn, 0.0)
        require_number("max_phase_sigma_rad", self.max_phase_sigma_rad, 0.0, open_low=True)
        require_number("dark_sigmas", self.dark_sigmas, 0.0)
        require_number("gray_sigmas", self.gray_sigmas, 0.0)
        require_number("max_condition", self.max_condition, 1.0)
        require_number("max_order_error", self.max_order_error, 0.0, 1.0)


def decode(
    stack: Stack,
    patterns: PatternSet,
    sensor: SensorNoise,
    options: DecodeOptions | None = None,
    scale: FloatImage | None = None,
) -> Decoded:
    """Decode a stack of frames.

    Parameters
    ----------
    stack : (frame, row, col) uint8, uint16 or float32, DN, in the order of `patterns.frames`
    patterns : what was projected
    sensor : noise model; gives the masks and the predicted sigma
    options : filter and masks; None: the defaults of `DecodeOptions`
    scale : (row, col) float32, by which each pixel's DN above the black level were multiplied, see
        `merge_exposures`; None: 1

    Raises
    ------
    InputError : wrong number of axes, frames or type of the stack, or shape of the scale
    """
    _check_stack(stack, patterns)
    if scale is not None and (scale.shape != stack.shape[1:] or not np.all(scale > 0.0)):
        raise InputError(
            f"scale has shape {scale.shape}; give positive numbers of shape {stack.shape[1:]}"
        )
    frames = np.ascontiguousarray(stack)
    plan = make_plan(frames, patterns, sensor, options or DecodeOptions(), scale)
    maps = _blank_maps(stack.shape[1], stack.shape[2])
    run_over_rows(decode_rows, stack.shape[1], frames, plan, maps, band_rows=BAND_ROWS)
    units = units_of(sensor, scale)
    column, row = (_axis(maps, axis, units, patterns.period_px) for axis in range(2))
    return Decoded(column, row, maps.reason)


def _check_stack(stack: Stack, patterns: PatternSet) -> None:
    if stack.dtype.name not in STACK_TYPES:
        raise InputError(f"stack is {stack.dtype}; allowed are {', '.join(STACK_TYPES)}")
    if stack.ndim != 3 or stack.shape[0] != len(patterns.frames) or stack.size == 0:
        raise InputError(
            f"stack has shape {stack.shape}; "
            f"this pattern set needs ({len(patterns.frames)} frames, rows, cols)"
        )


def _blank_maps(rows: int, cols: int) -> Maps:
    turns, mean, modulation, sigma, residual, error = (
        np.zeros((2, rows, cols), np.uint16) for _ in range(6)
    )
    return Maps(
        np.zeros((2, rows, cols), np.float32),
        turns, mean, modulation, sigma, residual, error,
        np.zeros((rows, cols), np.uint8),
    )  # fmt: skip


def _axis(maps: Maps, axis: int, units: tuple[float, float, float], period_px: float) -> AxisDecode:
    level_dn, sigma_px, chance = units
    coordinate_px, turns = maps.coordinate_px[axis], Turns(maps.turns[axis])
    compact: dict[str, Any] = {
        "phase_rad": turns,
        "order": Orders(coordinate_px, turns, float(period_px)),
        "mean_dn": Half(maps.mean[axis], level_dn),
        "modulation_dn": Half(maps.modulation[axis], level_dn),
        "sigma_px": Half(maps.sigma[axis], sigma_px),
        "residual_dn": Half(maps.residual[axis], level_dn),
        "order_error": Half(maps.order_error[axis], chance),
    }
    return AxisDecode(coordinate_px, **compact)
